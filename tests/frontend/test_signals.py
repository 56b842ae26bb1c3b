"""Interrupts at the worst moment: while files are written."""

from __future__ import annotations

import csv
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from airline.errors import InputError
from frontend.cli.settings import RunConfig
from frontend.cli.signals import Terminated, ending_like_interrupts, exit_code_of, uninterrupted
from frontend.run import process
from frontend.sources import open_source
from logs import read_tracks
from logs.sinks.open import open_track_sink
from logs.sinks.output import OutputFile
from tests.helpers.command import recorded
from viz.rerun_sink import RerunSink

OUTPUTS = ("t.parquet", "t.csv", "t.mcap", "limap/")
SIGNALS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.fixture(autouse=True)
def usual_handlers() -> Iterator[None]:
    """Also where the parent ignores them, as shells do in the background and nohup does."""
    usual = {sign: signal.SIG_DFL for sign in SIGNALS} | {signal.SIGINT: signal.default_int_handler}
    before = {sign: signal.signal(sign, handler) for sign, handler in usual.items()}
    yield
    for sign, handler in before.items():
        signal.signal(sign, handler)


def tell(sign: signal.Signals) -> None:
    """Send a signal to this thread, the main one: its handler runs before this returns.

    Of one that is sent to the process any thread may be told, and the handler then runs at some later time.
    """
    assert threading.current_thread() is threading.main_thread()
    signal.raise_signal(sign)


@pytest.mark.parametrize("sign", SIGNALS)
@pytest.mark.parametrize("moment", [1, 12, 23, 40, 52])
def test_no_frame_is_half_written_or_written_twice(clip, tmp_path, monkeypatch, sign, moment):
    """The signal comes right behind one of the writes into a file, before its sink knows that it is done."""
    whole = OutputFile.writing
    writes = 0

    @contextmanager
    def told_while_writing(self: OutputFile) -> Iterator[object]:
        nonlocal writes
        with whole(self) as file:
            yield file
            writes += opened
            if writes == moment:
                tell(sign)

    opened = False

    def open_sinks():
        nonlocal opened
        for name in OUTPUTS:
            yield open_track_sink(str(tmp_path / name))
        yield RerunSink(save=tmp_path / "t.rrd")
        opened = True

    monkeypatch.setattr(OutputFile, "writing", told_while_writing)
    monkeypatch.setattr("logs.sinks.output.FLUSH_S", 0.0)
    with ending_like_interrupts():
        code, summary = process(open_source(str(clip)), RunConfig(), open_sinks())
    assert writes >= moment
    assert code == SIGNALS[sign]
    frames = list(range(summary.frames))
    assert frames
    for name in ("t.parquet", "t.mcap"):
        assert [tracks.frame_index for tracks in read_tracks(tmp_path / name)] == frames, name
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = [(int(row["frame"]), int(row["id"])) for row in csv.DictReader(file)]
    assert len(set(rows)) == len(rows)
    assert sorted({frame for frame, _ in rows}) == frames
    assert len((tmp_path / "limap/images.csv").read_text().splitlines()) == 1 + len(frames)
    assert recorded(tmp_path / "t.rrd")["/camera/tracks"]["frame"] == frames


def test_the_first_interrupt_waits_and_the_second_ctrl_c_does_not() -> None:
    done = []
    with ending_like_interrupts():
        with pytest.raises(Terminated) as told, uninterrupted():  # noqa: PT012
            tell(signal.SIGTERM)
            tell(signal.SIGHUP)
            done.append("first")
        assert exit_code_of(told.value) == 143
        with pytest.raises(KeyboardInterrupt), uninterrupted():  # noqa: PT012
            tell(signal.SIGINT)
            done.append("second")
    assert done == ["first"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_an_error_goes_before_the_interrupt() -> None:
    with ending_like_interrupts():
        with pytest.raises(InputError), uninterrupted():  # noqa: PT012
            tell(signal.SIGINT)
            raise InputError("the disk is full")
        with uninterrupted():
            pass  # it is not raised later


def test_without_handlers_an_interrupt_comes_at_once() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt), uninterrupted():  # noqa: PT012
        tell(signal.SIGINT)
        done.append("more")
    assert not done
