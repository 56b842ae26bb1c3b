"""The command line while it runs and when it is stopped: progress, Ctrl-C, errors in the middle, the clock."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import pytest

from airline.errors import InputError
from frontend.cli.settings import RunConfig
from frontend.frame import Frame
from frontend.run import process
from tests.helpers.batch_logs import long_folder
from tests.helpers.command import EVERY_FRAME, ROOT, python, read_screen, recorded
from tests.helpers.sources import Listed
from viz.rerun_sink import RerunSink

CLIP_FRAMES = 8
LONG_FRAMES = 2000
PERIOD_NS = 33_333_333


def test_progress_bar_shows_in_a_terminal(clip: Path, tmp_path: Path) -> None:
    folder = tmp_path / "room [red]"  # a name that the bar could take for markup
    folder.mkdir()
    for number in range(40):
        (folder / f"{number}.png").write_bytes((clip / f"{number % CLIP_FRAMES}.png").read_bytes())
    (folder / "20.png").write_bytes(b"no picture")
    control, terminal = pty.openpty()
    child = python(folder, "--save", tmp_path / "run.rrd", stdout=subprocess.PIPE, stderr=terminal)
    os.close(terminal)
    with child:
        text = read_screen(control)
        out = child.communicate()[0]
    assert child.returncode == 0
    assert "39 (1 skipped)" in out
    assert re.search(r"room \[red\] .* 39/40 +\d+\.\d frames/s", text)
    (warning,) = (line for line in re.split(r"[\r\n]+", text) if "skipped" in line)
    assert warning.startswith("WARNING: ")  # on a line of its own, not behind the bar


def test_a_first_start_says_that_it_compiles(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    with python(clip, "--save", tmp_path / "run.rrd", stdout=subprocess.PIPE) as child:
        said = child.stdout.readline()
        child.kill()
    assert said == "compiling for this processor, once: a quarter of a minute to a whole one\n"


def test_a_reader_that_leaves_is_no_traceback(clip: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = f"'{sys.executable}' -m frontend.run '{clip}' --info >&{writer}; echo $?"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    run = {"cwd": ROOT, "env": environment, "capture_output": True, "text": True, "pass_fds": [writer]}
    done = subprocess.run(["bash", "-c", command], **run)
    os.close(writer)
    assert (done.stdout, done.stderr) == ("141\n", "")


def test_interrupt_keeps_everything_so_far(clip: Path, tmp_path: Path) -> None:
    save = tmp_path / "run.rrd"
    long = long_folder(tmp_path / "long", clip, LONG_FRAMES)
    flags = ["--save", save, "--summary", tmp_path / "run.json"]
    with python(long, *flags, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        deadline = time.monotonic() + 60
        while not save.exists() or save.stat().st_size < 100_000:
            assert child.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        child.send_signal(signal.SIGINT)
        out, err = child.communicate(timeout=30)
    assert child.returncode == 130
    assert err == "WARNING: interrupted: what was done so far is kept\n"
    assert "rerun" in out
    frames = json.loads((tmp_path / "run.json").read_text())["frames"]
    assert re.search(rf"frames +. {frames} ", out)
    assert 0 < frames < LONG_FRAMES
    rows = recorded(save)
    for path in EVERY_FRAME:  # the frame at hand may be recorded in part
        assert rows[path]["frame"] in (list(range(frames)), list(range(frames + 1)))


def failing(folder: Path, error: BaseException) -> Listed:
    """The clip, until something happens before its fourth frame."""
    return Listed([Frame(k, k * PERIOD_NS, cv2.imread(str(folder / f"{k}.png"))) for k in range(3)], error=error)


@pytest.mark.parametrize(("error", "code"), [(InputError("the cable is out"), 2), (KeyboardInterrupt(), 130)])
def test_what_was_written_before_the_end_is_readable(clip, tmp_path, capsys, error, code):
    save = tmp_path / "run.rrd"
    done, summary = process(failing(clip, error), RunConfig(), [RerunSink(save=save)])
    assert (done, summary.frames) == (code, 3)
    assert recorded(save)["/camera/tracks"]["frame"] == [0, 1, 2]
    assert capsys.readouterr().err == ("error: the cable is out\n" if code == 2 else "")


def test_a_fault_of_ours_is_not_hidden_and_loses_nothing(clip: Path, tmp_path: Path) -> None:
    save = tmp_path / "run.rrd"
    with pytest.raises(ZeroDivisionError):
        process(failing(clip, ZeroDivisionError()), RunConfig(), [RerunSink(save=save)])
    assert recorded(save)["/camera/tracks"]["frame"] == [0, 1, 2]


def test_opening_the_sinks_does_not_count_as_speed(clip: Path) -> None:
    """Nor does the time count that closing takes."""
    written = []

    class Slow:
        def __init__(self) -> None:
            time.sleep(1)

        def write(self, result: object) -> None:
            written.append(result)

        def close(self) -> None:
            time.sleep(1)

    _, summary = process(failing(clip, KeyboardInterrupt()), RunConfig(), (Slow() for _ in range(1)))
    assert len(written) == 3
    assert summary.fps > len(written)
