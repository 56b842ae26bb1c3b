"""Points beside the lines: where they are, how long they live, and that lines do not notice them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from airline import AirLine
from airline.scenes import RenderedClip, RenderedView
from frontend import Frame, LineTracker, TrackerConfig
from frontend.sources.scene import frame_of
from frontend.tracking.camera_motion import Motion
from frontend.tracking.flow import working_image
from frontend.tracking.points import BORDER, MOST_POINTS, PointTracker
from frontend.tracking.prediction import camera_of
from frontend.tracks import LineTracks
from tests.helpers.made_tracks import FISHEYE, assert_all_same
from tests.helpers.tracking_frames import frame, line_set

LINES = np.array([[[20, 20], [120, 30]], [[30, 60], [30, 140]], [[60, 120], [150, 60]]], np.float32)
SIZE = (200, 160)


@cache
def views() -> list[RenderedView]:
    return list(RenderedClip(kind="indoor", motion="handheld", seed=3, frames=26, size=(480, 360)))


@cache
def run(points: bool, max_lines: int = 0) -> list[LineTracks]:
    detector, tracker = AirLine(), LineTracker(TrackerConfig(points=points, max_lines=max_lines))
    traces = ((frame_of(k, view), detector.trace(view.image)) for k, view in enumerate(views()))
    return [tracker.update(one, trace.lines, trace.edges) for one, trace in traces]


def errors(age: int) -> np.ndarray:
    """(K,) px from where points of this age must be, by the depth at which they began, near or far at a depth edge."""
    found, stream = [], [dict(zip(t.point_ids.tolist(), t.points_px.astype(float), strict=True)) for t in run(True)]
    for k, (earlier, first) in enumerate(zip([{}, *stream], stream, strict=False)):
        if k + age >= len(stream):
            break
        start, end = views()[k], views()[k + age]
        motion = np.linalg.inv(end.pose) @ start.pose
        for i in first.keys() & stream[k + age].keys() - earlier.keys():
            x, y = np.rint(first[i]).astype(int)
            around = start.depth[y - 3 : y + 4, x - 3 : x + 4]
            depths = np.unique(around[np.isfinite(around)])
            rays = np.linalg.inv(start.K) @ np.append(first[i], 1)
            seen = end.K @ (motion[:3, :3] @ np.outer(rays, depths) + motion[:3, 3:])
            off = seen[:2] / seen[2] - stream[k + age][i][:, None]
            found.append(np.hypot(*off).min())
    return np.array(found)


@pytest.mark.parametrize(
    ("age", "least", "median", "most"), [(1, 150, 0.12, 0.5), (5, 120, 0.2, 0.7), (20, 80, 0.4, 1.5)]
)
def test_points_stay_on_what_they_were_put_on(age: int, least: int, median: float, most: float) -> None:
    found = errors(age)
    assert len(found) > least
    assert np.median(found) < median
    assert np.percentile(found, 90) < most


def test_lines_are_the_same_bits_with_points_and_without() -> None:
    plain = run(False)
    assert all(len(tracks.point_ids) == len(tracks.points_px) == 0 for tracks in plain)
    none = {"point_ids": np.zeros(0, np.int64), "points_px": np.zeros((0, 2), np.float32)}
    assert_all_same([replace(tracks, **none) for tracks in run(True)], plain)


def test_ids_ascend_are_never_used_again_and_points_spread_inside_the_image() -> None:
    before, ended = set[int](), set[int]()
    for tracks in run(True):
        ids = tracks.point_ids.tolist()
        assert ids == sorted(set(ids))
        assert 100 < len(ids) <= MOST_POINTS
        assert not ended & set(ids)
        ended |= before - set(ids)
        before = set(ids)
        assert tracks.points_px.dtype == np.float32
        assert (tracks.points_px >= BORDER - 1).all()
        assert (tracks.points_px <= np.array([479, 359]) - BORDER + 1).all()
        apart = np.linalg.norm(tracks.points_px[:, None] - tracks.points_px, axis=2) + 99 * np.eye(len(ids))
        assert apart.min() > 2
        taken = np.unique((tracks.points_px // 120).astype(int), axis=0)
        assert len(taken) >= 9, "of twelve parts of the image"
        assert tracks.camera is not None
        assert tracks.points_normalized is not None
        np.testing.assert_array_equal(tracks.points_normalized, tracks.camera.normalize(tracks.points_px))
    assert len(ended) > 10


def test_the_best_lines_keep_all_points_and_history_has_none() -> None:
    for best, tracks in zip(run(True, max_lines=5), run(True), strict=True):
        assert len(best) <= 5
        np.testing.assert_array_equal(best.point_ids, tracks.point_ids)
        np.testing.assert_array_equal(tracks.take(np.arange(3)).points_px, tracks.points_px)
    parts = [part for tracks in run(True) for part in tracks.history]
    assert len(parts) > 10
    assert not any(len(part.point_ids) + len(part.points_px) for part in parts)


@pytest.mark.parametrize(
    "second",
    [frame(3, stamp_ns=5_000_000_000), frame(3, stamp_ns=-1_000_000), frame(3, size=(160, 120))],
    ids=["gap", "back", "size"],
)
def test_all_points_end_where_tracks_do(second: Frame) -> None:
    tracker = LineTracker(TrackerConfig(points=True))
    seen = [tracker.update(frame(k), line_set(LINES)).point_ids for k in range(3)]
    assert set(seen[2]) & set(seen[0])
    after = tracker.update(second, line_set(LINES))
    assert after.reset is not None
    assert after.point_ids.min() > max(one.max() for one in seen)


def test_all_points_end_at_a_scene_cut_and_in_an_image_without_edges() -> None:
    many = [line_set(np.random.default_rng(k).uniform(5, 155, (25, 2, 2))) for k in range(2)]
    tracker = LineTracker(TrackerConfig(points=True))
    for k in range(3):
        last = tracker.update(frame(k), many[0])
    cut = tracker.update(frame(3, seed=9), many[1])
    assert cut.reset is not None
    assert cut.point_ids.min() > last.point_ids.max()
    dark = Frame(4, 4 * 33_000_000, np.zeros((160, 200), np.uint8))
    assert tracker.update(dark, line_set(LINES[:0])).point_ids.tolist() == []
    assert tracker.update(frame(5, seed=9), many[1]).point_ids.min() > cut.point_ids.max()


def followed(images: list[np.ndarray], motion: Motion | None = None) -> list[dict[int, np.ndarray]]:
    tracker, camera = PointTracker(), camera_of(None, SIZE)
    found = [tracker.update(image, working_image(image), camera, motion) for image in images]
    return [dict(zip(ids.tolist(), points, strict=True)) for ids, points in found]


def test_points_follow_a_plane_through_a_jump_of_the_exposure() -> None:
    bright, dark = frame(0).image, (0.4 * frame(1, shift=7).image).astype(np.uint8)
    first, second = followed([bright, dark])
    both = first.keys() & second.keys()
    assert len(both) > 0.7 * len(first)
    assert max(np.abs(second[i] - first[i] - (7, 0)).max() for i in both) < 0.5


def test_points_on_what_moves_by_itself_end() -> None:
    """A patch passes before a resting plane: without the camera's motion its points are followed, with it they end."""
    images = []
    for k in range(4):
        image = frame(k).image.copy()
        left = 40 + 4 * k
        image[50:110, left : left + 60] = frame(k, seed=5).image[:60, :60]
        images.append(image)

    def on_the_patch(stream: list[dict[int, np.ndarray]]) -> int:
        return sum((stream[3][i] - stream[2][i])[0] > 2 for i in stream[3].keys() & stream[2].keys())

    assert on_the_patch(followed(images)) > 5
    still = followed(images, Motion())
    assert on_the_patch(still) == 0
    assert len(still[3].keys() & still[0].keys()) > 20


@pytest.mark.parametrize("size", [(8, 8), (17, 300), (33, 32), (64, 64)])
def test_small_and_plain_images_have_few_points_or_none(size: tuple[int, int]) -> None:
    noise = np.random.default_rng(0).integers(0, 255, size[::-1], np.uint8)
    for image in (noise, np.full_like(noise, 90)):
        for found in followed([image] * 3):
            assert all((point >= 0).all() and (point < size).all() for point in found.values())


def test_points_beyond_the_lens_model_are_followed() -> None:
    """A camera of which the corners of the image have no rays."""
    lens = replace(FISHEYE, fx=40.0, fy=40.0)
    tracker = PointTracker()
    for k in range(3):
        image = frame(k, size=(320, 240)).image
        ids, points = tracker.update(image, working_image(image), lens, Motion())
    beyond = np.isnan(lens.normalize(points)).any(axis=1)
    assert beyond.any()
    assert ids[beyond].min() < 100
