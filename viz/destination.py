"""Where a recording goes: a file, a viewer or both. The file counts; a viewer that fails is given up."""

from __future__ import annotations

import atexit
import logging
import shutil
import threading
import time
from pathlib import Path
from urllib.parse import urlsplit

import rerun as rr

from airline.errors import ConfigError, InputError
from viz.relay import Relay
from viz.viewer import PORT

BEAT_S = 1.0  # how often data is pushed out: what a killed run loses at most, and what a stuck viewer may hold
STUCK_S = 2.0  # a viewer that takes nothing for so long is given up
BEHIND_S = 10.0  # as is one that is so far behind
SPARE = 50_000_000  # bytes of a disk that are left free: Rerun may wait forever for a writer that a full disk has ended

log = logging.getLogger(__name__)


def batches(live: bool) -> rr.ChunkBatcherConfig:
    """How long rows wait for others: long rows of like data are smaller in a file; a viewer should not lag behind."""
    config = rr.ChunkBatcherConfig.DEFAULT()
    config.flush_tick = 0.1 if live else BEAT_S
    return config


class Destination:
    """Carries a stream into a file and to a viewer, in the background.

    Every second all that was logged is pushed out. A viewer that is absent, dies, or does not keep up is given up with
    one warning; until then, not more than about ten seconds of data wait for it.

    Args:
        stream: the recording, not yet connected to anything.
        save: .rrd file to write; an existing one is replaced.
        connect: address of a running viewer, `HOST:PORT` or `rerun+http://HOST:PORT/proxy`.

    Raises:
        InputError: the file cannot be written.
        ConfigError: an address that is none.
    """

    def __init__(self, stream: rr.RecordingStream, save: Path | None, connect: str | None) -> None:
        self._stream = stream
        self._save = save
        self._address = connect
        self._file_error: str | None = None
        relay = None if connect is None else _relay_to(connect)
        file = None if save is None else _file_sink(save)
        self._relay = relay
        self.alive = file is not None or relay is not None
        self._stop = threading.Event()
        self._beat = threading.Thread(target=self._push_out, name="rerun-flush", daemon=True)
        if not self.alive:  # a stream without any sink would keep the whole run in memory
            return
        sinks = [file] if file is not None else []
        try:
            stream.set_sinks(*sinks, *([rr.GrpcSink(relay.url)] if relay is not None else []))
        except RuntimeError as reason:
            raise InputError(f"cannot write the recording {save} ({reason}): free some space") from None
        self._place = None if save is None else _place(save)
        self._beat.start()
        atexit.register(self._abandon)  # at the exit Rerun waits for a thread that is still flushing, and it for Rerun

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
        self._check_place()
        over = threading.Event()
        threading.Thread(target=self._cut_if_stuck, args=(over,), name="rerun-end", daemon=True).start()
        self._stream.disconnect()
        over.set()
        if self._relay is not None:
            self._relay.cut()
        self.check()

    def _cut_if_stuck(self, over: threading.Event) -> None:
        """Rerun's last goodbye may wait for a viewer for ever, even if its flush did not."""
        relay, moved = self._relay, -1
        while relay is not None and not over.wait(STUCK_S):
            if relay.moved == moved:
                self._give_up("it takes no data")
                return
            moved = relay.moved

    def _abandon(self) -> None:
        """What nobody has closed must not keep the interpreter from ending."""
        self._stop.set()
        self._beat.join(BEHIND_S)
        if self._relay is not None:
            self._relay.cut()

    def _push_out(self) -> None:
        while not self._stop.wait(BEAT_S):
            if self._check_place():
                self._check_space()
            self._flush()

    def _check_place(self) -> bool:
        if self._save is not None and _place(self._save) != self._place:
            self._file_error = "it was removed or moved while it was written; leave it in its place"
        return self._file_error is None

    def _check_space(self) -> None:
        if self._save is not None and shutil.disk_usage(self._save.absolute().parent).free < SPARE:
            self._file_error = f"less than {SPARE / 1e6:.0f} MB are free: is the disk full?"

    def _flush(self) -> None:
        """Wait until everything logged so far has arrived, or until there is no hope of that."""
        begin = time.monotonic()
        while True:
            moved = 0 if self._relay is None else self._relay.moved
            try:
                self._stream.flush(timeout_sec=STUCK_S)
            except RuntimeError as reason:
                text = str(reason)
                if "File-writer" in text:
                    self._file_error = f"{text}: is the disk full?"
                elif self._relay is None:
                    pass  # a viewer that was given up before
                elif "timed out" not in text:
                    self._give_up("it has gone")
                elif self._relay.moved == moved:
                    self._give_up("it takes no data")
                elif time.monotonic() - begin > BEHIND_S:
                    self._give_up(f"it is more than {BEHIND_S:g} s behind")
                else:
                    continue
            return

    def _give_up(self, why: str) -> None:
        if self._relay is not None:
            self._relay.cut()
            self._relay = None
            log.warning("lost the Rerun viewer at %s (%s): going on without it", self._address, why)


def _place(path: Path) -> tuple[int, int] | None:
    """Which file is under this name, None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _file_sink(path: Path) -> rr.FileSink:
    try:
        path.open("wb").close()
    except OSError as reason:
        raise InputError(
            f"cannot write the recording {path} ({reason.strerror}): choose a file in a folder you may write to"
        ) from reason
    return rr.FileSink(path)


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
