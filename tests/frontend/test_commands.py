"""All command lines: one sentence about what cannot be used, and little to load before there is work to do."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from tests.helpers.command import ROOT, command

ERRORS = """
bench: --frames 1: --frames | bench: --size 640: '640' is no size | bench: --size 4x4: '4x4' is no size
bench: nowhere.mp4: nowhere.mp4 | bench: --json no/such/folder.json: no folder no/such
evaluate: --sequence nothing: no sequence 'nothing' | evaluate: --limit 1: --limit | evaluate: --limit many: --limit
evaluate: --json nowhere/figures.json: no folder | evaluate: --photos nowhere: nowhere
evaluate: --icl nowhere: nowhere | evaluate: --posed nowhere: nowhere
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
    module = import_module("frontend.batch.__main__" if name == "batch" else f"frontend.{name}")
    outcome = command(*arguments.split(), main=module.main)
    assert outcome.code == 2
    assert outcome.err.startswith("error: ")
    assert message in outcome.err
    assert outcome.err.count("\n") == 1
    assert not Path("out/report.parquet").exists()


@pytest.mark.parametrize(
    "work",
    [
        "import airline, frontend.sources, logs, viz",
        "from frontend.run import main; main(['--help'])",
        "from frontend.batch.__main__ import main; main(['--help'])",
        "from frontend.evaluate import main; main(['--help'])",
    ],
)
def test_imports_and_help_load_nothing_heavy(work: str) -> None:
    heavy = {"torch", "openvino", "rerun", "ray", "pyarrow", "numba", "cv2", "scipy", "natsort", "mcap"}
    code = f"import atexit, sys; atexit.register(lambda: print({heavy} & set(sys.modules)))\n{work}"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"
    assert "--help" in done.stdout or "main" not in work
