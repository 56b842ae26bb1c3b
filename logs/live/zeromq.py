"""Tracked lines to other processes over ZeroMQ."""

from __future__ import annotations

import os
import socket
import stat
import time
from contextlib import suppress

import zmq

from frontend.protocols import FrameResult
from logs.live.address import Address, cannot_publish
from logs.live.message import encode_end, encode_frame

MESSAGES_WAITING = 300  # per consumer, ten seconds of a camera
CONNECT_S = 0.3  # consumers try to connect every 0.1 s
LINGER_MS = 1000
_LARGEST_REQUEST = 1 << 16  # bytes; consumers send nothing but subscriptions


class ZmqPublisher:
    """Sends each frame's tracks to whoever is connected; a `Sink`.

    It binds at once, a PUB socket, and never waits for a consumer: one that is slow loses messages, which the numbers
    of the others show, and one that comes late gets what is sent from then on. Only the first frame may wait, until
    `CONNECT_S` after the binding, so that consumers that are there already have connected and get it. The messages are
    described in `logs.live.message`, and the last one says that it is.

    Args:
        address: of scheme "tcp" or "ipc".
        name: of the input.

    Attributes:
        address: where it can be reached, with the port that was found.

    Raises:
        InputError: the address is taken, or cannot be had.
    """

    def __init__(self, address: Address, name: str) -> None:
        self._name = name
        self._stream = time.time_ns()
        self._sequence = 0
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        try:
            self._socket.setsockopt(zmq.SNDHWM, MESSAGES_WAITING)
            self._socket.setsockopt(zmq.LINGER, LINGER_MS)
            self._socket.setsockopt(zmq.MAXMSGSIZE, _LARGEST_REQUEST)
            self._socket.setsockopt(zmq.IPV6, ":" in address.host)
            if address.scheme == "ipc":
                _check_file(address)
            self._socket.bind(str(address))
        except zmq.ZMQError as error:
            self._context.destroy(0)
            raise cannot_publish(address, zmq.strerror(error.errno or 0)) from None
        except BaseException:
            self._context.destroy(0)
            raise
        self.address = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)
        self._first_s = time.monotonic() + CONNECT_S

    def write(self, result: FrameResult) -> None:
        """Send one frame's tracks."""
        if self._sequence == 0:
            time.sleep(max(0.0, self._first_s - time.monotonic()))
        stream, number, name = self._stream, self._sequence, self._name
        self._send(encode_frame(result, stream=stream, sequence=number, name=name, sent_ns=time.time_ns()))

    def close(self) -> None:
        """Say that this was all, and wait at most a second for consumers that are behind; safe to call twice."""
        if not self._socket.closed:
            stream, number, name = self._stream, self._sequence, self._name
            self._send(encode_end(stream=stream, sequence=number, name=name, sent_ns=time.time_ns()))
            self._socket.close()  # by ourselves: a context that is interrupted forgets its sockets, and waits for them
        self._context.term()

    def _send(self, message: bytes) -> None:
        self._socket.send(message)
        self._sequence += 1


def _check_file(address: Address) -> None:
    """Refuse a socket's file that somebody listens at, and any other file: ZeroMQ replaces both without asking."""
    try:
        kind = os.stat(address.path).st_mode  # noqa: PTH116  (pathlib's raises for names that are too long)
    except (OSError, ValueError):
        return  # binding says what is wrong
    if not stat.S_ISSOCK(kind):
        raise cannot_publish(address, "there is a file of this name")
    with socket.socket(socket.AF_UNIX) as probe, suppress(OSError):
        probe.connect(address.path)
        raise cannot_publish(address, "it is in use")
