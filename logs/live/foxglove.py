"""Tracked lines live in Foxglove and Lichtblick, over Foxglove's WebSocket protocol."""

from __future__ import annotations

import threading

from airline.errors import from_extra
from frontend.protocols import FrameResult
from logs.live.address import Address, cannot_publish
from logs.sinks.mcap_tracks import TOPICS, message_for

with from_extra("foxglove"):
    from foxglove import Channel, Context, Schema, start_server

MESSAGES_WAITING = 64  # per viewer, about half a second of a camera; the server drops the oldest
_CLOSE_S = 1.0


class FoxgloveServer:
    """Serves each frame's tracks and image to viewers; a `Sink`.

    The topics and schemas are those of `McapTrackSink`, images included, but that the calibration comes with every
    frame: a viewer may come at any time. What no viewer looks at is not made. Nothing ever waits for a viewer.

    Arguments and errors are those of `open_publisher`; `address` is then where it can be reached, with the port found.
    """

    def __init__(self, address: Address, name: str, *, labels: bool = False) -> None:
        self._labels = labels
        self._closed = False
        context = self._context = Context()  # its channels end with it
        host = "0.0.0.0" if address.host == "*" else address.host
        try:
            self._server = start_server(
                name=name, host=host, port=address.port, context=context, message_backlog_size=MESSAGES_WAITING
            )
        except RuntimeError as error:  # FoxgloveError: Failed to bind port: Address already in use (os error 98)
            reason = str(error).rpartition(": ")[2].partition(" (os error")[0]
            raise cannot_publish(address, reason) from None
        self.address = str(Address("ws", address.host, self._server.port))
        self._channels = {
            name: Channel(
                name,
                schema=Schema(name=topic.schema_name, encoding=topic.schema_encoding, data=topic.schema),
                message_encoding=topic.encoding,
                context=context,
            )
            for name, topic in TOPICS.items()
        }

    def write(self, result: FrameResult) -> None:
        """Send one frame's tracks and image."""
        stamp_ns = max(0, result.tracks.stamp_ns)  # viewers have no time before the epoch
        for topic, channel in self._channels.items():
            if channel.has_sinks() and (data := message_for(topic, result, labels=self._labels)) is not None:
                channel.log(data, log_time=stamp_ns)

    def close(self) -> None:
        """Disconnect everybody; safe to call twice."""
        if not self._closed:
            self._closed = True
            stop = threading.Thread(target=self._server.stop, daemon=True)  # it waits for ever for a stuck viewer
            stop.start()
            stop.join(_CLOSE_S)
