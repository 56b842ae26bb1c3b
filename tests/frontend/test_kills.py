"""kill -9 at random moments: what was written can be read. Often: `KILLS=100 pytest tests/frontend/test_kills.py`.

The process writes into every kind of output until it is killed, which may be before the first frame, in the middle
of one, or while the files are finished.
"""

from __future__ import annotations

import csv
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from airline.errors import InputError
from logs import read_tracks
from tests.helpers.command import ROOT, recorded

KILLS = int(os.environ.get("KILLS", "3"))
LASTS_S = 2.2  # of writing, before everything is closed
LOST_S = 1.5  # of writing that a kill may cost: files are pushed out every second, and the machine may be busy

WRITER = f"""
import sys, time
from dataclasses import replace
from pathlib import Path
from tests.helpers.moving_rectangle import frame_results
from logs.sinks.open import open_track_sink
from viz.rerun_sink import RerunSink
results = list(frame_results(10))
folder = Path(sys.argv[1])
print("ready", flush=True)
sinks = [open_track_sink(str(folder / name)) for name in ("t.mcap", "t.parquet", "t.csv", "limap/")]
sinks.append(RerunSink(save=folder / "t.rrd"))
start, k = time.monotonic(), 0
while time.monotonic() < start + {LASTS_S}:
    old = results[k % 10]
    frame = replace(old.frame, index=k, stamp_ns=k * 10_000_000)
    tracks = replace(old.tracks, frame_index=k, stamp_ns=k * 10_000_000)
    for sink in sinks:
        sink.write(replace(old, frame=frame, tracks=tracks))
    print(k, time.monotonic(), flush=True)
    k += 1
    time.sleep(max(0.0, start + k * 0.01 - time.monotonic()))
for sink in sinks:
    sink.close()
print("closed", flush=True)
"""


def run_and_kill(folder: Path, after_s: float) -> tuple[int, bool]:
    """How many frames must have survived, and whether everything had been closed."""
    with subprocess.Popen([sys.executable, "-c", WRITER, folder], stdout=subprocess.PIPE, text=True, cwd=ROOT) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        time.sleep(after_s)
        killed_s = time.monotonic()
        child.send_signal(signal.SIGKILL)
        lines = child.stdout.read().splitlines()
    closed = lines[-1:] == ["closed"]
    written = [line.split() for line in lines if line[:1].isdigit() and line.count(" ") == 1]
    return sum(closed or float(when) < killed_s - LOST_S for _, when in written), closed


def frames_of_tracks(path: Path) -> list[int]:
    try:
        return [tracks.frame_index for tracks in read_tracks(path)]
    except InputError:  # killed before the head of the file was complete
        return []


def frames_of_csv(path: Path) -> list[int]:
    if not path.with_suffix(".frames.csv").exists():
        return []
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert all(None not in row.values() and row["d5"] for row in rows), "whole lines"
    with path.with_suffix(".frames.csv").open() as file:
        listed = [int(row["frame"]) for row in csv.DictReader(file)]
    found = list(dict.fromkeys(int(row["frame"]) for row in rows))
    assert listed in (found, found[: len(listed)])
    return listed


def frames_of_limap(folder: Path) -> list[int]:
    if not (folder / "images.csv").exists():
        return []
    images = [row.split(",")[0] for row in (folder / "images.csv").read_text().splitlines()[1:]]
    for image in images:
        assert (folder / f"line_detections/lsd/segments/segments_{image}.txt").stat().st_size > 0
        assert (folder / f"line_matchings/lsd/feats_lbd/lbd_n20_top0/matches_{image}.npy").stat().st_size > 0
        assert (folder / f"track_ids/track_ids_{image}.txt").stat().st_size > 0
    return [int(image) - 1 for image in images]


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # what tells a file that was never finished
@pytest.mark.parametrize("seed", range(KILLS))
def test_what_was_written_is_readable(seed: int, tmp_path: Path) -> None:
    due, closed = run_and_kill(tmp_path, random.Random(seed).uniform(0.0, LASTS_S + 0.8))
    journal = tmp_path / "t.parquet.unfinished"
    found = {
        "mcap": frames_of_tracks(tmp_path / "t.mcap"),
        "parquet": frames_of_tracks(journal if journal.exists() else tmp_path / "t.parquet"),
        "csv": frames_of_csv(tmp_path / "t.csv"),
        "limap": frames_of_limap(tmp_path / "limap"),
    }
    if due:
        found["rrd"] = recorded(tmp_path / "t.rrd")["/camera/tracks"]["frame"]
    for name, frames in found.items():
        assert frames == list(range(len(frames))), name
        assert len(frames) >= due, name
    assert journal.exists() is False or not closed
