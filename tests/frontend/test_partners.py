"""Partners of tracked lines in the right image, and what they tell of space, against rendered and computed truth."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airline.detector import AirLine
from airline.errors import ConfigError, InputError
from airline.lines import LineSet
from airline.scenes import RenderedClip
from frontend import CameraModel, Frame, LineFrontend, LineTracks, Source
from frontend.evaluation.stereo import PairTruth, pairs_of, partner_scores
from frontend.protocols import FrameResult
from frontend.sources.scene import frame_of
from frontend.stereo.alignment import aligned
from frontend.stereo.disparity import disparities, in_metres
from frontend.stereo.partners import PartnerFinder
from frontend.tracker import LineTracker

CLIP = RenderedClip("indoor", "handheld", 50, 6, min_contrast=1.0, merge_doubles=False)
CAMERA = CameraModel(640, 480, 500.0, 500.0, 319.5, 239.5, baseline_m=0.2, disparity_offset=3.0)
ERRORS = np.diag([0.1**2, 0.002**2]).astype(np.float32)[None]
BOTH = ERRORS, 1.25 * ERRORS  # of a line and its partner, which errs as that does, and half as much on its own


class Given(Source):
    name = "given"

    def __init__(self, frames: list[Frame]) -> None:
        self._frames = frames

    def __iter__(self):
        return iter(self._frames)


@cache
def views():
    return [(CLIP.render(i), CLIP.render(i, right=True)) for i in range(len(CLIP))]


def frames() -> list[Frame]:
    return [frame_of(i, *pair) for i, pair in enumerate(views())]


@cache
def results() -> list[FrameResult]:
    return list(LineFrontend(AirLine(threads=1)).results(Given(frames()), serial=True))


def seen(ends: np.ndarray, camera: CameraModel = CAMERA) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2, 2) images of points in the left camera's frame, in both cameras."""
    left = camera.fx * ends[..., :2] / ends[..., 2:] + (camera.cx, camera.cy)
    right = left.copy()
    right[..., 0] -= camera.fx * camera.baseline_m / ends[..., 2] + camera.disparity_offset
    return left.astype(np.float32), right.astype(np.float32)


POINT = st.tuples(st.floats(-2, 2), st.floats(-1.5, 1.5), st.floats(1, 10))


@given(POINT, POINT, st.floats(-1, 2), st.floats(-1, 2))
def test_a_line_in_space_comes_back_from_its_images(first, last, low, high):
    ends = np.array([[first, last]])
    left, right = seen(ends)
    delta = left[0, 1] - left[0, 0]
    steep = abs(delta[1]) > 0.25 * np.hypot(*delta) and np.hypot(*delta) > 30
    other = right[0, 1] - right[0, 0]
    if not steep or abs(other[1]) <= 0.25 * np.hypot(*other) or abs(high - low) < 0.2:
        return
    part = right[:, :1] + np.array([low, high])[None, :, None] * (right[:, 1:] - right[:, :1])  # other ends
    part = part[:, ::-1] if high < low else part
    both = left, BOTH[0], part.astype(np.float32), BOTH[1]
    disparity, covariances, known = disparities(*both, CAMERA.disparity_offset)
    assert disparity == pytest.approx(left[..., 0] - right[..., 0], abs=0.02)
    points, spread = in_metres(*both, np.array([True]), CAMERA)
    assert points == pytest.approx(ends, rel=0.01, abs=0.01)
    assert (np.linalg.eigvalsh(covariances) > 0).all()
    assert (np.linalg.eigvalsh(spread.astype(np.float64)) > -1e-6 * np.abs(spread).max()).all()
    if known:
        assert (points[..., 2] > 0).all()


def test_covariances_are_those_of_noisy_lines():
    rng, ends = np.random.default_rng(0), np.array([[[0.5, -0.6, 3.0], [0.9, 0.7, 3.6]]])
    left, right = seen(ends)
    offset, angle = (
        np.array([[1, 0], [1, 0.5]]) @ rng.standard_normal((2, 20_000)) * s for s in np.sqrt(np.diagonal(ERRORS[0]))
    )

    def noisy(line, o, a):
        delta = line[0, 1] - line[0, 0]
        n = np.array([-delta[1], delta[0]]) / np.hypot(*delta)
        across = np.stack([o - a * np.hypot(*delta) / 2, o + a * np.hypot(*delta) / 2], axis=1)
        return line + across[..., None] * n

    lines = noisy(left, offset[0], angle[0]), noisy(right, offset[1], angle[1])
    x_left, x_right = (
        line[:, :1, 0]
        + (left[..., 1] - line[:, :1, 1]) * ((line[:, 1:, 0] - line[:, :1, 0]) / (line[:, 1:, 1] - line[:, :1, 1]))
        for line in lines
    )
    disparity = x_left - x_right
    z = CAMERA.fx * CAMERA.baseline_m / (disparity - CAMERA.disparity_offset)
    points = np.stack([(x_left - CAMERA.cx) / CAMERA.fx * z, (left[..., 1] - CAMERA.cy) / CAMERA.fy * z, z], axis=2)
    both = left, BOTH[0], right, BOTH[1]
    _, covariances, known = disparities(*both, CAMERA.disparity_offset)
    assert covariances[0] == pytest.approx(np.cov(disparity.T), rel=0.05, abs=2e-4)
    _, spread = in_metres(*both, known, CAMERA)
    assert spread[0] == pytest.approx(np.cov(points.reshape(-1, 6).T), rel=0.1, abs=2e-6)


def test_lines_along_the_rows_and_at_infinity_tell_no_depth():
    left = np.array([[[100, 50], [200, 52]], [[100, 50], [120, 150]], [[100, 50], [120, 150]]], np.float32)
    right = left - np.array([[20, 0]], np.float32)
    right[1] = left[1] - np.array([CAMERA.disparity_offset + 0.1, 0], np.float32)
    errors, more = (np.repeat(one, 3, axis=0) for one in BOTH)
    disparity, _, known = disparities(left, errors, right, more, CAMERA.disparity_offset)
    assert known.tolist() == [False, False, True]
    assert np.isnan(disparity[0]).all()
    assert np.isfinite(disparity[1:]).all()
    points, spread = in_metres(left, errors, right, more, known, CAMERA)
    assert np.isnan(points[:2]).all()
    assert np.isnan(spread[:2]).all()
    assert points[2, :, 2] == pytest.approx(500 * 0.2 / 17)


def test_covariances_that_tell_nothing_are_no_certainty():
    left = np.array([[[100, 50], [120, 150]]], np.float32)
    for right_errors in (ERRORS, 0.5 * ERRORS):
        assert not disparities(left, ERRORS, left - np.float32([20, 0]), right_errors, 0.0)[2].any()


def test_lines_that_alignment_turns_along_the_rows_stay_and_have_errors():
    rng = np.random.default_rng(0)
    images = tuple(rng.integers(0, 256, (240, 320)).astype(np.uint8) for _ in range(2))  # it has nothing to go by
    delta = np.float32([20, 20 * 0.22]) * rng.uniform(0.7, 1.3, (400, 1)).astype(np.float32)
    first = rng.uniform(40, 200, (400, 2)).astype(np.float32)
    left = np.stack([first, first + delta], axis=1)
    errors = np.repeat(ERRORS, 400, axis=0)
    moved, covariances, ends = aligned(images, (1.0, 0.0), (left, errors), (left - np.float32([10, 0]), errors), CAMERA)
    disparity, spread, _ = disparities(left, errors, moved, covariances, CAMERA.disparity_offset)
    for values in (moved, covariances, ends, disparity):
        assert np.isfinite(values).all()
    assert (np.einsum("nkk->nk", spread) > 0).all()


def test_partners_of_a_rendered_clip_are_right():
    truths = [PairTruth.of(*pair) for pair in views()]
    figures = partner_scores([pairs_of(result.tracks) for result in results()], truths)
    assert figures["precision"] >= 0.98
    assert figures["recall"] >= 0.85
    assert figures["disparity_rms_px"] <= 0.3
    assert 0.25 <= figures["chi2"] <= 2
    assert all((result.tracks.right_hits == 1).any() for result in results()[1:])  # new lines begin anew
    assert results()[-1].tracks.right_hits.max() == len(CLIP)


def test_series_and_pipeline_give_the_same_bits():
    piped = list(LineFrontend(AirLine(threads=1)).results(Given(frames())))
    for one, other in zip(results(), piped, strict=True):
        for name in ("ids", "right_px", "right_covariances", "right_hits", "right_measured", "segments_m"):
            assert np.array_equal(getattr(one.tracks, name), getattr(other.tracks, name), equal_nan=name != "ids")


def test_without_a_right_image_there_are_no_rows():
    (mono,) = LineFrontend(AirLine(threads=1)).results(Given([replace(frames()[0], right=None)]), serial=True)
    assert mono.right is None
    assert mono.tracks.right_px.shape == (0, 2, 2)
    assert mono.tracks.disparity_px is mono.tracks.segments_m is mono.tracks.depth_known is None
    assert len(mono.tracks.take(np.arange(2))) == 2


def test_parts_of_tracks_keep_their_partners():
    tracks = next(result.tracks for result in results() if result.tracks.history)
    for part in (*tracks.history, tracks.take(tracks.confirmed)):
        assert len(part.right_px) == len(part) == len(part.segments_m)
    part = tracks.take(np.array([3, 1]))
    assert np.array_equal(part.right_px, tracks.right_px[[3, 1]], equal_nan=True)


def test_the_right_camera_may_expose_otherwise():
    frame, right = results()[0].frame, results()[0].right
    assert frame.right is not None
    assert right is not None
    darker = replace(frame, right=(0.6 * frame.right + 30).astype(np.uint8))
    tracks = LineTracker().update(frame, results()[0].trace.lines, results()[0].trace.edges)
    same, other = (PartnerFinder().update(tracks, one, right) for one in (frame, darker))
    assert (other.right_hits > 0).sum() >= 0.9 * (same.right_hits > 0).sum()
    both = (same.right_hits > 0) & (other.right_hits > 0) & ~same.right_measured & ~other.right_measured
    assert np.median(np.abs(same.right_px[both] - other.right_px[both])) < 0.2


def without_lines(result: FrameResult) -> FrameResult:
    """A pair in whose right image no line was detected, with the same edges."""
    assert result.right is not None
    lines = result.right.lines
    none = LineSet(lines.segments[:0], lines.scores[:0], lines.descriptors[:0])
    return replace(result, right=replace(result.right, lines=none))


def test_lines_that_were_not_detected_are_measured():
    tracker, partners, tracks = LineTracker(), PartnerFinder(), []
    for result in (results()[0], without_lines(results()[1])):
        found = tracker.update(result.frame, result.trace.lines, result.trace.edges)
        assert result.right is not None
        tracks.append(partners.update(found, result.frame, result.right))
    last: LineTracks = tracks[1]
    measured = last.right_measured
    assert measured.sum() >= 0.4 * (tracks[0].right_hits > 0).sum()
    assert (last.right_hits[measured] >= 1).all()
    truth = PairTruth.of(*views()[1])
    figures = partner_scores([pairs_of(last)], [truth])
    assert figures["precision"] >= 0.95
    assert figures["disparity_rms_px"] <= 0.4


def test_cameras_the_wrong_way_round_are_told():
    frame = results()[0].frame
    assert frame.right is not None
    swapped = replace(frame, image=frame.right, right=frame.image)
    with pytest.raises(InputError, match="wrong way round"):
        next(iter(LineFrontend(AirLine(threads=1)).results(Given([swapped]), serial=True)))


def test_a_right_image_of_another_size_is_told():
    frame = results()[0].frame
    assert frame.right is not None
    odd = replace(frame, right=frame.right[:-2])
    with pytest.raises(InputError, match="left one's size"):
        next(iter(LineFrontend(AirLine(threads=1)).results(Given([odd]), serial=True)))


def test_an_image_without_a_right_one_ends_the_counts() -> None:
    tracker, hits = LineTracker(), []
    for k, result in enumerate(results()[:3]):
        right = result.right if k != 1 else None
        tracks = tracker.update(result.frame, result.trace.lines, result.trace.edges, right)
        hits.append(tracks.right_hits.max(initial=0))
    assert hits == [1, 0, 1]


@pytest.mark.parametrize(
    "odd",
    [
        {"baseline_m": -0.1},
        {"baseline_m": np.nan},
        {"disparity_offset": np.inf},
        {"rig_from_camera": 2 * np.eye(4)},
        {"rig_from_camera": np.eye(3)},
    ],
)
def test_what_is_no_camera_of_a_pair_is_refused(odd: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        replace(CAMERA, **odd)
