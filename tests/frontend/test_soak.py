"""`python -m tests.helpers.soak` in short, and that it sees what a long run must not do."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.helpers import soak
from tests.helpers.made_tracks import made_tracks, result_of
from tests.helpers.soak import Endurance, trend


def test_a_short_soak_holds_out(clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "soak.json"
    flags = ["--frames", "120", "--size", "160x120", "--preset", "fast", "--per-file", "28", "--files", "2"]
    code = soak.main([str(clip), *flags, "--folder", str(tmp_path), "--json", str(out)])
    figures = json.loads(out.read_text())
    # over so few frames the process may still grow to its size
    assert [fault for fault in figures["faults"] if not fault.startswith(("memory grew", "the time per"))] == []
    assert code == (1 if figures["faults"] else 0)
    assert (figures["frames"], figures["files"]) == (120, 5)
    assert figures["tracks"] > 10
    assert len(figures["samples"]["memory_mb"]) == 24
    assert {path.name for path in tmp_path.iterdir()} == {
        *(f"soak-{k}.{s}" for k in (0, 1) for s in ("mcap", "rrd")),
        out.name,
    }
    assert "frames/s" in capsys.readouterr().out


def watched(*changes: dict[str, Any]) -> list[str]:
    """The faults of a stream whose frames have these fields."""
    watch = Endurance(every=10)
    for k, change in enumerate(changes):
        tracks = replace(
            made_tracks(k, k * 1000, np.arange(3), np.random.default_rng(k)), ended_ids=np.zeros(0, np.int64)
        )
        watch.write(result_of(replace(tracks, **change)))
    return watch.faults


def test_ids_and_order_are_watched() -> None:
    assert watched({}, {}, {}) == []
    assert "frame 5 came where frame 1 was due" in watched({}, {"frame_index": 5})[0]
    assert "not later" in watched({}, {"stamp_ns": 0})[0]
    assert "twice" in watched({"ids": np.array([1, 1, 2])})[0]
    ended = {"ended_ids": np.array([1])}
    assert "uses track id 1 again" in watched({}, ended, {})[0]
    assert "uses track id 0 again" in watched({}, {"reset": "scene cut"})[0]
    assert watched({}, {"reset": "scene cut", "ids": np.array([3, 4, 5])}) == []


def test_trends_tell_growth_from_noise() -> None:
    noise = np.random.default_rng(0).normal(0, 3, 200)
    flat, grown = trend(600 + noise), trend(600 + noise + np.linspace(0, 40, 200))
    assert abs(flat.change) < 4
    assert flat.change - flat.margin < 2
    assert grown.change == pytest.approx(30, abs=4), "behind the first quarter"
    assert grown.change - grown.margin > 20
    assert np.isnan(trend([600.0] * 20).change)


def test_growth_slowness_and_open_files_are_violations() -> None:
    watch: Any = SimpleNamespace(frames=1000, tracks=1, faults=[])
    rising = np.linspace(0, 1, 200)
    watch.memory_mb, watch.cpu_ms = (500 + 60 * rising).tolist(), (10 + 5 * rising).tolist()
    watch.handles = (20 + 10 * rising).astype(int).tolist()
    turns: Any = SimpleNamespace(finished=1, faults=["soak-0.mcap, file 0, does not hold its frames"])
    faults = soak.judge(watch, turns)["faults"]
    assert [fault.split()[0] for fault in faults] == ["soak-0.mcap,", "memory", "the", "open"]
