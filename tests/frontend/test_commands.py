"""All command lines: one sentence about what cannot be used, and little to load before there is work to do."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import pytest

from frontend import bench
from frontend.bench import ClipSource, load_clips, main
from frontend.cli.settings import RunConfig
from tests.helpers.command import ROOT, refusal

ERRORS = """
bench: --frames 1: --frames | bench: --size 640: '640' is no size | bench: --size 4x4: '4x4' is no size
bench: nowhere.mp4: nowhere.mp4 | bench: --json no/such/folder.json: no folder no/such
evaluate: --sequence nothing: no sequence 'nothing' | evaluate: --limit 1: --limit | evaluate: --limit many: --limit
evaluate: --json nowhere/figures.json: no folder | evaluate: --photos nowhere: nowhere
evaluate: --icl nowhere: nowhere | evaluate: --posed nowhere: nowhere | evaluate: --match nowhere: nowhere
match: none.png none.png: none.png
soak: --frames 10: --frames | soak: --json no/such/x.json: no folder
batch: none/*.mcap --out out: none/*.mcap | batch: log.mcap --out log.mcap: log.mcap
batch: log.mcap --out file/out: file/out | batch: log.mcap: --out | batch: --out out: RECORDING
batch: log.mcap --out out --workers 0: workers | batch: log.mcap --out out --workers 1 --ray auto: --ray
batch: log.mcap --out out --write pdf: pdf | batch: log.mcap --out out --stride 0: stride
batch: log.mcap --out out --calib none.yaml: none.yaml | batch: log.mcap --out out --weights none.safetensors: none.saf
batch: log.mcap --out out --ray nonsense: nonsense | batch: log.mcap --out out --ray 127.0.0.1:1: 127.0.0.1:1
"""  # which command, its arguments, and what the sentence names


@pytest.mark.parametrize("case", [case.strip() for line in ERRORS.split("\n") for case in line.split(" | ") if case])
def test_what_cannot_be_used_is_said_in_a_sentence(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name, arguments, message = case.split(": ", 2)
    if "--ray" in arguments:
        pytest.importorskip("ray", reason="Ray is not installed")
    monkeypatch.chdir(tmp_path)
    Path("log.mcap").write_bytes(b"")
    Path("file").write_bytes(b"")
    homes = {"batch": "frontend.batch.__main__", "soak": "tests.helpers.soak"}
    module = import_module(homes.get(name, f"frontend.{name}"))
    assert message in refusal(*arguments.split(), main=module.main)
    assert not Path("out/report.parquet").exists()


@pytest.mark.parametrize(
    "work",
    [
        "import airline, frontend.sources, logs, viz",
        "from frontend.run import main; main(['--help'])",
        "from frontend.batch.__main__ import main; main(['--help'])",
        "from frontend.evaluate import main; main(['--help'])",
        "from frontend.match import main; main(['--help'])",
    ],
)
def test_imports_and_help_load_nothing_heavy(work: str) -> None:
    heavy = {"torch", "openvino", "poselib", "rerun", "ray", "pyarrow", "numba", "cv2", "scipy", "natsort", "mcap"}
    heavy |= {"numpy", "rich"} if "main" in work else set()
    code = f"import atexit, sys; atexit.register(lambda: print({heavy} & set(sys.modules)))\n{work}"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"
    assert "--help" in done.stdout or "main" not in work


@pytest.mark.parametrize(("count", "expected"), [(1, [0] * 7), (2, [0, 1] * 3 + [0]), (4, [0, 1, 2, 3, 2, 1, 0])])
def test_the_clip_goes_forth_and_back(count: int, expected: list[int]) -> None:
    files = [cv2.imencode(".png", np.full((16, 16), 20 * number, np.uint8))[1].tobytes() for number in range(count)]
    frames = list(ClipSource(files, 7))
    assert [frame.image[0, 0] // 20 for frame in frames] == expected
    assert [frame.index for frame in frames] == list(range(7))
    assert len({frame.stamp_ns for frame in frames}) == 7


def test_every_size_shows_the_input(clip: Path) -> None:
    sizes = [(160, 120), (80, 60), (320, 200)]
    clips = load_clips(str(clip), sizes, RunConfig())
    for size, (files, right) in clips.items():
        assert not right
        frames = list(ClipSource(files, 8))
        for number, frame in enumerate(frames):
            assert f"{frame.image.shape[1]}x{frame.image.shape[0]}" == size
            original = cv2.resize(frame.image, (160, 120), interpolation=cv2.INTER_AREA).astype(float)
            assert np.abs(original - cv2.imread(str(clip / f"{number}.png"))).mean() < 8


def test_figures(clip, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(bench, "ROUNDS", 1)
    monkeypatch.setattr(bench, "RUNS", {"fps": bench.RUNS["fps"], **bench.RUNS})  # its memory first
    pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))  # one for all: it loads for seconds
    monkeypatch.setattr(bench, "ProcessPoolExecutor", lambda *_, **__: nullcontext(pool))
    out = tmp_path / "bench.json"
    for name in ("image_0", "image_1"):
        shutil.copytree(clip, tmp_path / name)
    rows = (f"P{k}: 100 0 80 {-12 * k} 0 100 60 0 0 0 1 0" for k in range(4))
    (tmp_path / "calib.txt").write_text("\n".join(rows))
    with pool:
        flags = ["--stereo", "--size", "160x120", "--frames", "10", "--preset", "fast", "--json", str(out)]
        assert main([str(tmp_path), *flags]) == 0
    written = json.loads(out.read_text())
    assert (written["preset"], written["frames"], list(written["sizes"])) == ("fast", 10, ["160x120"])
    figures = written["sizes"]["160x120"]
    for key in ("fps", "fps_serial", "fps_rerun", "fps_rerun_serial", "fps_mcap", "lsd_ms", "lines", "latency_ms"):
        assert figures[key] > 0
    assert {"edges", "track"} < figures["stage_ms"].keys()
    assert 5 < figures["peak_mb"] < 1000
    assert figures["pair_cost"] == pytest.approx(figures["fps"] / figures["fps_pairs"])
    shown = capsys.readouterr().out
    assert "160x120" in shown
    assert f"{figures['fps']:.1f}" in shown
