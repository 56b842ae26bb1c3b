"""The reader of a stream of tracked lines from another process."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import zmq

from airline.errors import ConfigError, InputError
from frontend.tracks import LineTracks
from logs.live.address import parse_address
from logs.live.message import MAX_BYTES, LiveTracks, decode

log = logging.getLogger(__name__)

MESSAGES_WAITING = 300


def subscribe_tracks(address: str, *, timeout_s: float | None = 10.0) -> TrackSubscription:
    """The tracks that another process publishes, from now on; the process may start later.

    Example:
        >>> with subscribe_tracks("tcp://127.0.0.1:5555") as subscription:  # doctest: +SKIP
        ...     for tracks in subscription:
        ...         backend.add_lines(tracks.stamp_ns, tracks.ids, tracks.segments_normalized)

    Args:
        address: what `frontend.run --publish` was given, `tcp://HOST:PORT` or `ipc://PATH`.
        timeout_s: how long to wait for a message, None for ever.

    Raises:
        ConfigError: no such address.
        InputError: it cannot be used; while iterating, see `TrackSubscription`.
    """
    return TrackSubscription(address, timeout_s)


class TrackSubscription:
    """Iterates over the frames of a stream, as the same `frontend.LineTracks` that were sent.

    Iteration ends, and closes it, when the publisher says that it is done. While iterating it raises InputError when
    nothing comes for too long, for a message that is none or of another version of the protocol, and when the publisher
    begins anew, because then track ids do, too. One may iterate again after each of them.

    Attributes:
        lost: messages sent since the first that came, but never received: the reader or the network was too slow.
        latest: the latest message, with its times and its number; None before the first.
    """

    def __init__(self, address: str, timeout_s: float | None) -> None:
        self.lost = 0
        self.latest: LiveTracks | None = None
        self._address = parse_address(address)
        self._timeout_s = timeout_s
        if self._address.scheme == "ws":
            raise ConfigError(f"'{address}' is for Foxglove: subscribe to a tcp:// or ipc:// address")
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        try:
            self._socket.setsockopt(zmq.RCVHWM, MESSAGES_WAITING)
            self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_BYTES)  # ZeroMQ disconnects from who sends more
            self._socket.setsockopt(zmq.IPV6, ":" in self._address.host)
            self._socket.subscribe(b"")
            self._socket.connect(str(self._address))
        except zmq.ZMQError as error:
            self.close()
            raise InputError(
                f"cannot subscribe to '{address}' ({zmq.strerror(error.errno or 0)}): name another"
            ) from None

    def __iter__(self) -> Iterator[LineTracks]:
        while not self._socket.closed:
            message = self._receive()
            self._count(message)
            if message.tracks is None:
                self.close()
            else:
                yield message.tracks

    def __enter__(self) -> TrackSubscription:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        self._socket.close(0)  # see `ZmqPublisher.close`
        self._context.term()

    def _receive(self) -> LiveTracks:
        if not self._socket.poll(None if self._timeout_s is None else round(1e3 * self._timeout_s)):
            raise InputError(f"nothing came from {self._address} for {self._timeout_s:g} s: is anybody publishing?")
        data = self._socket.recv()
        if self._socket.getsockopt(zmq.RCVMORE):
            while self._socket.getsockopt(zmq.RCVMORE):
                self._socket.recv()
            raise InputError(f"{self._address} sends messages of several parts: it is no stream of lines")
        try:
            return decode(data)
        except InputError as error:
            raise InputError(f"{self._address}: {error}") from error

    def _count(self, message: LiveTracks) -> None:
        before, self.latest = self.latest, message
        if before is None:
            return
        if message.stream != before.stream:
            raise InputError(f"the publisher at {self._address} began anew, and so do its track ids: subscribe again")
        lost = message.sequence - before.sequence - 1
        if lost < 0:
            raise InputError(f"{self._address} sends message {message.sequence} behind message {before.sequence}")
        if lost and not self.lost:
            log.warning("%s: messages come faster than they are taken: some are lost", self._address)
        self.lost += lost
