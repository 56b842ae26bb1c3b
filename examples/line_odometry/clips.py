"""Clips with known poses, seen by each frontend."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from airline import LineSet
from airline.evaluation.benchmark import lsd
from airline.scenes import RenderedClip, RenderedView, render_clip
from airline.scenes.clip import build_scene
from frontend import Frame, LineFrontend
from frontend.evaluation.baselines import NearestTracker
from frontend.evaluation.posed import PosedClip
from frontend.sources.scene import frame_of
from line_odometry.geometry import Array, homogeneous
from line_odometry.score import TrueLines
from line_odometry.views import View

OURS, FUSED, TRUE_LINES, LSD = "AirLine", "AirLine, fused lines", "true lines", "LSD and nearest"


@dataclass(frozen=True)
class Seen:
    """A clip as the frontends see it.

    Attributes:
        focal: px.
        axes: where right, down or up, and forward are in the world, as Rerun writes it.
        poses: (N, 3, 4) the true world_from_camera.
        views: what each frontend saw, by its name.
        lines: the true lines, where they are known.
    """

    focal: float
    axes: str
    poses: Array
    views: dict[str, list[View]]
    lines: TrueLines | None = None


def built_in(frames: int, names: list[str]) -> Seen:
    """The first frames of the built-in clip."""
    sequence = RenderedClip(kind="indoor", motion="handheld", seed=12, frames=frames)
    frontends = _frontends(names)
    views: dict[str, list[View]] = {name: [] for name in names}
    poses, depths, pieces = [], [], []
    for index, rendered in enumerate(render_clip(sequence)):
        frame = frame_of(index, rendered)
        for name, look in frontends.items():
            views[name].append(look(frame))
        if TRUE_LINES in views:
            views[TRUE_LINES].append(_truth(frame, rendered))
        poses.append(rendered.pose[:3])
        depths.append(np.median(rendered.depth))
        pieces.append((rendered.ids, rendered.segments_world))
    visible = merged(np.concatenate([ids for ids, _ in pieces]), np.concatenate([ends for _, ends in pieces]))
    every = np.concatenate([build_scene(sequence.kind, sequence.seed).lines, visible])
    return Seen(sequence.K[0, 0], "RFU", np.array(poses), views, TrueLines(visible, every, float(np.median(depths))))


def posed(folder: Path, frames: int | None, names: list[str]) -> Seen:
    """A folder with images, calibration and poses, as KITTI's odometry sequences are handed around; InputError."""
    clip = PosedClip(folder)
    frontends = _frontends(names)
    views: dict[str, list[View]] = {name: [] for name in frontends}
    for frame in clip:
        if frames is not None and frame.index >= frames:
            break
        for name, look in frontends.items():
            views[name].append(look(frame))
    return Seen(clip.K[0, 0], "RDF", clip.poses[:frames], views)


def merged(ids: np.ndarray, ends: Array) -> Array:
    """(V, 2, 3) the parts of lines that pieces (M, 2, 3) of them cover, each part once."""
    return np.array([part for line in np.unique(ids) for part in _union(ends[ids == line])])


def _union(pieces: Array) -> Iterator[Array]:
    sizes = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1)
    origin, tip = pieces[sizes.argmax()]
    along = (tip - origin) / sizes.max()
    spans = np.sort((pieces - origin) @ along, axis=1)
    low, high = spans[spans[:, 0].argsort()].T
    reached = np.maximum.accumulate(high)
    first = np.flatnonzero(np.append(True, low[1:] > reached[:-1]))
    for start, end in zip(low[first], reached[np.append(first[1:], len(low)) - 1], strict=True):
        yield np.stack([origin + start * along, origin + end * along])


def _frontends(names: list[str]) -> dict[str, Callable[[Frame], View]]:
    makers: dict[str, Callable[[], Callable[[Frame], View]]] = {
        OURS: partial(_ours, "observed_px"),
        FUSED: partial(_ours, "segments_px"),
        LSD: _lsd_and_nearest,
    }
    return {name: makers[name]() for name in names if name in makers}


def _ours(lines: str) -> Callable[[Frame], View]:
    frontend = LineFrontend()
    return lambda frame: View.of(frontend.process(frame).tracks, lines)


def _lsd_and_nearest() -> Callable[[Frame], View]:
    detect, tracker = lsd(), NearestTracker()

    def look(frame: Frame) -> View:
        found = detect(frame.gray)
        lines = LineSet(found, np.ones(len(found), np.float32), np.zeros((len(found), 0), np.float32))
        tracked = tracker.update(frame, lines)
        return _view(frame, tracked.ids, found[tracked.line_indices])

    return look


def _truth(frame: Frame, rendered: RenderedView) -> View:
    return _view(frame, rendered.ids, rendered.segments_px)


def _view(frame: Frame, ids: np.ndarray, segments: np.ndarray) -> View:
    assert frame.camera is not None
    return View(ids, homogeneous(frame.camera.normalize(segments)))
