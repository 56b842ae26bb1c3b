"""The command that measures the tracker, and the clips it reads from folders."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest

from airline.errors import InputError
from frontend.evaluate import main
from frontend.evaluation.icl import LabelledClip, read_numbers
from frontend.evaluation.posed import PosedClip
from tests.helpers.data_sets import write_labelled, write_posed


@pytest.fixture
def labelled(tmp_path: Path) -> Path:
    return write_labelled(tmp_path / "labelled")


@pytest.fixture
def posed(tmp_path: Path) -> Path:
    return write_posed(tmp_path / "posed")


def test_labels_become_identities(labelled: Path) -> None:
    frames, truths = zip(*LabelledClip(labelled), strict=True)
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert frames[2].image[0, 0].tolist() == [80, 80, 80]
    assert [true.ids.tolist() for true in truths] == [[0, 1], [2, 0], [0, 3]]
    assert truths[1].segments_px[1].tolist() == [[11, 20], [91, 20]], "from corners to centres of pixels"


def test_poses_and_camera(posed: Path) -> None:
    clip = PosedClip(posed)
    assert (clip.name, len(clip), clip.poses.shape, clip.K.shape) == ("posed", 6, (6, 3, 4), (3, 3))
    assert [frame.image.shape for frame in clip] == [(240, 320, 3)] * 6


def test_number_files(tmp_path: Path) -> None:
    path = tmp_path / "numbers.txt"
    path.write_text("P0: 1 2\n\n3e1 -4\n")
    assert read_numbers(path, 2, None).tolist() == [[1, 2], [30, -4]]
    for text in ("1 2 3\n", "1\n", "a b\n", "nan 1\n"):
        path.write_text(text)
        with pytest.raises(InputError, match="malformed"):
            read_numbers(path, 2, None)


DAMAGE = [  # the text in place of a file, None to remove it
    (LabelledClip, "associations/0_1.csv", None, "no file"),
    (LabelledClip, "lines/1.csv", None, "no file"),
    (LabelledClip, "lines/1.csv", "1,2,3\n", "4 numbers"),
    (LabelledClip, "associations/0_1.csv", "0,7\n", "rows of the line files"),
    (LabelledClip, "associations/0_1.csv", "0,0\n0,1\n", "each once"),
    (PosedClip, "poses.txt", None, "no file"),
    (PosedClip, "poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "6 images and 1 poses"),
    (PosedClip, "calib.txt", "\n", "empty"),
]


@pytest.mark.parametrize(("kind", "name", "text", "message"), DAMAGE)
def test_damaged_clips(labelled, posed, kind, name, text, message):
    folder = labelled if kind is LabelledClip else posed
    if text is None:
        (folder / name).unlink()
    else:
        (folder / name).write_text(text)
    with pytest.raises(InputError, match=message):
        kind(folder)


def test_command(labelled: Path, posed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "figures.json"
    folders = ["--icl", str(labelled), "--posed", str(posed)]
    assert main(["--sequence", "static", "labelled", "posed", *folders, "--limit", "6", "--json", str(path)]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    for word in ("static", "labelled", "posed", "nearest", "flow", "IDF1", "parallax"):
        assert word in printed.out
    figures = json.loads(path.read_text())
    assert set(figures["sequences"]) == {"static", "labelled"}
    for clip in figures["sequences"].values():
        assert list(clip) == ["ours", "nearest", "flow"]
    for tracker in figures["sequences"]["static"].values():
        assert tracker["link_precision"] > 0.95, "nothing moves, so everybody must follow"
        assert tracker["link_recall"] > 0.9
        assert tracker["jitter_across_px"] < 0.5
        assert 0 < tracker["ms"] < 1000
    for tracker in figures["posed"]["posed"].values():
        assert tracker["tracks_5"] > 20
        assert tracker["consistent_share"] > 0.8, "an exact camera in a world that stands still"


def test_photographs(tmp_path: Path) -> None:
    from airline.scenes import RenderedClip

    folder, path = tmp_path / "photographs", tmp_path / "figures.json"
    folder.mkdir()
    cv2.imwrite(str(folder / "room.png"), RenderedClip(seed=3, size=(320, 240)).render(0).image)
    arguments = ["--photos", str(folder), "--sequence", "photographs-1", "--limit", "4", "--json", str(path)]
    assert main(arguments) == 0
    figures = json.loads(path.read_text())["sequences"]
    assert list(figures) == ["photographs-1"]
    assert figures["photographs-1"]["ours"]["link_precision"] > 0.9
