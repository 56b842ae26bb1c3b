"""Where a recording goes: a file, a viewer or both. The file counts; a viewer that fails is given up."""

from __future__ import annotations

import atexit
import contextlib
import logging
import shutil
import socket
import threading
from pathlib import Path
from urllib.parse import urlsplit

import rerun as rr

from airline.errors import ConfigError, InputError
from viz.rerun_private import drop_closed_streams
from viz.viewer import PORT

BEAT_S = 1.0  # how often data is pushed out: what a killed run loses at most
CHUNK = 16_000_000  # bytes of an entity that wait for each other: few chunks, of a second's pictures each
PATIENCE_S = 4.0  # a viewer that has not taken all data by then is given up; until then it waits in memory
SPARE = 50_000_000  # bytes of a disk that are left free: Rerun may wait forever for a writer that a full disk has ended
CONNECT_S = 2.0

log = logging.getLogger(__name__)


def open_stream(
    application_id: str, recording_id: str | None = None, *, live: bool, layer: bool = False
) -> rr.RecordingStream:
    """A stream that is not connected to anything yet, without the two timelines of Rerun's that nobody asked for.

    A `layer` says nothing of the recording that it belongs to, such as when that began.

    Rows of like data wait for each other until they are pushed out, which makes a file smaller; for a viewer, `live`,
    they wait shorter.
    """
    drop_closed_streams()
    batches = rr.ChunkBatcherConfig.DEFAULT()
    batches.flush_tick = 0.1 if live else 2 * BEAT_S
    batches.flush_num_bytes = CHUNK
    stream = rr.RecordingStream(
        application_id, recording_id=recording_id, send_properties=not layer, batcher_config=batches
    )
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    return stream


class Destination:
    """Carries a stream into a file and to a viewer, every second, in the background.

    A viewer that is absent, dies, or takes longer than `PATIENCE_S` is given up with one warning.

    Args:
        stream: the recording, of `open_stream`.
        save: .rrd file to write; an existing one is replaced.
        connect: address of a running viewer, `HOST:PORT` or `rerun+http://HOST:PORT/proxy`.

    Attributes:
        alive: whether data goes anywhere.

    Raises:
        InputError: the file cannot be written.
        ConfigError: an address that is none.
    """

    def __init__(self, stream: rr.RecordingStream, save: Path | None, connect: str | None) -> None:
        self._stream = stream
        self._save = save
        self._connect = connect
        self._file_error: str | None = None
        self._relay = None if connect is None else _relay_to(connect)
        sinks: list[rr.FileSink | rr.GrpcSink] = [] if save is None else [_file_sink(save)]
        if self._relay is not None:
            sinks.append(rr.GrpcSink(self._relay.url))
        self.alive = bool(sinks)
        if not self.alive:  # a stream without any sink would keep the whole run in memory
            return
        try:
            stream.set_sinks(*sinks)
        except RuntimeError as reason:
            raise InputError(f"cannot write the recording {save} ({reason}): free some space") from None
        self._place = None if save is None else _place(save)
        self._stop = threading.Event()
        self._beat = threading.Thread(target=self._push_out, name="rerun-flush", daemon=True)
        self._beat.start()
        atexit.register(self._abandon)

    def check(self) -> None:
        """Raise what went wrong with the file in the background.

        Raises:
            InputError: it cannot be written any more.
        """
        if self._file_error is not None:
            raise InputError(f"cannot write more of the recording {self._save}: {self._file_error}")

    def close(self) -> None:
        """Push the rest out, finish the file and let the viewer go.

        Raises:
            InputError: the file is incomplete.
        """
        if not self.alive:
            return
        self.alive = False
        atexit.unregister(self._abandon)
        self._stop.set()
        self._beat.join()
        self._flush()
        self._check_file()
        # Rerun's goodbye waits for a viewer without end, even where all data has left this process
        relay, given_up = self._relay, threading.Timer(PATIENCE_S, self._give_up, ["it takes no data"])
        given_up.start()
        self._stream.disconnect()
        given_up.cancel()
        if relay is not None:
            relay.cut()
        self.check()

    def _abandon(self) -> None:
        """At the exit, what nobody has closed must not keep the interpreter from ending."""
        self._stop.set()
        self._beat.join(PATIENCE_S + BEAT_S)
        if self._relay is not None:
            self._relay.cut()

    def _push_out(self) -> None:
        while not self._stop.wait(BEAT_S):
            self._check_file(SPARE)
            self._flush()

    def _check_file(self, least_free: int = 0) -> None:
        if self._save is None or self._file_error is not None:
            return
        if _place(self._save) != self._place:
            self._file_error = "it was removed or moved while it was written; leave it in its place"
        elif shutil.disk_usage(self._save.absolute().parent).free < least_free:
            self._file_error = f"less than {least_free / 1e6:.0f} MB are free: is the disk full?"

    def _flush(self) -> None:
        """Wait until everything logged so far has arrived; a viewer that takes too long is given up."""
        try:
            self._stream.flush(timeout_sec=PATIENCE_S)
        except RuntimeError as reason:
            if "File-writer" in str(reason):
                self._file_error = f"{reason}: is the disk full?"
            else:
                self._give_up("it takes no data, or too slowly" if "timed out" in str(reason) else "it has gone")

    def _give_up(self, why: str) -> None:
        if self._relay is not None:
            self._relay.cut()
            self._relay = None
            log.warning("lost the Rerun viewer at %s (%s): going on without it", self._connect, why)


class Relay:
    """Passes bytes between Rerun's sender in this process and a viewer, until it is cut.

    For a viewer that takes nothing the sender keeps all data and waits without end (Rerun 0.41); behind a relay it sees
    its connection break, and lets go.

    Raises:
        OSError: nobody listens at the viewer's address.
    """

    def __init__(self, host: str, port: int) -> None:
        self._viewer = socket.create_connection((host, port), CONNECT_S)
        self._viewer.settimeout(None)
        server = socket.create_server(("127.0.0.1", 0))
        self.url = f"rerun+http://127.0.0.1:{server.getsockname()[1]}/proxy"
        threading.Thread(target=self._serve, args=(server,), name="viewer-relay", daemon=True).start()

    def cut(self) -> None:
        """Break the connection; safe to call twice."""
        with contextlib.suppress(OSError):
            self._viewer.shutdown(socket.SHUT_RDWR)

    def _serve(self, server: socket.socket) -> None:
        with server, self._viewer:
            server.settimeout(10 * CONNECT_S)
            with contextlib.suppress(OSError):
                sender, _ = server.accept()  # the only one: Rerun does not connect again
                server.close()
                with sender:
                    back = threading.Thread(target=_copy, args=(self._viewer, sender), daemon=True)
                    back.start()
                    _copy(sender, self._viewer)
                    back.join()


def _copy(source: socket.socket, target: socket.socket) -> None:
    """Pass on what comes until either end closes, then close the other one too."""
    with contextlib.suppress(OSError):
        while part := source.recv(1 << 16):
            target.sendall(part)
    for end in (source, target):
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)


def _relay_to(address: str) -> Relay | None:
    """The viewer at HOST:PORT or a URL, if somebody listens there."""
    url = urlsplit(address if "://" in address else f"rerun+http://{address}/proxy")
    try:
        host, port = url.hostname, url.port
    except ValueError:
        host = port = None
    if host is None or port is None or url.scheme != "rerun+http" or url.path.rstrip("/") != "/proxy":
        raise ConfigError(f"'{address}' is no viewer address: write HOST:PORT, such as 127.0.0.1:{PORT}")
    try:
        return Relay(host, port)
    except OSError as reason:
        log.warning("no Rerun viewer answers at %s (%s): going on without it", address, reason)
        return None


def _file_sink(path: Path) -> rr.FileSink:
    try:
        path.open("wb").close()
    except OSError as reason:
        raise InputError(
            f"cannot write the recording {path} ({reason.strerror}): choose a file in a folder you may write to"
        ) from reason
    return rr.FileSink(path)


def _place(path: Path) -> tuple[int, int] | None:
    """Which file is under this name, None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino
