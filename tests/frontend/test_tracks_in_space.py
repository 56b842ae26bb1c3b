"""Triangulation of tracks, their consistency with a line in space, and the picture of the worst."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from airline.errors import InputError
from airline.scenes import RenderedClip
from airline.scenes.camera import rotation
from frontend.evaluation.consistency import consistency
from frontend.evaluation.observations import Observations, collect
from frontend.evaluation.rendered import SceneClip
from frontend.evaluation.space import distances, image_lines, triangulate
from frontend.evaluation.strips import CELL, GAP, LEFT, draw_strips, fitted, write_strips
from tests.helpers.made_tracks import blank_tracks
from tests.helpers.tracking_frames import frame as frame_of

K = np.array([[400.0, 0, 100], [0, 400, 80], [0, 0, 1]])
FRAMES = 10
WALK = np.stack(
    [np.column_stack([rotation(0.02 * k, 0.01 * k, 0.0), [0.1 * k, 0.25 * k, 0.03 * k]]) for k in range(FRAMES)]
)
STILL = np.tile(WALK[:1], (FRAMES, 1, 1))
Array = NDArray[np.float64]


class Walk(NamedTuple):
    poses: Array
    K: Array = K
    name: str = "walk"


def observed(ends: Array, poses: Array = WALK, noise: float = 0, seed: int = 0) -> Array:
    """A line between two points in space, seen from all poses."""
    points = np.einsum("nij,nei->nej", poses[:, :, :3], ends - poses[:, None, :, 3]) @ K.T
    rng = np.random.default_rng(seed)
    return points[..., :2] / points[..., 2:] + noise * rng.standard_normal((len(poses), 2, 2))


def rows_of(tracks: dict[int, Array], **columns: Array) -> Observations:
    """Tracks seen in the first frames."""
    ids = np.concatenate([np.full(len(segments), track) for track, segments in tracks.items()])
    segments = np.concatenate(list(tracks.values()))
    nothing = np.zeros(len(ids), np.bool_)
    frames = np.concatenate([np.arange(len(segments)) for segments in tracks.values()])
    return Observations(
        **{
            "ids": ids,
            "frames": frames,
            "observed_px": segments,
            "segments_px": segments,
            "measured": nothing,
            "stable": nothing,
            **columns,
        }
    )


GOOD = observed(np.array([[10.0, -1, 0], [9, 1, 1]]), noise=0.3, seed=1)
JUMPS = observed(np.array([[10.0, 1, 0], [9, 1, 1]]))
JUMPS[5:] = observed(np.array([[10.0, 1.6, 0], [9, 1.6, 1]]))[5:]


@pytest.mark.parametrize("seed", range(3))
def test_triangulation_finds_the_line(seed: int) -> None:
    ends = np.random.default_rng(seed).uniform((8, -2, -1), (12, 2, 1), (2, 3))
    segments = observed(ends)
    line = triangulate(WALK, segments, K)
    away, direction = ends - line[0], line[1] / np.linalg.norm(line[1])
    assert np.linalg.norm(away - (away @ direction)[:, None] * direction, axis=1) == pytest.approx([0, 0], abs=1e-4)
    lines = image_lines(WALK, line, K)
    assert distances(segments, lines).max() < 1e-3
    delta = segments[:, 1] - segments[:, 0]
    aside = 3 * delta[:, None, ::-1] * (-1, 1) / np.linalg.norm(delta, axis=1)[:, None, None]
    assert distances(segments + aside, lines) == pytest.approx(np.full((FRAMES, 2), 3), abs=0.02), "in pixels"


@pytest.mark.parametrize("seed", range(8))
def test_triangulation_leaves_the_least_squares(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = rng.uniform((8, -2, -1), (12, 2, 1), (2, 3))
    segments = observed(ends, noise=0.5, seed=seed)

    def errors(change: Array, line: Array) -> Array:
        """Signed, and without anything that the package computes."""
        first, second = (
            np.einsum("nij,ni->nj", WALK[:, :, :3], p - WALK[:, :, 3]) @ K.T
            for p in (line[0] + np.append(0, change[:2]), line[0] + np.append(0, change[2:]) + line[1])
        )
        images = np.cross(first, second)
        across = np.einsum("nec,nc->ne", segments, images[:, :2]) + images[:, 2:]
        return np.asarray(across / np.linalg.norm(images[:, :2], axis=1)[:, None]).ravel()

    true = np.stack([ends[0], ends[1] - ends[0]])
    best = least_squares(errors, np.zeros(4), args=(true,), method="lm")
    found = distances(segments, image_lines(WALK, triangulate(WALK, segments, K), K))
    assert np.sum(found**2) == pytest.approx(2 * best.cost, rel=1e-4)


def test_consistency() -> None:
    rows = rows_of({3: GOOD, 5: JUMPS, 8: GOOD[:4]})
    figures = consistency(rows, rows.segments_px, Walk(WALK), FRAMES)
    assert (figures["tracks"], figures["consistent"], figures["share"]) == (2, 1, 0.5)
    assert (figures["length_mean"], figures["observations_per_frame"]) == (10, 1)
    assert 0.15 < (figures["rms_across_px"] or 0) < 0.4
    assert figures["by_frames"]["9-16"] == {"tracks": 2, "consistent": 1, "share": 0.5}
    assert figures["by_frames"]["5-8"]["share"] is None
    assert figures["by_length"][">80"] == {"tracks": 1, "consistent": 1, "share": 1}
    assert figures["by_length"]["40-80"] == {"tracks": 1, "consistent": 0, "share": 0}
    assert figures["by_length"]["<20"]["tracks"] == figures["by_length"]["20-40"]["tracks"] == 0

    short = consistency(rows.take(rows.ids == 8), GOOD[:4], Walk(WALK), FRAMES)
    assert (short["tracks"], short["share"], short["observations_per_frame"]) == (0, None, 0)
    fused = consistency(rows.take(rows.ids == 5), GOOD, Walk(WALK), FRAMES)
    assert fused["consistent"] == 1, "the segments that are given count"


def test_true_lines_of_a_rendered_clip_are_consistent() -> None:
    clip = SceneClip("small", (RenderedClip("indoor", "handheld", 3, frames=8, size=(320, 240)),))
    tracks: dict[int, list[Array]] = {}
    for _, truth in clip:
        ids, pieces = np.unique(truth.ids, return_counts=True)
        for line in ids[pieces == 1].tolist():
            tracks.setdefault(line, []).append(truth.segments_px[truth.ids == line][0].astype(np.float64))
    whole = {line: np.array(segments) for line, segments in sorted(tracks.items()) if len(segments) == len(clip)}
    rows = rows_of(whole)
    figures = consistency(rows, rows.segments_px, clip, len(clip))
    assert figures["tracks"] > 20
    assert figures["share"] == 1
    assert (figures["rms_across_px"] or 0) < 0.01


def test_a_camera_that_stands_still() -> None:
    ends = np.array([[10.0, -1, 0], [9, 1, 1]])
    same = observed(ends, STILL, noise=0.2)
    moved = same + np.array([0.0, 0.8]) * np.arange(FRAMES)[:, None, None]
    rows = rows_of({0: same, 1: moved})
    figures = consistency(rows, rows.segments_px, Walk(STILL), FRAMES)
    assert (figures["tracks"], figures["consistent"]) == (2, 1), "what moves is no line that stands"


def test_rows_are_collected_by_track() -> None:
    run = [
        blank_tracks(2, ids=np.array([1, 4]), observed_px=np.full((2, 2, 2), 10), measured=np.array([False, True])),
        blank_tracks(0),
        blank_tracks(2, ids=np.array([0, 4]), observed_px=np.full((2, 2, 2), 12), stable=np.array([False, True])),
    ]
    rows = collect(run)
    assert (rows.ids.tolist(), rows.frames.tolist()) == ([0, 1, 4, 4], [2, 0, 0, 2])
    assert rows.starts.tolist() == [0, 1, 2, 4]
    assert rows.observed_px[:, 0, 0].tolist() == [12, 10, 10, 12]
    assert (rows.measured.tolist(), rows.stable.tolist()) == ([False, False, True, False], [False, False, False, True])
    assert len(collect([])) == len(collect([blank_tracks(0)])) == 0


def test_the_worst_tracks_are_drawn(tmp_path) -> None:
    rows = rows_of({3: GOOD, 5: JUMPS, 8: GOOD[:4]}, measured=np.arange(24) % 2 == 1)
    strips = fitted(rows, Walk(WALK))
    assert [strip.rows.ids[0] for strip in strips] == [5, 3], "the worst first, and none of few frames"
    assert strips[0].errors.max() > 2 > strips[1].errors.max()
    frames = [frame_of(k) for k in range(FRAMES)]
    picture = draw_strips(frames, strips, cells=4)
    assert picture.shape == (2 * (CELL + GAP), LEFT + 4 * (CELL + GAP), 3)
    cells = [picture[:CELL, LEFT + GAP + k * (CELL + GAP) :][:, :CELL] for k in range(4)]
    framed = [bool((cell[0, 10:-10] == (60, 60, 255)).all()) for cell in cells]
    assert sum(framed) == 1, "the worst moment is among them, and framed"
    first, last = (np.moveaxis(cell.astype(int), 2, 0) for cell in (cells[0], cells[-1]))  # blue, green, red
    assert (first[1] > first[2] + 60).sum() > 50, "green where the line was detected"
    assert ((last[2] > last[0] + 60) & (last[1] > last[0] + 40)).sum() > 50, "orange where it was measured"

    write_strips(tmp_path / "new" / "worst.png", picture)
    assert (cv2.imread(str(tmp_path / "new" / "worst.png")) == picture).all()
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot write"):
        write_strips(tmp_path / "file" / "worst.png", picture)
