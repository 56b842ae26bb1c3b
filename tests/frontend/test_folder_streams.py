"""Which pictures of a folder are frames: colour among depth and labels, one of two cameras; depth alone is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from airline.errors import InputError
from frontend.sources import open_source
from tests.helpers.command import command
from tests.helpers.numbered import number_of, numbered, write_numbered

DEPTH = np.random.default_rng(0).integers(400, 5000, (48, 96)).astype(np.uint16)


def depth_image(path: Path, kind: type = np.uint16) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), DEPTH.astype(kind))


BESIDE = {  # names of colour and of what lies beside it
    "7-Scenes": ("frame-{:06d}.color.png", ["frame-{:06d}.depth.png"]),
    "ScanNet": ("frame-{:06d}.color.jpg", ["frame-{:06d}.depth.pgm"]),
    "words first": ("rgb_{:04d}.png", ["depth_{:04d}.png"]),
    "words last": ("{:04d}_rgb.png", ["{:04d}_depth.png", "{:04d}_mask.png"]),
    "no word for colour": ("frame{:06d}.jpg", ["depth{:06d}.png"]),
    "labels": ("{:04d}.png", ["{:04d}_seg.png", "{:04d}_normal.png"]),
    "disparity": ("{:04d}_left.png", ["{:04d}_disparity.png"]),
    "Cityscapes": (
        "aachen_{:06d}_000019_leftImg8bit.png",
        ["aachen_{:06d}_000019_gtFine_color.png", "aachen_{:06d}_000019_gtFine_labelIds.png"],
    ),
    "other numbers": ("{:04d}_rgb8.png", ["{:04d}_ir16.png"]),
    "depth as colour sees it": ("{:04d}_color.png", ["{:04d}_aligned_depth_to_color.png"]),
    "camel case": ("frameColor{:04d}.png", ["frameDepth{:04d}.png"]),
}


@pytest.mark.parametrize("given", ["", "*", "*.*"])
@pytest.mark.parametrize("layout", BESIDE)
def test_colour_among_depth(tmp_path: Path, layout: str, given: str) -> None:
    colour, others = BESIDE[layout]
    write_numbered(tmp_path, [colour.format(k) for k in range(12)])
    for other in others:
        for k in range(12):
            depth_image(tmp_path / other.format(k))
    source = open_source(tmp_path / given)
    assert [number_of(frame.image) for frame in source] == list(range(12))
    (note,) = (note for note in source.notes if "left out" in note)
    assert f"{12 * len(others)} image" in note or "12 like" in note


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("left_{:04d}.png", "right_{:04d}.png"),
        ("{:04d}_L_left.png", "{:04d}_R_right.png"),
        ("cam0_{:04d}.png", "cam1_{:04d}.png"),
        ("image_0_{}.png", "image_1_{}.png"),
        ("{:04d}_color.png", "{:04d}_ir.png"),
        ("rgb{:04d}.jpg", "nir{:04d}.png"),
    ],
)
def test_one_of_two_cameras(tmp_path: Path, first: str, second: str) -> None:
    write_numbered(tmp_path, [form.format(k) for form in (first, second) for k in range(12)])
    source = open_source(tmp_path)
    assert [number_of(frame.image) for frame in source] == list(range(12))
    assert [note for note in source.notes if "12 like" in note and "glob pattern chooses others" in note]
    pattern = tmp_path / second.replace("{:04d}", "*").replace("{}", "*")
    assert [number_of(frame.image) for frame in open_source(pattern)] == list(range(12, 24))


def test_two_kinds_that_take_turns_are_asked_for(tmp_path: Path) -> None:
    write_numbered(tmp_path, [f"{k:04d}_{word}.png" for k in range(6) for word in ("near", "far")])
    outcome = command(tmp_path, "--headless")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "'0000_near.png' and" in outcome.err or "and '0000_near.png'" in outcome.err
    assert "choose by a glob pattern" in outcome.err
    assert len(list(open_source(tmp_path / "*_far.png"))) == 6


def test_series_of_photographs_stay_together(tmp_path: Path) -> None:
    write_numbered(tmp_path, [f"{word}{k}.png" for word in ("boat", "graf") for k in range(1, 7)])
    source = open_source(tmp_path)
    assert [number_of(frame.image) for frame in source] == list(range(12))
    assert [note for note in source.notes if "series like" in note]


def test_collections_of_photographs_are_left_alone(tmp_path: Path) -> None:
    names = [f"house_{room}_{k}.png" for room in ("bath", "bed", "hall", "kitchen", "garden") for k in range(2)]
    write_numbered(tmp_path, [*names, *(f"street_{word}.png" for word in "abcdef")])
    write_numbered(tmp_path, [f"{k}_{word}.png" for k in range(2) for word in ("near", "far")])
    assert len(list(open_source(tmp_path))) == 20


def test_folders_of_a_glob_are_told_apart(tmp_path: Path) -> None:
    write_numbered(tmp_path / "rgb", [f"{k}.png" for k in range(4)])
    for k in range(4):
        depth_image(tmp_path / "depth" / f"{k}.png")
    source = open_source(tmp_path / "*" / "*.png")
    assert [number_of(frame.image) for frame in source] == list(range(4))
    assert [note for note in source.notes if note.startswith("4 images like")]


@pytest.mark.parametrize(
    "name",
    [
        "depth/{}.png",
        "depth_raw/{}.png",
        "aligned_depth_to_color/{}.png",
        "{}_depth2rgb.png",
        "DepthToColor/{}.png",
        "depth_{}.png",
        "{}.depth.pgm",
        "disparity/{}.png",
        "disp_{}.png",
    ]
    + ["aligned_depth_to_color/{}.png", "{}_depth2rgb.png", "DepthToColor/{}.png"]
    + ["proj_depth/groundtruth/image_02/{}.png", "Depth/{}.tif"],
)
@pytest.mark.parametrize("kind", [np.uint16, np.uint8])
def test_depth_is_refused(tmp_path: Path, name: str, kind: type) -> None:
    for k in range(3):
        depth_image(tmp_path / name.format(k), kind)
    write_numbered(tmp_path / "rgb", ["0.png"])
    folder = (tmp_path / name).parent
    for spec in (folder, folder / f"*{Path(name).suffix}", tmp_path / name.format(1)):
        outcome = command(spec, "--headless")
        assert (outcome.code, outcome.err.count("\n")) == (2, 1)
        assert "holds depth by its name, which is measured, not seen" in outcome.err
        assert "Traceback" not in outcome.err


def test_a_folder_of_folders_stands_for_the_first_that_is_none_of_depth(tmp_path: Path) -> None:
    depth_image(tmp_path / "depth" / "0.png")
    for name in ("rgb", "right"):
        write_numbered(tmp_path / name, ["0.png", "1.png"])
    source = open_source(tmp_path)
    assert [number_of(frame.image) for frame in source] == [0, 1]
    assert source.notes[0] == "the images of its folder 'rgb' are taken, not 'right'"
    for k in range(9):
        write_numbered(tmp_path / f"trip{k}", ["0.png"])
    with pytest.raises(InputError, match="its folder 'rgb' has some: give that or another"):
        open_source(tmp_path)


def test_depth_of_tum_and_icl(tmp_path: Path) -> None:
    for k in range(3):
        depth_image(tmp_path / "depth" / f"1305031102.{k}00000.png")
    write_numbered(tmp_path / "rgb", [f"1305031102.{k}50000.png" for k in range(3)])
    for name in ("rgb", "depth"):
        rows = "".join(f"{path.stem} {name}/{path.name}\n" for path in sorted((tmp_path / name).iterdir()))
        (tmp_path / f"{name}.txt").write_text(rows)
    assert [number_of(frame.image) for frame in open_source(tmp_path)] == [0, 1, 2]
    with pytest.raises(InputError, match="holds depth"):
        list(open_source(tmp_path / "depth"))


@pytest.mark.parametrize("folder", ["thermal", "nir", "flir_left", "images", "my_depth_estimation_experiments_2"])
@pytest.mark.parametrize("single", [False, True])
def test_what_is_seen_in_16_bits_is_shown(tmp_path: Path, folder: str, single: bool) -> None:
    for k in range(3):
        path = tmp_path / folder / f"{k}.png"
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), numbered(k, grey=True).astype(np.uint16) * 50 + 7000)
    source = open_source(tmp_path / folder / "1.png" if single else tmp_path / folder)
    images = [frame.image for frame in source]
    assert [number_of(image - 7000) for image in images] == ([1] if single else [0, 1, 2])
    assert {image.dtype for image in images} == {np.dtype(np.uint16)}
    assert sum("taken for what a camera sees" in note for note in source.notes) == 1


def test_colour_that_is_named_depth_is_shown(tmp_path: Path) -> None:
    write_numbered(tmp_path / "depth", ["0.png", "1.png"])
    assert len(list(open_source(tmp_path / "depth"))) == 2
