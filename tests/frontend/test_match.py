"""Pairs of lines of two images, against views of which it is known which line is which."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from airline import AirLine
from airline.errors import InputError
from airline.scenes import RenderedClip
from frontend import CameraModel, LineMatches, match_lines
from frontend.evaluate import main as evaluate
from frontend.evaluation import matches as measured
from frontend.evaluation.moved import moved_lines
from frontend.evaluation.truth import Truth, owners
from frontend.match import COLUMNS, main
from frontend.sources.stills import read_image
from tests.helpers.command import command, refusal

CLIP = RenderedClip("street", "handheld", 102, 60, min_contrast=1.0, merge_doubles=False)


@cache
def view(i: int):
    return CLIP.render(i)


@cache
def detector() -> AirLine:
    return AirLine()


def scores(matches: LineMatches, first: Truth, second: Truth) -> tuple[float, float]:
    """Share of the pairs that are right, and of the lines detected in both images that were paired."""
    one, other = owners(matches.first.segments, first), owners(matches.second.segments, second)
    a, b = one[matches.pairs[:, 0]], other[matches.pairs[:, 1]]
    known, right = (a >= 0) & (b >= 0), (a >= 0) & (a == b)
    return right.sum() / known.sum(), len(np.unique(a[right])) / len(np.intersect1d(one[one >= 0], other))


def truth(i: int) -> Truth:
    return Truth(view(i).segments_px, view(i).ids)


@pytest.mark.parametrize(("apart", "precision", "recall"), [(1, 0.99, 0.97), (15, 0.97, 0.92), (50, 0.9, 0.7)])
def test_near_and_wide_views(apart: int, precision: float, recall: float) -> None:
    pytest.importorskip("poselib", reason="PoseLib is not installed")
    matches = match_lines(view(0).image, view(apart).image, detector=detector())
    found = scores(matches, truth(0), truth(apart))
    assert found[0] >= precision, found
    assert found[1] >= recall, found
    assert [len(np.unique(rows)) for rows in matches.pairs.T] == [len(matches.pairs)] * 2
    assert ((matches.votes > 0) & (matches.votes <= 1)).all()


def test_an_essential_matrix_is_that_of_the_poses() -> None:
    pytest.importorskip("poselib", reason="PoseLib is not installed")
    height, width = view(0).depth.shape
    K = view(0).K
    camera = CameraModel(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    matches = match_lines(view(0).image, view(50).image, camera=camera, detector=detector())
    moved = np.linalg.inv(view(50).pose) @ view(0).pose
    expected = np.cross(moved[:3, 3], moved[:3, :3].T).T
    assert matches.geometry == "essential"
    cosine = (expected * matches.matrix).sum() / np.linalg.norm(expected) / np.linalg.norm(matches.matrix)
    assert abs(cosine) > 0.99


@pytest.mark.parametrize("degrees", [0, 30, 90, 180])
def test_turned_images_and_other_sizes(degrees: int) -> None:
    pytest.importorskip("poselib", reason="PoseLib is not installed")
    image = view(0).image
    size = (520, 600)
    turn = np.vstack([cv2.getRotationMatrix2D((319.5, 239.5), degrees, 0.9), [0, 0, 1]])
    turn = np.array([[1, 0, size[0] / 2 - 320], [0, 1, size[1] / 2 - 240], [0, 0, 1]]) @ turn
    other = cv2.warpPerspective(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), turn, size)  # grey beside colour
    matches = match_lines(image, other, detector=detector())
    assert matches.geometry == "homography"
    lines = matches.first.segments
    found = scores(matches, Truth(lines, np.arange(len(lines))), moved_lines(lines, turn, size))
    assert min(found) > 0.95, found
    a, b = matches.first.segments[matches.pairs[:, 0]], matches.second.segments[matches.pairs[:, 1]]
    directions = [np.diff(ends, axis=1)[:, 0] for ends in (a @ turn[:2, :2].T, b)]
    assert ((directions[0] * directions[1]).sum(axis=1) > 0).all(), "end points correspond"


def test_the_same_image_twice() -> None:
    matches = match_lines(view(0).image, view(0).image, detector=detector())
    assert (matches.pairs[:, 0] == matches.pairs[:, 1]).mean() > 0.99
    assert len(matches.pairs) > 0.97 * len(matches.first)
    assert (matches.first.segments == matches.second.segments).all()


@pytest.mark.parametrize("empty", [0, 1])
def test_an_image_without_lines(empty: int) -> None:
    images = [view(0).image, view(0).image]
    images[empty] = np.full((100, 120), 90, np.uint8)
    matches = match_lines(*images, detector=detector())
    assert (matches.pairs.shape, matches.votes.shape, matches.geometry) == ((0, 2), (0,), "none")
    assert matches.notes


def test_other_scenes_have_no_geometry_and_hardly_a_pair() -> None:
    other = RenderedClip("indoor", "static", 7).render(0).image
    matches = match_lines(view(0).image, other, detector=detector())
    assert matches.geometry == "none"
    assert len(matches.pairs) < 0.05 * len(matches.first)


def test_near_views_do_without_poselib(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "poselib", None)
    matches = match_lines(view(0).image, view(5).image, detector=detector())
    assert (matches.geometry, matches.inliers) == ("none", 0)
    assert "pip install 'airline-frontend[poses]'" in matches.notes[0]
    assert min(scores(matches, truth(0), truth(5))) > 0.9


@pytest.fixture
def images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, i in (("a", 0), ("b", 5)):
        cv2.imwrite(f"{name}.png", view(i).image)


@pytest.mark.usefixtures("images")
def test_the_command() -> None:
    outcome = command("a.png", "b.png", "--out", "pairs.csv", "--picture", "pairs.png", main=main)
    assert outcome.code == 0, outcome
    head, *rows = Path("pairs.csv").read_text().splitlines()
    assert head == COLUMNS
    matches = match_lines("a.png", Path("b.png"))
    table = np.array([row.split(",") for row in rows], float)
    assert table[:, :2].astype(int).tolist() == matches.pairs.tolist()
    assert table[:, 7:] == pytest.approx(matches.second.segments[matches.pairs[:, 1]].reshape(-1, 4), abs=1e-3)
    alone = len(matches.first) - len(rows), len(matches.second) - len(rows)
    assert f"pairs: {len(rows)}; alone: {alone[0]} and {alone[1]}\n" in outcome.out
    assert cv2.imread("pairs.png").shape == (480, 2 * (640 + 8), 3)


@pytest.mark.usefixtures("images")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("a.png none.png", "none.png"),
        ("a.png b.png --out pairs.parquet", ".csv"),
        ("a.png b.png --picture a.png", "it is an input"),
        ("a.png b.png --picture none/x.png", "folder that exists"),
        ("a.png b.png --calib b.png", "b.png"),
    ],
)
def test_what_cannot_be_used(arguments: str, said: str) -> None:
    assert said in refusal(*arguments.split(), main=main)


def test_an_animation_is_not_taken_for_its_first_picture(tmp_path):
    pictures = [Image.fromarray(np.full((24, 32), shade, np.uint8)) for shade in (10, 200)]
    pictures[0].save(tmp_path / "two.gif", save_all=True, append_images=pictures[1:])
    pictures[0].save(tmp_path / "one.gif")
    assert "animated" in refusal(tmp_path / "two.gif", tmp_path / "one.gif", main=main)


def test_views_of_a_plane_are_measured(tmp_path: Path) -> None:
    image = view(0).image[:240, :320]
    moved = np.array([[1.0, 0.1, 6], [-0.1, 1, 20], [0, 0, 1]])
    cv2.imwrite(str(tmp_path / "1.png"), image)
    cv2.imwrite(str(tmp_path / "2.png"), cv2.warpPerspective(image, moved, (340, 260)))
    np.savetxt(tmp_path / "H_1_2", moved)
    outcome = command("--match", tmp_path, "--json", tmp_path / "figures.json", main=evaluate)
    assert outcome.code == 0, outcome
    ours, near = (measured.match_figures(tmp_path)[f"{tmp_path.name} 1-2"][name] for name in ("votes", "nearest"))
    assert ours["f_3px"] > max(0.9, near["f_3px"])
    (tmp_path / "H_1_2").unlink()
    assert "no H_1_2" in refusal("--match", tmp_path, main=evaluate)


def test_rendered_and_labelled_frames_are_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measured, "KINDS", ("street",))
    monkeypatch.setattr(measured, "SEEDS", (102,))
    monkeypatch.setattr(measured, "APART", (15,))
    figures = measured.match_figures(None)["street, 15 apart"]
    assert figures["votes"]["f"] > max(0.9, figures["moved, nearest"]["f"])
    for part in ("images", "lines", "associations"):
        (tmp_path / part).mkdir()
    for name, i in (("0", 0), ("1", 1)):
        cv2.imwrite(str(tmp_path / "images" / f"{name}.png"), view(i).image)
    lines = [view(i).segments_px.reshape(-1, 4) + 0.5 for i in (0, 1)]
    for name, rows in zip("01", lines, strict=True):
        np.savetxt(tmp_path / "lines" / f"{name}.csv", rows, delimiter=",")
    whole = [np.unique(view(i).ids, return_index=True) for i in (0, 1)]  # the first piece of each line
    _, *rows = np.intersect1d(whole[0][0], whole[1][0], return_indices=True)
    table = np.column_stack([pieces[chosen] for (_, pieces), chosen in zip(whole, rows, strict=True)])
    np.savetxt(tmp_path / "associations" / "0_1.csv", table, delimiter=",")
    (group,) = measured.match_figures(tmp_path).values()
    assert group["votes"]["f"] > 0.95


@pytest.mark.parametrize("name", ["missing.png", "."])
def test_what_is_no_file_asks_for_one(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="give an image file"):
        read_image(tmp_path / name)
