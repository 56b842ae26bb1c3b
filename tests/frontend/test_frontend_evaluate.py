"""The command that measures the tracker, and the clips it reads from folders."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

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


@pytest.fixture
def as_icl(posed: Path) -> Path:
    clip = PosedClip(posed)
    np.savetxt(posed / "calibration_matrix.txt", clip.K)
    rows = [[k, *pose[:, 3], *Rotation.from_matrix(pose[:, :3]).as_quat()] for k, pose in enumerate(clip.poses)]
    np.savetxt(posed / "poses.txt", rows)
    return posed


@pytest.fixture
def as_tum(posed: Path) -> Path:
    """Images every 0.1 s from 100 s on, and poses halfway between the true ones of images 0 and 1, 1 and 2, ..."""
    clip = PosedClip(posed)
    (posed / "images").rename(posed / "rgb")
    for k, path in enumerate(sorted((posed / "rgb").iterdir())):
        path.rename(posed / "rgb" / f"{100 + k / 10:.6f}.png")
    fx, fy, cx, cy = clip.K[[0, 1, 0, 1], [0, 1, 2, 2]]
    (posed / "calib.txt").write_text(f"{fx} {fy} {cx} {cy}\n")
    between = Slerp(np.arange(6), Rotation.from_matrix(clip.poses[:, :, :3]))(np.arange(5) + 0.5).as_quat()
    places = (clip.poses[1:, :, 3] + clip.poses[:-1, :, 3]) / 2
    rows = np.column_stack([100.05 + np.arange(5) / 10, places, between])
    np.savetxt(posed / "groundtruth.txt", rows, header="stamp x y z qx qy qz qw")
    return posed


def test_layout_of_icl_nuim(posed: Path, request: pytest.FixtureRequest) -> None:
    expected = PosedClip(posed)
    clip = PosedClip(request.getfixturevalue("as_icl"))
    assert pytest.approx(expected.K) == clip.K
    assert clip.poses == pytest.approx(expected.poses, abs=1e-9)


def test_layout_of_tum(posed: Path, request: pytest.FixtureRequest) -> None:
    expected = PosedClip(posed)
    clip = PosedClip(request.getfixturevalue("as_tum"))
    assert pytest.approx(expected.K) == clip.K
    assert [frame.stamp_ns for frame in clip] == [100_100_000_000 + k * 100_000_000 for k in range(4)]
    assert len(clip) == 4, "the first and the last image have no pose on both sides"
    assert clip.poses == pytest.approx(expected.poses[1:-1], abs=0.01), "interpolated"
    assert np.linalg.det(clip.poses[:, :, :3]) == pytest.approx(np.ones(4))


@pytest.mark.parametrize(
    ("layout", "name", "text", "message"),
    [
        ("as_icl", "calibration_matrix.txt", "1 0 0\n", "rows of 3"),
        ("as_icl", "poses.txt", "1 0 0 0 0 0 0 1\n", "6 images and 1 poses"),
        ("as_tum", "calib.txt", "1 2 3\n", "rows of 3"),
        ("as_tum", "groundtruth.txt", "100 0 0 0 0 0 0 1\n", "two poses"),
        ("as_tum", "groundtruth.txt", "7 0 0 0 0 0 0 1\n8 0 0 0 0 0 0 1\n", "no image"),
        ("as_tum", "rgb/first.png", "", "named by their stamps"),
    ],
)
def test_damaged_layouts(request: pytest.FixtureRequest, layout: str, name: str, text: str, message: str) -> None:
    folder = request.getfixturevalue(layout)
    (folder / name).write_text(text)
    with pytest.raises(InputError, match=message):
        PosedClip(folder)


def test_number_files(tmp_path: Path) -> None:
    path = tmp_path / "numbers.txt"
    path.write_text("# two\n1 2\n\n3e1 -4\n")
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
    (PosedClip, "calib.txt", "\n", "no camera calibration"),
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
    path, other = tmp_path / "figures.json", write_posed(tmp_path / "other")
    folders = ["--icl", str(labelled), "--posed", str(posed), str(other), "--worst", str(tmp_path / "worst")]
    names = ["static", "labelled", "posed", "other"]
    assert main(["--sequence", *names, *folders, "--limit", "8", "--json", str(path)]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    for word in (*names, "nearest", "flow", "IDF1", "stable, fused", "measured", "20-40 px", "17-32"):
        assert word in printed.out
    assert max(map(len, printed.out.splitlines())) <= 100
    figures = json.loads(path.read_text())
    assert set(figures["sequences"]) == set(figures["accuracy"]) == {"static", "labelled"}
    for clip in figures["sequences"].values():
        assert list(clip) == ["ours", "nearest", "flow"]
    for tracker in figures["sequences"]["static"].values():
        assert tracker["link_precision"] > 0.95, "nothing moves, so everybody must follow"
        assert tracker["link_recall"] > 0.9
        assert tracker["coverage"] > 0.7
        assert tracker["jitter_across_px"] < 0.5
        assert 0 < tracker["ms"] < 1000
    assert 0 < figures["accuracy"]["static"]["detected"]["across_px"] < 0.5
    assert list(figures["posed"]) == ["static", "posed", "other"], "poses of rendered clips are known"
    rows = figures["posed"]["posed"]
    assert list(rows) == ["ours", "fused", "stable", "stable, fused", "nearest", "flow"]
    for tracker in (rows["ours"], rows["fused"], rows["nearest"], rows["flow"]):
        assert tracker["tracks"] > 20
        assert tracker["share"] > 0.8, "an exact camera in a world that stands still"
        assert tracker["observations_per_frame"] > 20
    assert {path.name for path in (tmp_path / "worst").iterdir()} == {"static.png"}, "six frames are too few for others"


def test_two_clips_of_one_name(posed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--posed", str(posed), str(posed)]) == 2
    assert "two sequences are called 'posed'" in capsys.readouterr().err


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
