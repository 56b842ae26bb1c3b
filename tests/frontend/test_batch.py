"""The frontend over many recordings: results, report, what is run again."""

from __future__ import annotations

import json
import os
import sys
import unicodedata
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airline.errors import AirLineError, ConfigError, InputError
from frontend.batch import job as jobs
from frontend.batch import reserved, run_batch
from frontend.batch.__main__ import main
from frontend.batch.job import OUTPUTS
from frontend.batch.plan import find_recordings, fingerprint, job_settings, make_plan, unique_names
from frontend.cli.settings import RunConfig
from tests.helpers.batch_logs import camera_log, report_of, visible
from tests.helpers.camera_logs import text, write_log
from tests.helpers.command import Outcome, command

FRAMES = 8
GOOD = {f"log{number}" for number in range(2)}
BROKEN = {"cut", "empty", "no_camera"}
FIGURES = ("frames", "skipped_frames", "lines_per_frame", "tracks", "track_length_median", "fps", "seconds")


def batch(*arguments: object) -> Outcome:
    """`python -m frontend.batch` with these arguments; its workers are processes."""
    return command(*arguments, main=main)


def write_times(out: Path) -> dict[str, int]:
    return {path.name: (path / "summary.json").stat().st_mtime_ns for path in out.iterdir() if path.is_dir()}


@pytest.fixture(scope="module")
def logs(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five logs, three of them broken."""
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
    assert {path.name for path in (out / "log1").iterdir()} == {"tracks.parquet", "summary.json"}
    failures = [line for line in outcome.out.splitlines() if line.startswith("failed ")]
    assert {line.split(":")[0].removeprefix("failed ") for line in failures} == BROKEN
    assert any("/chatter" in line or "no image" in line for line in failures)
    assert outcome.out.endswith(f"report: {out / 'report.parquet'}\n")
    assert outcome.err == ""  # no progress bar either: this is no terminal


def test_report_and_summaries_agree(first: tuple[Outcome, Path], logs: Path) -> None:
    _, out = first
    rows = report_of(out)
    assert rows.keys() == GOOD | BROKEN
    assert list(rows)[:4] == ["cut", "empty", "log0", "log1"]
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
    for name in GOOD:
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
    rows = run_batch(logs, out, workers=1)
    assert [(row.name, row.status) for row in rows] == [("a", "done"), ("b", "done")]
    before = write_times(out)
    stat = logs[0].stat()
    os.utime(logs[0], ns=(stat.st_atime_ns, stat.st_mtime_ns + 1))
    assert batch(*logs, "--out", out).code == 0
    assert {name: row["status"] for name, row in report_of(out).items()} == {"a": "done", "b": "skipped"}
    after = write_times(out)
    assert (after["a"] != before["a"], after["b"]) == (True, before["b"])
    other = ["--stride", 2, "--serial", "--preset", "fast", "--calib", "cam.json", "--points", "--write", *OUTPUTS]
    assert batch(logs[0], "--out", out, *other).code == 0
    assert {(row["status"], row["frames"]) for row in report_of(out).values()} == {("done", FRAMES // 2)}
    assert {path.name for path in (out / "a").iterdir()} == {
        *OUTPUTS.values(),
        "tracks.frames.csv",
        "tracks.points.csv",
        "summary.json",
    }
    assert batch(logs[0], "--out", out, *other).code == 0
    assert [(row["name"], row["status"]) for row in report_of(out).values()] == [("a", "skipped")]
    assert visible(out) == {"a", "b"}


def test_a_kind_that_needs_points_is_refused_once() -> None:
    with pytest.raises(ConfigError, match=r"UV-SLAM takes points .*: add --points"):
        job_settings(RunConfig(), ["parquet", "uvslam"])


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
    ("process", "reason", "attempts"),
    [
        ("print('WARNING: odd', file=sys.stderr); raise ZeroDivisionError('first')", "ZeroDivisionError: first", 1),
        ("sys.exit(1)", "it ended with exit code 1", 1),
        ("os._exit(3)", "its worker ended by itself with exit code 3, 3 times", 3),
        ("os.kill(os.getpid(), 9)", "its worker was killed by SIGKILL (is there enough memory?), 3 times", 3),
    ],
)
def test_the_end_of_a_process_is_the_reason(tmp_path, monkeypatch, caplog, process, reason, attempts):
    monkeypatch.setattr(jobs, "_RUN", f"import os, sys; {process}")
    (tmp_path / "a.mcap").write_bytes(b"")
    (row,) = run_batch([tmp_path / "a.mcap"], tmp_path / "out")
    assert (row.status, row.reason, row.attempts) == ("failed", reason, attempts)
    assert row.warnings == (("odd",) if "odd" in process else ())
    assert caplog.text.count("it will be run again") == attempts - 1
    assert not visible(tmp_path / "out")


def test_two_batches_do_not_write_into_one_folder(tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_bytes(b"")
    out = tmp_path / "out"
    with reserved(out):
        outcome = batch(tmp_path / "log.mcap", "--out", out)
        assert (outcome.code, "another batch" in outcome.err) == (2, True)
    assert batch(tmp_path / "log.mcap", "--out", out).code == 1


def test_without_ray_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    (tmp_path / "log.mcap").write_bytes(b"")
    with pytest.raises(AirLineError, match=r"pip install 'airline-frontend\[ray\]'"):
        run_batch([tmp_path / "log.mcap"], tmp_path / "out", ray="auto")


PART = st.sampled_from(["a", "A", "b", "a-b", "ä", "a\u0308", ".x", "x", "x" * 140, "\udcff", "report"])
SUFFIX = st.sampled_from(["", ".mcap", ".bag", ".mp4", ".tar.gz"])
PATH = st.builds(lambda above, name, suffix: Path("/", *above, name + suffix), st.lists(PART, max_size=3), PART, SUFFIX)
PATHS = st.lists(PATH, unique=True, max_size=12)


def key(name: str) -> str:
    return unicodedata.normalize("NFC", name.casefold())


@given(PATHS, st.lists(PART, max_size=5), st.randoms())
def test_names_are_distinct_and_do_not_depend_on_the_order(paths, taken, random):
    names = unique_names(paths, taken)
    assert set(names) == set(paths)
    keys = {key(name) for name in names.values()}
    assert len(keys) == len(paths)
    assert not keys & set(map(key, taken))
    for name in names.values():
        assert "/" not in name
        assert not name.startswith(".")
        assert 0 < len(name.encode()) <= 150
    random.shuffle(paths)
    assert unique_names(paths, taken) == names


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["/d/x.mcap", "/d/y.mcap"], ["x", "y"]),
        (["/d/x.mcap", "/d/x.bag"], ["x.mcap", "x.bag"]),
        (["/a/x.mcap", "/b/x.mcap", "/b/y.mcap"], ["a-x", "b-x", "y"]),
        (["/a/left/x.mcap", "/b/left/x.mcap"], ["a-left-x", "b-left-x"]),
        (["/d/X.mcap", "/e/x.mcap"], ["d-X", "e-x"]),
        (["/d/taken.mcap"], ["d-taken"]),
    ],
)
def test_names_are_short(paths: list[str], names: list[str]) -> None:
    assert list(unique_names(map(Path, paths), ["taken"]).values()) == names


@pytest.fixture
def files(tmp_path: Path) -> Path:
    for name in ("img10.mcap", "img2.mcap", "deep/er/x.mcap", "out/img2/tracks.mcap", "[1].bag"):
        path = tmp_path / "logs" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"log")
    return tmp_path / "logs"


def found(files: Path, *patterns: str) -> list[str]:
    paths = find_recordings([files / pattern for pattern in patterns], files / "out")
    return [str(path.relative_to(files)) for path in paths]


def test_globs_are_expanded_in_natural_order_each_recording_once_and_without_the_results(files: Path) -> None:
    assert found(files, "*.mcap") == ["img2.mcap", "img10.mcap"]
    assert found(files, "**/*.mcap") == ["deep/er/x.mcap", "img2.mcap", "img10.mcap"]
    assert found(files, "*") == ["[1].bag", "deep", "img2.mcap", "img10.mcap"]
    assert found(files, "img10.mcap", "*.mcap", "deep/../img2.mcap") == ["img10.mcap", "img2.mcap"]
    assert found(files, "[1].bag") == ["[1].bag"]


def test_relative_paths_and_home(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(files)
    monkeypatch.setenv("HOME", str(files))
    assert find_recordings(["img2.mcap", "~/img10.*"], Path("out")) == [files / "img2.mcap", files / "img10.mcap"]


@pytest.mark.parametrize("pattern", ["*.mp4", "none.mcap", "out/**/*.mcap", "out", "."])
def test_a_pattern_without_a_recording_is_an_error(files: Path, pattern: str) -> None:
    with pytest.raises(InputError):
        found(files, "img2.mcap", pattern)


def test_fingerprint_changes_with_the_files(files: Path) -> None:
    before = fingerprint(files)
    assert before["bytes"] == 15
    (files / "deep/er/x.mcap").write_bytes(b"longer")
    assert fingerprint(files)["bytes"] == 18
    assert fingerprint(files / "none") == {"bytes": 0, "modified_ns": 0}
