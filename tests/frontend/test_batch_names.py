"""Batches: which recordings are found, and what their results are called."""

from __future__ import annotations

import unicodedata
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from airline.errors import InputError
from frontend.batch.plan import find_recordings, fingerprint, unique_names

PART = st.sampled_from(["a", "A", "b", "a-b", "ä", "a\u0308", ".x", "x", "x" * 140, "\udcff", "report"])
SUFFIX = st.sampled_from(["", ".mcap", ".bag", ".mp4", ".tar.gz"])
PATHS = st.lists(
    st.builds(
        lambda folders, name, suffix: Path("/", *folders, name + suffix), st.lists(PART, max_size=3), PART, SUFFIX
    ),
    unique=True,
    max_size=12,
)


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
def logs(tmp_path: Path) -> Path:
    for name in (
        "logs/img10.mcap",
        "logs/img2.mcap",
        "logs/deep/er/x.mcap",
        "logs/out/img2/tracks.mcap",
        "logs/[1].bag",
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"log")
    return tmp_path / "logs"


def found(logs: Path, *patterns: str) -> list[str]:
    paths = find_recordings([logs / pattern for pattern in patterns], logs / "out")
    return [str(path.relative_to(logs)) for path in paths]


def test_globs_are_expanded_in_natural_order_and_without_the_results(logs: Path) -> None:
    assert found(logs, "*.mcap") == ["img2.mcap", "img10.mcap"]
    assert found(logs, "**/*.mcap") == ["deep/er/x.mcap", "img2.mcap", "img10.mcap"]
    assert found(logs, "*") == ["[1].bag", "deep", "img2.mcap", "img10.mcap"]


def test_each_recording_is_found_once_and_names_are_no_globs(logs: Path) -> None:
    assert found(logs, "img10.mcap", "*.mcap", "deep/../img2.mcap") == ["img10.mcap", "img2.mcap"]
    assert found(logs, "[1].bag") == ["[1].bag"]


def test_relative_paths_and_home(logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(logs)
    monkeypatch.setenv("HOME", str(logs))
    assert find_recordings(["img2.mcap", "~/img10.*"], Path("out")) == [logs / "img2.mcap", logs / "img10.mcap"]


@pytest.mark.parametrize("pattern", ["*.mp4", "none.mcap", "out/**/*.mcap", "out", "."])
def test_a_pattern_without_a_recording_is_an_error(logs: Path, pattern: str) -> None:
    with pytest.raises(InputError):
        found(logs, "img2.mcap", pattern)


def test_fingerprint_changes_with_the_files(logs: Path) -> None:
    before = fingerprint(logs)
    assert before["bytes"] == 15
    (logs / "deep/er/x.mcap").write_bytes(b"longer")
    assert fingerprint(logs)["bytes"] == 18
    assert fingerprint(logs / "none") == {"bytes": 0, "modified_ns": 0}
