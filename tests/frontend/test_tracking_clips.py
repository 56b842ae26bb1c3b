"""The clips that trackers are measured on: the same frames each time, and true lines where they are said to be."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from airline.errors import InputError
from airline.scenes import RenderedClip
from frontend.evaluation.moved import MovedPhoto, moved_photos
from frontend.evaluation.rendered import RADIUS, SceneClip, occlude, occluder_discs, rendered_clips
from frontend.evaluation.truth import Truth
from frontend.frame import Frame
from frontend.sources.scene import frame_of

NAMES = ["static", "slow", "handheld", "fast", "dark", "exposure", "occlusion", "repeated"]
SIZE = (640, 480)


@cache
def clips() -> dict[str, SceneClip]:
    return {clip.name: clip for clip in rendered_clips() if isinstance(clip, SceneClip)}


def grey(frame: Frame) -> NDArray[np.float32]:
    image = frame.image if frame.image.ndim == 2 else cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY)
    return np.asarray(image, np.float32)


def steps_across(image: NDArray[np.float32], segments: NDArray[np.float32]) -> NDArray[np.float64]:
    """(N,) mean difference of grey levels between the two sides of each segment, 1.5 px from it."""
    steps = []
    for start, end in segments:
        along = (end - start) / np.hypot(*(end - start))
        points = start + np.linspace(0.1, 0.9, 41)[:, None] * (end - start)
        normal = 1.5 * np.array([-along[1], along[0]])
        sides = [
            cv2.remap(image, (points + s * normal).astype(np.float32)[None], None, cv2.INTER_LINEAR) for s in (-1, 1)
        ]
        # Along a checkerboard's joint the steps change sign: average the noise over a few pixels only.
        steps.append(np.abs(cv2.blur(sides[0] - sides[1], (5, 1))).mean())
    return np.array(steps)


def hidden_at(points: NDArray[np.float32], i: int) -> NDArray[np.bool_]:
    """(...) mask of the points (..., 2), px, behind the discs of frame `i`."""
    offset = points[..., None, :] - occluder_discs(i, *SIZE)
    return np.asarray((np.square(offset).sum(axis=-1) < RADIUS**2).any(axis=-1))


def same(a: tuple[Frame, Truth], b: tuple[Frame, Truth]) -> bool:
    return (
        np.array_equal(a[0].image, b[0].image)
        and np.array_equal(a[1].segments_px, b[1].segments_px)
        and np.array_equal(a[1].ids, b[1].ids)
        and (a[0].index, a[0].stamp_ns) == (b[0].index, b[0].stamp_ns)
    )


@pytest.mark.parametrize("name", ["handheld", "exposure", "occlusion"])
def test_rendered_frames_are_the_same_each_time_and_carry_their_camera(name: str) -> None:
    clip = clips()[name]
    frame, truth = clip.at(26)
    assert list(clips()) == NAMES
    again = {other.name: other for other in rendered_clips()}[name]
    assert same((frame, truth), again.at(26))
    assert (frame.index, frame.stamp_ns, frame.image.shape) == (26, round(26e9 / 30), (480, 640, 3))
    assert frame.camera is not None
    assert (frame.camera.width, frame.camera.height, frame.camera.distortion) == (640, 480, "none")
    assert (truth.segments_px.dtype, truth.ids.dtype) == (np.float32, np.int64)
    assert len(truth.ids) == len(truth.segments_px) > 100
    assert (truth.segments_px >= -0.5 - 1e-3).all()
    assert (truth.segments_px <= np.array(SIZE) - 1 + 1e-3).all()
    next_truth = clip.at(27)[1]
    assert len(np.intersect1d(truth.ids, next_truth.ids)) > 0.6 * len(np.unique(truth.ids))


@pytest.mark.parametrize("name", ["slow", "repeated", "occlusion"])
def test_true_lines_are_steps_of_the_image(name: str) -> None:
    frame, truth = clips()[name].at(20)
    assert (steps_across(grey(frame), truth.segments_px) > 5).mean() > 0.85  # the truth holds faint lines, too


def test_dark_has_a_quarter_of_the_grey_levels_and_exposure_jumps_by_two() -> None:
    dark = clips()["dark"].takes[0]
    lit = replace(dark, effects=replace(dark.effects, exposure=1.0, noise_sigma=0.0))
    assert clips()["dark"].at(10)[0].image.mean() < 0.3 * lit.render(10).image.mean()
    jumps = clips()["exposure"]
    ratios = [jumps.at(i)[0].image.mean() / jumps.at(i - 1)[0].image.mean() for i in (12, 24, 36, 48)]
    # Twice the light is 1.37 times the grey level, less where it clips.
    assert np.allclose(np.abs(np.log2(ratios)), 1 / 2.2, atol=0.12)
    assert np.array_equal(np.sign(np.log2(ratios)), [1, -1, -1, 1])
    assert jumps.at(13)[0].image.mean() == pytest.approx(jumps.at(14)[0].image.mean(), rel=0.03)


def test_the_occluder_hides_what_its_mask_covers_and_nothing_else() -> None:
    clip = clips()["occlusion"]
    view = clip.takes[0].render(16)
    bare, full = frame_of(16, view), Truth(view.segments_px, view.ids)
    frame, truth = occlude(bare, full)
    pixels = np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=-1).astype(np.float32)
    mask = hidden_at(pixels, 16)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    outer = cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert 0.15 < mask.mean() < 0.5
    assert np.array_equal(frame.image[~outer], bare.image[~outer])
    assert (frame.image[inner] != bare.image[inner]).any(axis=1).mean() > 0.99

    assert set(truth.ids) <= set(full.ids)
    assert not hidden_at(truth.segments_px.mean(axis=1), 16).any()


# Moved photographs. The "photograph" is a rendered street: it is in the repository, and it has lines.


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("streets")
    for seed in range(4):
        image = RenderedClip("street", "static", seed + 1, 1, size=(320, 240), effects=None).render(0).image
        cv2.imwrite(str(path / f"{seed}.png"), image)
    return path


@pytest.fixture(scope="module")
def photo(folder: Path) -> MovedPhoto:
    clip = moved_photos(folder, count=1, frames=5)[0]
    assert isinstance(clip, MovedPhoto)
    return clip


def test_moved_photos_are_spread_over_the_folder_and_the_same_each_time(folder: Path) -> None:
    clips = moved_photos(folder, count=2, frames=5)
    assert [clip.name for clip in clips] == [f"{folder.name}-1", f"{folder.name}-2"]
    assert len(moved_photos(folder, count=9)) == 4
    last = cv2.imread(str(folder / "3.png"), cv2.IMREAD_GRAYSCALE)
    assert isinstance(clips[1], MovedPhoto)
    assert np.abs(clips[1].photo.astype(int) - last).max() <= 1
    frames = list(clips[0])
    assert all(same(a, b) for a, b in zip(frames, moved_photos(folder, count=2, frames=5)[0], strict=True))
    assert not np.array_equal(frames[0][0].image, frames[1][0].image)
    assert [(frame.index, frame.image.shape) for frame, _ in frames] == [(k, (180, 240)) for k in range(5)]


def test_true_lines_of_a_photograph_are_steps_of_every_frame(photo: MovedPhoto) -> None:
    ids = []
    for frame, truth in photo:
        assert len(truth.ids) == len(np.unique(truth.ids)) > 20
        assert (truth.segments_px >= -0.5 - 1e-3).all()
        assert (truth.segments_px <= np.array(photo.size) - 0.5 + 1e-3).all()
        assert (steps_across(grey(frame), truth.segments_px) > 5).mean() > 0.9
        ids.append(truth.ids)
    assert len(np.intersect1d(ids[0], ids[-1])) > 20


def test_folders_without_photographs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        moved_photos(tmp_path / "nowhere")
    with pytest.raises(InputError):
        moved_photos(tmp_path)
    (tmp_path / "a.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"a\.png"):
        moved_photos(tmp_path)
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((100, 300), np.uint8))
    with pytest.raises(InputError, match="300x100"):
        moved_photos(tmp_path)
