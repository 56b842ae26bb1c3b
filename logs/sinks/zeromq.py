"""Tracked lines to other processes over ZeroMQ: the publisher, and the reader of its stream."""

from __future__ import annotations

import logging
import os
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import suppress

from airline.errors import ConfigError, InputError, from_extra
from frontend.history import Confirmations
from frontend.protocols import FrameResult
from frontend.tracks import LineTracks
from logs.sinks.open import Address, cannot_publish, parse_address
from logs.tracks.message import MAX_BYTES, LiveTracks, decode, encode

with from_extra("zeromq"):
    import zmq

log = logging.getLogger(__name__)

MESSAGES_WAITING = 300  # per consumer, ten seconds of a camera
CONNECT_S = 0.3  # consumers try to connect every 0.1 s
LINGER_MS = 1000
_LARGEST_REQUEST = 1 << 16  # bytes; consumers send nothing but subscriptions


class ZmqPublisher:
    """Sends each frame's tracks to whoever is connected; a `Sink`.

    A PUB socket never waits for a consumer: one that is slow loses messages, which their numbers show, and one that
    comes late gets what is sent from then on. Only the first frame waits, until `CONNECT_S` after the binding, for
    consumers that are there already. The last message says that it is.

    Arguments and errors are those of `open_publisher`; `address` is then where it can be reached, with the port found.
    """

    def __init__(self, address: Address, name: str, stride: int = 1) -> None:
        self._name = name
        self._stride = stride
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
        except BaseException as error:
            self._context.destroy(0)
            if isinstance(error, zmq.ZMQError):
                raise cannot_publish(address, zmq.strerror(error.errno or 0)) from None
            raise
        self.address = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)
        self._first_s = time.monotonic() + CONNECT_S

    def write(self, result: FrameResult) -> None:
        """Send one frame's tracks."""
        if self._sequence == 0:
            time.sleep(max(0.0, self._first_s - time.monotonic()))
        self._send(result)

    def close(self) -> None:
        """Say that this was all, and wait at most a second for consumers that are behind; safe to call twice."""
        if not self._socket.closed:
            self._send(None)
            self._socket.close()  # by ourselves: a context that is interrupted forgets its sockets, and waits for them
        self._context.term()

    def _send(self, result: FrameResult | None) -> None:
        envelope = {"stream": self._stream, "sequence": self._sequence, "sent_ns": time.time_ns()}
        self._socket.send(encode(result, name=self._name, stride=self._stride, **envelope))
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


def subscribe_tracks(address: str, *, timeout_s: float | None = 10.0) -> TrackSubscription:
    """The tracks that another process publishes, from now on; it may start later.

    Example:
        >>> with subscribe_tracks("tcp://127.0.0.1:5555") as subscription:  # doctest: +SKIP
        ...     for tracks in subscription:
        ...         backend.add_lines(tracks.stamp_ns, tracks.ids, tracks.observed_normalized)

    Args:
        address: what `frontend.run --publish` was given, `tcp://HOST:PORT` or `ipc://PATH`.
        timeout_s: how long to wait for a message, None for ever.

    Raises:
        ConfigError: no such address.
        InputError: it cannot be used.
    """
    return TrackSubscription(address, timeout_s)


class TrackSubscription:
    """Iterates over the frames of a stream, as the same `frontend.LineTracks` that were sent, until it ends.

    Raises InputError when nothing comes for too long, for what is no message of this version of the protocol, and when
    the publisher begins anew, because then track ids do, too. One may iterate again after each of them.

    Attributes:
        lost: messages sent since the first that came, but never received: the reader or the network was too slow.
        latest: the latest message, with its times and its number; None before the first.
    """

    def __init__(self, address: str, timeout_s: float | None) -> None:
        self.lost = 0
        self.latest: LiveTracks | None = None
        self._address = parse_address(address)
        self._timeout_s = timeout_s
        self._confirmations = Confirmations()
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
                yield self._confirmations.add(message.tracks)

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
        parts = self._socket.recv_multipart()
        if len(parts) > 1:
            raise InputError(f"{self._address} sends messages of several parts: it is no stream of lines")
        try:
            return decode(parts[0])
        except InputError as error:
            raise InputError(f"{self._address}: {error}") from error

    def _count(self, message: LiveTracks) -> None:
        before, self.latest = self.latest, message
        if before is None:
            return
        if message.stream != before.stream:
            self._confirmations = Confirmations()
            raise InputError(f"the publisher at {self._address} began anew, and so do its track ids: subscribe again")
        lost = message.sequence - before.sequence - 1
        if lost < 0:
            raise InputError(f"{self._address} sends message {message.sequence} behind message {before.sequence}")
        if lost and not self.lost:
            log.warning("%s: messages come faster than they are taken: some are lost", self._address)
        self.lost += lost
