"""A viewer as Foxglove's server sees it: as little of WebSocket and of Foxglove's protocol as the tests need."""

from __future__ import annotations

import json
import os
import socket
import struct
from typing import Any

SUBPROTOCOL = "foxglove.sdk.v1"
TEXT, BINARY = 1, 2
MESSAGE_DATA = 1


class FoxgloveClient:
    """Connects, and reads what the server says of itself and of its channels."""

    def __init__(self, address: str) -> None:
        host, _, port = address.removeprefix("ws://").partition(":")
        self._socket = socket.create_connection((host, int(port)), timeout=10)
        request = f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        request += "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
        self._socket.sendall(f"{request}Sec-WebSocket-Protocol: {SUBPROTOCOL}\r\n\r\n".encode())
        self._stream = self._socket.makefile("rb")
        status = self._stream.readline()
        assert b" 101 " in status, status
        while self._stream.readline() != b"\r\n":
            pass
        self.info = self.read_json("serverInfo")
        self.channels = {channel["topic"]: channel for channel in self.read_json("advertise")["channels"]}

    def subscribe(self, *topics: str) -> None:
        """Ask for the messages of these topics."""
        wanted = [{"id": self.channels[topic]["id"], "channelId": self.channels[topic]["id"]} for topic in topics]
        payload = json.dumps({"op": "subscribe", "subscriptions": wanted}).encode()
        mask = os.urandom(4)
        masked = bytes(byte ^ mask[k % 4] for k, byte in enumerate(payload))
        self._socket.sendall(struct.pack("!BBH", 0x80 | TEXT, 0x80 | 126, len(payload)) + mask + masked)

    def read_message(self) -> tuple[str, int, bytes]:
        """Topic, time in ns and content of the next message."""
        while True:
            kind, payload = self._read()
            if kind == BINARY and payload[0] == MESSAGE_DATA:
                subscription, log_ns = struct.unpack_from("<IQ", payload, 1)
                (topic,) = (topic for topic, channel in self.channels.items() if channel["id"] == subscription)
                return topic, log_ns, payload[13:]

    def read_json(self, operation: str) -> dict[str, Any]:
        """The next text message, which has to be of this kind."""
        kind, payload = self._read()
        found = json.loads(payload)
        assert (kind, found["op"]) == (TEXT, operation)
        return dict(found)

    def close(self) -> None:
        self._stream.close()
        self._socket.close()

    def _read(self) -> tuple[int, bytes]:
        kind, length = self._stream.read(2)
        if length >= 126:
            (length,) = struct.unpack("!H" if length == 126 else "!Q", self._stream.read(2 if length == 126 else 8))
        return kind & 15, self._stream.read(length)
