"""The frontend over many recordings: results, report, what is run again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from airline.errors import AirLineError
from frontend import batch as batches
from frontend.batch import job as jobs
from frontend.batch import reserved, run_batch
from frontend.batch.__main__ import main
from frontend.batch.job import OUTPUTS, Job, JobSettings, Row, WorkerDied, run_recording
from frontend.batch.plan import job_settings, make_plan
from frontend.cli.settings import RunConfig
from tests.helpers.batch_logs import camera_log, report_of, visible
from tests.helpers.camera_logs import text, write_log
from tests.helpers.command import ROOT, Outcome, command

FRAMES = 8
GOOD = {f"log{number}" for number in range(3)}
BROKEN = {"cut", "empty", "no_camera"}
FIGURES = ("frames", "skipped_frames", "lines_per_frame", "tracks", "track_length_median", "fps", "seconds")


def batch(*arguments: object) -> Outcome:
    """`python -m frontend.batch` with these arguments; its workers are processes."""
    return command(*arguments, main=main)


def write_times(out: Path) -> dict[str, int]:
    return {path.name: (path / "summary.json").stat().st_mtime_ns for path in out.iterdir() if path.is_dir()}


@pytest.fixture(scope="module")
def logs(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six logs, three of them broken."""
    folder = tmp_path_factory.mktemp("logs")
    for name in sorted(GOOD):
        camera_log(folder / f"{name}.mcap", clip)
    (folder / "cut.mcap").write_bytes((folder / "log0.mcap").read_bytes()[:50])
    (folder / "empty.mcap").write_bytes(b"")
    write_log(folder / "no_camera.mcap", {"/chatter": text()})
    return folder


@pytest.fixture(scope="module")
def first(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Path]:
    out = tmp_path_factory.mktemp("batch") / "deep" / "results"
    return batch(logs / "*.mcap", "--out", out, "--workers", 2), out


def test_broken_recordings_fail_alone(first: tuple[Outcome, Path]) -> None:
    outcome, out = first
    assert outcome.code == 1
    assert visible(out) == GOOD
    assert {path.name for path in (out / "log2").iterdir()} == {"tracks.parquet", "summary.json"}
    failures = [line for line in outcome.out.splitlines() if line.startswith("failed ")]
    assert {line.split(":")[0].removeprefix("failed ") for line in failures} == BROKEN
    assert any("/chatter" in line or "no image" in line for line in failures)
    assert outcome.out.endswith(f"report: {out / 'report.parquet'}\n")
    assert outcome.err == ""  # no progress bar either: this is no terminal


def test_report_and_summaries_agree(first: tuple[Outcome, Path], logs: Path) -> None:
    _, out = first
    rows = report_of(out)
    assert rows.keys() == GOOD | BROKEN
    assert list(rows)[:5] == ["cut", "empty", "log0", "log1", "log2"]
    for name in GOOD:
        row, summary = rows[name], json.loads((out / name / "summary.json").read_text())
        assert (row["status"], row["reason"], row["attempts"], row["warnings"]) == ("done", None, 1, [])
        assert (row["input"], row["output"]) == (str(logs / f"{name}.mcap"), str(out / name))
        assert {figure: row[figure] for figure in FIGURES} == {figure: summary[figure] for figure in FIGURES}
        assert (row["frames"], row["tracks"] > 10, row["seconds"] > 0) == (FRAMES, True, True)
        assert summary["made_from"]["input"]["path"] == row["input"]
    for name in BROKEN:
        row = rows[name]
        assert (row["status"], row["output"], row["frames"], row["attempts"]) == ("failed", None, None, 1)
        assert row["reason"]
        assert "\n" not in row["reason"]


def test_tracks_are_those_of_a_single_run(first: tuple[Outcome, Path], logs: Path, tmp_path: Path) -> None:
    assert command(logs / "log1.mcap", "--out", tmp_path / "alone.parquet").code == 0
    alone = pq.read_table(tmp_path / "alone.parquet")
    for name in GOOD:  # a worker's second recording as well as its first
        assert pq.read_table(first[1] / name / "tracks.parquet").equals(alone)


def test_a_second_run_does_only_what_failed(first: tuple[Outcome, Path], logs: Path) -> None:
    _, out = first
    before, report = write_times(out), report_of(out)
    assert batch(logs / "*.mcap", "--out", out).code == 1
    assert write_times(out) == before
    for name, row in report_of(out).items():
        if name in GOOD:
            assert row == {**report[name], "status": "skipped", "attempts": 0}
        else:
            assert row == report[name]


def test_what_has_changed_is_run_again(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("cam.json").write_text(
        '{"width": 160, "height": 120, "fx": 90, "fy": 90, "cx": 80, "cy": 60, "distortion": "none"}'
    )
    logs = [camera_log(tmp_path / f"{name}.mcap", clip) for name in "ab"]
    out = tmp_path / "out"
    rows = run_batch(logs, out)
    assert [(row.name, row.status) for row in rows] == [("a", "done"), ("b", "done")]
    before = write_times(out)
    stat = logs[0].stat()
    os.utime(logs[0], ns=(stat.st_atime_ns, stat.st_mtime_ns + 1))
    assert batch(*logs, "--out", out).code == 0
    assert {name: row["status"] for name, row in report_of(out).items()} == {"a": "done", "b": "skipped"}
    after = write_times(out)
    assert (after["a"] != before["a"], after["b"]) == (True, before["b"])
    other = ["--stride", 2, "--serial", "--preset", "fast", "--calib", "cam.json", "--write", *OUTPUTS]
    assert batch(logs[0], "--out", out, *other).code == 0
    assert {(row["status"], row["frames"]) for row in report_of(out).values()} == {("done", FRAMES // 2)}
    assert {path.name for path in (out / "a").iterdir()} == {*OUTPUTS.values(), "summary.json"}
    assert batch(logs[0], "--out", out, *other).code == 0
    assert [(row["name"], row["status"]) for row in report_of(out).values()] == [("a", "skipped")]
    assert visible(out) == {"a", "b"}


def test_recordings_keep_the_names_of_their_results(tmp_path: Path) -> None:
    settings = job_settings(RunConfig(), ["parquet"])

    def plan(*paths: Path, overwrite: bool = False) -> list[tuple[str, str]]:
        rows, jobs = make_plan(paths, tmp_path, settings, overwrite=overwrite)
        assert [job.name for job in jobs] == [name for name, row in rows.items() if row.status == "pending"]
        for job in jobs:
            job.folder.mkdir(exist_ok=True)
            (job.folder / "summary.json").write_text(json.dumps({"frames": 3, "made_from": job.made_from}))
        return [(name, row.status) for name, row in rows.items()]

    (tmp_path / "foreign").mkdir()  # somebody else's folder
    first, second, foreign = Path("/one/x.mcap"), Path("/two/x.mcap"), Path("/d/foreign.mcap")
    assert plan(first, foreign) == [("x", "pending"), ("d-foreign", "pending")]
    assert plan(second) == [("two-x", "pending")]
    assert plan(first, second) == [("x", "skipped"), ("two-x", "skipped")]
    assert plan(first, second, overwrite=True) == [("x", "pending"), ("two-x", "pending")]
    (tmp_path / "x" / "summary.json").write_text("not ours")
    assert plan(first, second) == [("one-x", "pending"), ("two-x", "skipped")]


@pytest.mark.parametrize(
    ("process", "reason"),
    [
        (
            "print('WARNING: odd', file=sys.stderr); raise ZeroDivisionError('first')",
            "ZeroDivisionError: first",
        ),
        ("sys.exit(1)", "exit code 1"),
        ("os._exit(3)", WorkerDied("its worker ended by itself with exit code 3")),
        ("os.kill(os.getpid(), 11)", WorkerDied("its worker was killed by SIGSEGV")),
        ("os.kill(os.getpid(), 9)", WorkerDied("its worker was killed by SIGKILL (is there enough memory?)")),
    ],
)
def test_the_end_of_a_process_is_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, process: str, reason: str | WorkerDied
) -> None:
    monkeypatch.setattr(jobs, "_RUN", f"import os, sys; {process}")
    ended = run_recording(Job("a", "/a.mcap", tmp_path / "a", {}), JobSettings(RunConfig(), ("parquet",), {}))
    if isinstance(reason, WorkerDied):
        assert ended == reason
    else:
        assert isinstance(ended, Row)
        assert ended.status == "failed"
        assert reason in str(ended.reason)
        assert ended.warnings == (("odd",) if "odd" in process else ())
    assert not list(tmp_path.iterdir())


def test_a_recording_whose_worker_dies_is_tried_three_times(caplog: pytest.LogCaptureFixture) -> None:
    started: list[str] = []

    def submit(job: Job) -> Future[Row | WorkerDied]:
        started.append(job.name)
        future: Future[Row | WorkerDied] = Future()
        if job.name == "always" or (job.name == "once" and started.count("once") == 1):
            future.set_result(WorkerDied("its worker fell asleep"))
        elif job.name == "raises":
            future.set_exception(ModuleNotFoundError("No module named 'frontend'"))
        else:
            future.set_result(Row(job.name, job.input, "done"))
        return future

    names = ["always", "once", "raises", "good"]
    rows = {row.name: row for row in batches._run_all([Job(name, "", Path(name), {}) for name in names], submit)}
    assert {name: (row.status, row.attempts) for name, row in rows.items()} == {
        "always": ("failed", 3),
        "once": ("done", 2),
        "raises": ("failed", 3),
        "good": ("done", 1),
    }
    assert rows["always"].reason == "its worker fell asleep, 3 times"
    assert "No module named 'frontend', 3 times" in str(rows["raises"].reason)
    assert "once: its worker fell asleep; it will be run again" in caplog.text


def test_two_batches_do_not_write_into_one_folder(tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_bytes(b"")
    out = tmp_path / "out"
    with reserved(out):
        outcome = batch(tmp_path / "log.mcap", "--out", out)
        assert (outcome.code, "another batch" in outcome.err) == (2, True)
    assert batch(tmp_path / "log.mcap", "--out", out).code == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["none/*.mcap", "--out", "out"], "'none/*.mcap'"),
        (["log.mcap", "--out", "log.mcap"], "log.mcap"),
        (["log.mcap", "--out", "file/out"], "file/out"),
        (["log.mcap"], "--out"),
        (["--out", "out"], "RECORDING"),
        (["log.mcap", "--out", "out", "--workers", "0"], "workers"),
        (["log.mcap", "--out", "out", "--workers", "1", "--ray", "auto"], "--ray"),
        (["log.mcap", "--out", "out", "--write", "pdf"], "pdf"),
        (["log.mcap", "--out", "out", "--stride", "0"], "stride"),
        (["log.mcap", "--out", "out", "--calib", "none.yaml"], "none.yaml"),
        (["log.mcap", "--out", "out", "--weights", "none.safetensors"], "none.safetensors"),
        (["log.mcap", "--out", "out", "--ray", "nonsense"], "nonsense"),
        (["log.mcap", "--out", "out", "--ray", "127.0.0.1:1"], "127.0.0.1:1"),
    ],
)
def test_user_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str) -> None:
    monkeypatch.chdir(tmp_path)
    Path("log.mcap").write_bytes(b"")
    Path("file").write_bytes(b"")
    if "--ray" in arguments:
        pytest.importorskip("ray", reason="Ray is not installed")
    outcome = batch(*arguments)
    assert outcome.code == 2
    assert outcome.err.startswith("error: ")
    assert words in outcome.err
    assert outcome.err.count("\n") == 1
    assert not Path("out/report.parquet").exists()


def test_without_ray_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    (tmp_path / "log.mcap").write_bytes(b"")
    with pytest.raises(AirLineError, match=r"pip install 'airline-frontend\[fleet\]'"):
        run_batch([tmp_path / "log.mcap"], tmp_path / "out", ray="auto")


def test_help_needs_none_of_the_heavy_packages() -> None:
    start = "import sys; from frontend.batch.__main__ import main\n"
    start += "try: main(['--help'])\nexcept SystemExit: print(*sys.modules)"
    environment: dict[str, Any] = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", start], env=environment, capture_output=True, text=True, check=True)
    assert "--ray" in done.stdout
    loaded = set(done.stdout.splitlines()[-1].split())
    assert not loaded & {"torch", "openvino", "rerun", "ray", "pyarrow", "numba", "numpy", "cv2", "rich"}
