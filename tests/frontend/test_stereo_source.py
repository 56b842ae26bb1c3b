"""Pairs of two sources and out of halves: every pair that exists, counts that add up, and each mistake by name."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airline.errors import AirLineError, ConfigError, InputError
from frontend import Frame, LineFrontend, open_source, open_stereo
from frontend.camera.model import CameraModel
from frontend.sources.pace import FreshFrames
from frontend.sources.pairs import find_pair, partner_of
from frontend.sources.stereo import SideBySide, StereoSource
from frontend.sources.wrapped import CalibratedFrames, SelectedFrames, UncalibratedFrames
from tests.helpers import rigs
from tests.helpers.command import command, refusal
from tests.helpers.sources import Listed, Seekable

STEP = 50_000_000
BLANK = np.zeros((48, 64), np.uint8)
PINHOLE = CameraModel(64, 48, 60.0, 60.0, 31.5, 23.5, rig_from_camera=np.eye(4))
BESIDE = replace(PINHOLE, cx=29.5, rig_from_camera=rigs.motion([0, 0, 0], [0.2, 0, 0]))


def listed(stamps: list[int], kind: type[Listed] = Listed, **options) -> Listed:
    return kind([Frame(index, stamp, BLANK) for index, stamp in enumerate(stamps)], **options)


def paired(source: StereoSource) -> list[int]:
    return [frame.stamp_ns for frame in source]


moments = st.lists(
    st.tuples(st.booleans(), st.booleans(), st.integers(-STEP // 8, STEP // 8), st.integers(-STEP // 8, STEP // 8)),
    max_size=40,
)


@given(moments=moments, given_gap=st.booleans(), offset=st.integers(-STEP // 20, STEP // 20))
@settings(max_examples=100)
def test_all_pairs_that_exist(moments: list[tuple[bool, bool, int, int]], given_gap: bool, offset: int) -> None:
    steady = [(True, True, 0, 0)] * 3 if not given_gap else []  # that tell the period
    times = [k * STEP for k in range(len(steady + moments))]
    lefts = [time + jitter for time, (there, _, jitter, _) in zip(times, steady + moments, strict=True) if there]
    rights = [
        time + jitter + offset for time, (_, there, _, jitter) in zip(times, steady + moments, strict=True) if there
    ]
    expected = [
        time + jitter for time, (left, right, jitter, _) in zip(times, steady + moments, strict=True) if left and right
    ]
    source = StereoSource(listed(lefts), listed(rights), rectified=True, max_gap_s=0.016 if given_gap else None)
    if not expected and lefts + rights:
        with pytest.raises(InputError, match="--max-stereo-gap"):
            paired(source)
        assert source.unpaired == (len(lefts), len(rights))
        return
    assert paired(source) == expected
    assert source.unpaired == (len(lefts) - len(expected), len(rights) - len(expected))
    assert sum(note.startswith("frames without a partner") for note in source.notes) == any(source.unpaired)


@given(
    left=st.sets(st.integers(0, 300), max_size=25),
    right=st.sets(st.integers(0, 300), max_size=25),
    step=st.sampled_from([1, 11]),
    jitter=st.lists(st.integers(-5, 5), min_size=25, max_size=25),
)
@settings(max_examples=100)
def test_any_times(left: set[int], right: set[int], step: int, jitter: list[int]) -> None:
    """One to one, within the gap, in order; and where each camera's frames are farther apart than twice the gap, no two
    that are left over are a pair, and nobody is nearer who was left."""
    lefts = [5 + step * k for k in sorted(left)]
    rights = sorted(5 + step * k + (off if step > 1 else 0) // 2 for k, off in zip(sorted(right), jitter, strict=False))
    if any(b - a <= 10 for a, b in pairwise(rights)):
        step = 1
    numbered = [Frame(k, stamp, np.full_like(BLANK, k)) for k, stamp in enumerate(rights)]
    source = StereoSource(listed(lefts), Listed(numbered), rectified=True, max_gap_s=5e-9)
    found: list[tuple[int, int]] = []
    try:
        for frame in source:
            assert frame.right is not None
            found.append((frame.stamp_ns, rights[frame.right[0, 0]]))
    except InputError:
        assert not found
    alone = [sorted(set(lefts) - {one for one, _ in found}), sorted(set(rights) - {one for _, one in found})]
    assert source.unpaired == tuple(map(len, alone))
    assert found == sorted(found)
    assert len({one for _, one in found}) == len(found)
    assert [one for _, one in found] == sorted(one for _, one in found)
    assert all(abs(one - other) <= 5 for one, other in found)
    for one, other in found if step > 1 else ():
        assert all(abs(one - lone) >= abs(one - other) for lone in alone[1])
        assert all(abs(other - lone) >= abs(one - other) for lone in alone[0])
    assert step == 1 or all(abs(one - other) > 5 for one in alone[0] for other in alone[1])


def test_a_frame_is_the_left_one_with_the_pairs_camera() -> None:
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (2, 48, 64), np.uint8)
    left = Listed([Frame(7, 100, images[0], PINHOLE, name="a/7.png")], skipped=2, name="left")
    right = Listed([Frame(9, 103, images[1], BESIDE, name="b/9.png")], skipped=3, name="right")
    source = StereoSource(left, right, max_gap_s=1e-8)
    (frame,) = source
    assert (frame.index, frame.stamp_ns, frame.name) == (7, 100, "a/7.png")
    assert frame.camera == replace(PINHOLE, baseline_m=0.2, disparity_offset=2.0)
    np.testing.assert_array_equal(frame.image, images[0])
    np.testing.assert_array_equal(frame.right, images[1])
    assert (source.name, source.skipped, source.frame_count, source.notes) == ("left", 5, 1, [])
    source.close()
    assert left.closed
    assert right.closed
    half = SelectedFrames(StereoSource(left, right, max_gap_s=1e-8), resize=(32, None))
    (small,) = half
    assert small.right is not None
    assert small.right.shape == small.image.shape == (24, 32)
    assert small.camera is not None
    assert (small.camera.baseline_m, small.camera.disparity_offset) == (0.2, 1.0)
    (plain,) = UncalibratedFrames(StereoSource(left, right, max_gap_s=1e-8))
    assert plain.camera is None
    assert plain.right is not None


@pytest.mark.parametrize("missing", [0, 2])
def test_images_without_times_are_paired_by_their_numbers(tmp_path: Path, missing: int) -> None:
    for side in ("left", "right"):
        pictures(tmp_path / side, 5)
    (gone := sorted((tmp_path / "right").iterdir())[missing]).unlink()
    source = open_stereo(tmp_path / "left", tmp_path / "right", rectified=True)
    assert [frame.name for frame in source] == [
        path.name for path in sorted((tmp_path / "left").iterdir()) if path.name != gone.name
    ]
    assert source.unpaired == (1, 0)
    assert source.notes[-1] == "frames without a partner of their number: 1 left, 0 right"


def test_a_gap_at_the_start_makes_no_pair_of_other_moments() -> None:
    lefts, rights = (listed([start, *(30 * STEP + k * STEP for k in range(5))]) for start in (0, STEP))
    source = StereoSource(lefts, rights, rectified=True)
    assert paired(source) == [30 * STEP + k * STEP for k in range(5)]
    assert source.unpaired == (1, 1)


def test_by_word_without_calibration() -> None:
    (frame,) = StereoSource(listed([0]), listed([0]), rectified=True)
    assert frame.camera is None
    assert frame.right is not None
    with pytest.raises(InputError, match="where the two cameras are"):
        next(iter(StereoSource(listed([0]), listed([0]))))


def test_what_is_seen_of_unrectified_cameras() -> None:
    cameras = rigs.rig()
    stamps = [0, STEP]
    image = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    sides = [Listed([Frame(k, stamp, image, camera) for k, stamp in enumerate(stamps)]) for camera in cameras]
    source = StereoSource(*sides)
    first, second = source
    assert source.notes == ["both images are rectified by their calibration"]
    assert first.camera is second.camera
    assert first.camera is not None
    assert first.camera.distortion == "none"
    assert first.camera.baseline_m == pytest.approx(np.linalg.norm([0.12, 0.006, 0.004]))
    assert first.image.shape == first.right.shape == image.shape  # type: ignore[union-attr]
    joined = Listed([Frame(k, stamp, np.hstack([image, image])) for k, stamp in enumerate(stamps)])
    halves = list(SideBySide(joined, *cameras))
    np.testing.assert_array_equal(halves[1].image, second.image)
    np.testing.assert_array_equal(halves[1].right, second.right)


@pytest.mark.parametrize("start", [0.0, 0.31, 0.55, 99.0])
def test_seek(start: float) -> None:
    lefts = [k * STEP + 10**9 for k in range(20)]
    rights = [stamp - 7_000_000 for stamp in [10**9 - STEP, 10**9 - 2 * STEP + 10**7, *lefts] if stamp]
    rights = sorted(rights)
    del rights[14]  # the partner of the left frame 12
    source = StereoSource(listed(lefts, Seekable), listed(rights, Seekable), rectified=True)
    whole = paired(StereoSource(listed(lefts), listed(rights), rectified=True))
    assert len(whole) == 19
    assert paired(SelectedFrames(source, start_s=start)) == [  # type: ignore[arg-type]
        stamp for stamp in whole if stamp >= lefts[0] + start * 1e9
    ]
    assert source.unpaired == ((1 if start < 0.6 else 0), 2 if not start else 0)


@pytest.mark.parametrize(
    ("images", "said"),
    [
        ((BLANK, BLANK[:40]), "one size and depth, not 64x48 px of 8 bits and 64x40 px"),
        ((BLANK, BLANK.astype(np.uint16)), "one size and depth"),
    ],
)
def test_unlike_images(images: tuple[np.ndarray, np.ndarray], said: str) -> None:
    sides = [Listed([Frame(0, 0, image)]) for image in images]
    with pytest.raises(InputError, match=said):
        next(iter(StereoSource(*sides, rectified=True)))


def test_a_grey_and_a_colour_camera() -> None:
    sides = Listed([Frame(0, 0, BLANK)]), Listed([Frame(0, 0, cv2.cvtColor(BLANK, cv2.COLOR_GRAY2BGR))])
    (frame,) = StereoSource(*sides, rectified=True)
    assert frame.right_gray is not None
    assert frame.right_gray.shape == BLANK.shape


def test_an_odd_width() -> None:
    with pytest.raises(InputError, match="63 px wide has no two halves"):
        next(iter(SideBySide(Listed([Frame(0, 0, BLANK[:, 1:])]), rectified=True)))


class Clocked(Listed):
    """A camera whose frames come when they come."""

    live = True

    def __iter__(self) -> Iterator[Frame]:
        begin = time.perf_counter()
        for frame in self.frames:
            time.sleep(max(0.0, begin + frame.stamp_ns / 1e9 - time.perf_counter()))
            yield frame


def test_two_live_cameras() -> None:
    lefts, rights = [k * 30_000_000 for k in range(12)], [k * 30_000_000 + 4_000_000 for k in range(12) if k != 5]
    left, right = listed(lefts, Clocked), listed(rights, Clocked)
    source = StereoSource(left, right, rectified=True)
    fresh = FreshFrames(source, max_latency_s=5.0)
    found = [frame.stamp_ns for frame in fresh]
    fresh.close()
    assert source.live
    assert fresh.dropped == source.dropped
    assert len(found) + fresh.dropped + source.unpaired[0] <= 12
    assert set(found) <= set(lefts) - {lefts[5]}
    assert len(found) >= 8  # of 11, on a busy machine
    assert "camera ended, and with it the pairs" in source.notes[-1 - any(source.unpaired)]
    assert left.closed
    assert right.closed
    with pytest.raises(ConfigError, match="two of a kind"):
        StereoSource(listed(lefts, Clocked), listed(rights))


@pytest.mark.parametrize(
    ("left", "right"),
    [
        *(("cam0", "cam1"), ("image_0", "image_1"), ("image_02", "image_03"), ("image_l", "image_r")),
        *(("images", "images_right"), ("left", "right"), ("/cam0/image_raw", "/cam1/image_raw")),
        ("/stereo/left/image_rect_color/compressed", "/stereo/right/image_rect_color/compressed"),
        *(("/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw"), ("walk_left.mp4", "walk_right.mp4")),
        *(("cleft", None), ("image_1", None), ("cam01", None), ("right", None), ("images_right", None)),
    ],
)
def test_names_of_partners(left: str, right: str | None) -> None:
    assert partner_of(left) == right


def pictures(folder: Path, count: int = 3, width: int = 64) -> Path:
    folder.mkdir(parents=True)
    rng = np.random.default_rng(width)
    for number in range(count):
        cv2.imwrite(str(folder / f"{number:06}.png"), rng.integers(0, 256, (48, width), np.uint8))
    return folder


@pytest.mark.parametrize(
    ("layout", "given_path"),
    [
        *((("mav0/cam0/data", "mav0/cam1/data"), path) for path in ("", "mav0", "mav0/cam0", "mav0/cam0/data")),
        *((("image_0", "image_1", "image_2", "image_3"), path) for path in ("", "image_0")),
        *((("images", "images_right"), path) for path in ("", "images")),
        (("left", "right", "depth_left", "depth_right"), ""),
    ],
)
def test_layouts(tmp_path: Path, layout: tuple[str, ...], given_path: str) -> None:
    for name in layout:
        pictures(tmp_path / name)
    source = open_stereo(tmp_path / given_path, rectified=True)
    left, right = (open_source(tmp_path / name) for name in layout[:2])
    for pair, one, other in zip(source, left, right, strict=True):
        np.testing.assert_array_equal(pair.image, one.image)
        np.testing.assert_array_equal(pair.right, other.image)
        assert pair.name == one.name
    if layout[0] == "image_0":
        assert find_pair(str(tmp_path / "image_2")) == (str(tmp_path / "image_2"), str(tmp_path / "image_3"))


def test_the_library_takes_pairs(tmp_path: Path) -> None:
    left, right = pictures(tmp_path / "a"), pictures(tmp_path / "b", 2)
    source = open_stereo(left, right, rectified=True)
    assert len([*LineFrontend().stream(source)]) == 2
    assert source.unpaired == (1, 0)
    sources = [CalibratedFrames(open_source(one), camera) for one, camera in ((left, PINHOLE), (right, BESIDE))]
    assert [frame.camera and frame.camera.baseline_m for frame in open_stereo(*sources)] == [0.2, 0.2]
    for wrong in ((left,), (open_source(left),), (left, tmp_path / "none")):
        with pytest.raises(AirLineError):
            open_stereo(*wrong)


@pytest.fixture
def kitti(tmp_path: Path) -> Path:
    pictures(tmp_path / "image_0", 4)
    pictures(tmp_path / "image_1", 3)
    row = "60 0 31.5 {} 0 60 23.5 0 0 0 1 0"
    rigs.write(tmp_path / "calib.txt", f"P0: {row.format(0)}\nP1: {row.format(-30)}\n")
    return tmp_path


def test_a_run_says_that_it_is_a_pair(kitti: Path, tmp_path: Path) -> None:
    summary = tmp_path / "summary.json"
    done = command(kitti, "--stereo", "--headless", "--out", tmp_path / "t.parquet", "--summary", summary)
    assert done.code == 0, done.err
    assert "pairs of 'image_0' and 'image_1' by number" in done.out.splitlines()[0]
    assert "P0 of" in done.out.splitlines()[1]
    assert "P1 of" in done.out.splitlines()[1]
    assert "stereo:      baseline 0.5 m" in done.out
    assert "note: frames without a partner of their number: 1 left, 0 right" in done.out
    assert "3 (1 unpaired of the left)" in done.out
    assert '"unpaired_left": 1' in summary.read_text()
    info = command(kitti, "--stereo", "--calib", "none", "--rectified", "--info")
    assert "stereo:      no baseline is known, so there are no metres" in info.out


@pytest.mark.parametrize(
    "flags",
    [
        "{0}/image_0 --stereo --info",
        "{0}/image_0 --right {0}/image_1 --info",
        "{0}/image_0 --right {0}/image_1 --calib {0}/calib.txt --max-stereo-gap 0.01 --info",
        "{0}/image_0 --right {0}/image_1 --calib {0}/calib.txt --right-calib {0}/calib.txt --undistort --info",
        "{0} --stereo --resize 64 --start 0.03 --rectified --info",
    ],
)
def test_ways_to_say_it(kitti: Path, flags: str) -> None:
    done = command(*flags.format(kitti).split())
    assert done.code == 0, done.err
    assert "baseline 0.5 m" in done.out


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ("{0} --rectified", "are for pairs"),
        ("{0} --max-stereo-gap 1", "are for pairs"),
        ("{0} --calib a --right-calib b", "are for pairs"),
        ("{0} --stereo --right-calib b", "--calib"),
        ("{0} --stereo --calib none --right-calib b", "--calib"),
        ("{0} --side-by-side --right x", "leave --right"),
        ("{0} --side-by-side --max-stereo-gap 1", "leave --right"),
        ("{0} --stereo --calib none", "or say --rectified"),
        ("{0}/image_1 --right {0}/image_0", "swap the two"),
        ("{0}/image_1 --stereo", "no second camera.*--right"),
        ("{0}/image_0 --stereo --right-topic /right", "a topic is for logs"),
        ("{0}/image_0 --right {0}/none", "there is no video file"),
        ("{0}/image_0 --stereo --log-image video", "--log-image jpeg"),
        ("{0}/image_0 --side-by-side", "where the two cameras are"),
        ("--side-by-side", "give --stereo alone"),
        ("--right x", "give --stereo alone"),
    ],
)
def test_flags_that_do_not_go_together(kitti: Path, flags: str, said: str) -> None:
    assert re.search(said, refusal(*flags.format(kitti).split(), "--headless"))


def test_bare_rows_and_what_may_be_the_left_cameras_alone(tmp_path: Path) -> None:
    for name in ("images", "images_right"):
        pictures(tmp_path / name)
    row = "60 0 31.5 {} 0 60 23.5 0 0 0 1 0\n"
    file = rigs.write(tmp_path / "calib.txt", row.format(0) + row.format(-30))
    done = command(tmp_path, "--stereo", "--info")
    assert "row 1 of" in done.out
    assert "row 2 of" in done.out
    assert "baseline 0.5 m" in done.out
    file.unlink()
    rigs.write(tmp_path / "calib.yaml", "{width: 64, height: 48, fx: 60, fy: 60, cx: 31.5, cy: 23.5}")
    assert "where the two cameras are" in refusal(tmp_path, "--stereo", "--info")


def test_two_halves_by_the_command_line(kitti: Path) -> None:
    pictures(kitti / "joined", width=128)
    done = command(kitti / "joined", "--side-by-side", "--calib", kitti / "calib.txt", "--info")
    assert done.code == 0, done.err
    for text in ("size:        64x48 grey", "two halves side by side", "P0 of", "P1 of", "baseline 0.5 m"):
        assert text in done.out
