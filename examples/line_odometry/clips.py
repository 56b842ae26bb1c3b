"""Clips with known poses, seen by each frontend."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from airline import LineSet
from airline.evaluation.benchmark import lsd
from airline.scenes import RenderedClip, RenderedView, render_clip, render_pairs
from airline.scenes.clip import build_scene
from frontend import Frame, LineFrontend, LineTracks
from frontend.evaluation.baselines import NearestTracker
from frontend.evaluation.posed import PosedClip
from frontend.sources import open_stereo
from frontend.sources.scene import frame_of
from frontend.tracker import LineTracker
from frontend.tracking.config import TrackerConfig
from frontend.tracks import FIELDS, TrackState
from line_odometry.score import TrueLines
from line_odometry.views import Array

OURS, FUSED, TRUE_LINES, LSD = "AirLine", "AirLine, fused lines", "true lines", "LSD and nearest"
END_ERROR, TRUE_ERROR = 0.3, 0.1  # px, of the ends of lines that come without covariances: LSD's, and true ones
PERIOD_NS = 100_000_000  # of a clip that is turned round or cut: its own times would go backwards


@dataclass
class Seen:
    """A clip as the frontends see it.

    Attributes:
        focal: px.
        axes: where right, down or up, and forward are in the world, as Rerun writes it.
        poses: (N, 3, 4) the true world_from_camera.
        tracks: what each frontend saw, by its name; all have the flow points of ours.
        lines: the true lines, where they are known.
    """

    focal: float
    axes: str
    poses: Array
    tracks: dict[str, list[LineTracks]]
    lines: TrueLines | None = None


@dataclass
class Frontends:
    """The frontends by their names, and what they saw so far."""

    names: list[str]
    max_lines: int = 0
    tracks: dict[str, list[LineTracks]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        config = TrackerConfig(points=True, max_lines=self.max_lines)
        self._ours = LineFrontend(tracker=LineTracker(config))
        self._detect, self._nearest, self._hits = lsd(), NearestTracker(), dict[int, int]()
        self.tracks = {name: [] for name in self.names}

    def look(self, frame: Frame, rendered: RenderedView | None = None) -> None:
        """Take the next frame."""
        ours = self._ours.process(frame).tracks
        saw: dict[str, Callable[[], LineTracks]] = {
            OURS: lambda: ours,
            FUSED: lambda: replace(ours, observed_px=ours.segments_px, observed_covariances=ours.covariances),
            LSD: lambda: self._lsd(frame, ours),
        }
        if rendered is not None:
            saw[TRUE_LINES] = lambda: tracked(
                ours, rendered.ids, rendered.segments_px, np.full(len(rendered.ids), 3), TRUE_ERROR
            )
        for name, tracks in self.tracks.items():
            tracks.append(saw[name]())

    def _lsd(self, frame: Frame, ours: LineTracks) -> LineTracks:
        found = self._detect(frame.gray)
        lines = LineSet(found, np.ones(len(found), np.float32), np.zeros((len(found), 0), np.float32))
        seen = self._nearest.update(frame, lines)
        for track in seen.ids.tolist():
            self._hits[track] = self._hits.get(track, 0) + 1
        hits = np.array([self._hits[track] for track in seen.ids.tolist()])
        return tracked(ours, seen.ids, found[seen.line_indices], hits, END_ERROR)


def tracked(ours: LineTracks, ids: np.ndarray, segments: np.ndarray, hits: np.ndarray, error: float) -> LineTracks:
    """Lines of others, of one camera, with the frame and the points of ours; of a line in pieces the longest one."""
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    order = np.lexsort((-lengths, ids))
    order = order[np.unique(ids[order], return_index=True)[1]]
    rows = {"seen": len(order), "right": 0}
    seen = [(one, [rows[one.rows], *(max(size, 0) for size in one.shape)]) for one in FIELDS if one.rows in rows]
    arrays: dict[str, Any] = {one.name: np.zeros(shape, one.dtype) for one, shape in seen}
    arrays |= {"ids": ids[order].astype(np.int64), "hits": hits[order].astype(np.int32)}
    arrays |= {"segments_px": segments[order], "observed_px": segments[order], "fragment_of": np.full(len(order), -1)}
    arrays["states"][hits[order] >= 3] = TrackState.CONFIRMED
    arrays["covariances"][:, 0, 0] = error**2 / 2
    arrays["covariances"][:, 1, 1] = 2 * (error / np.maximum(lengths[order], 1)) ** 2
    arrays["observed_covariances"] = arrays["covariances"]
    return replace(ours, **arrays, earlier=())


def rendered(clip: RenderedClip, names: list[str], max_lines: int = 0, *, stereo: bool = False) -> Seen:
    """A rendered clip of one camera or of a pair, with its true lines."""
    frontends = Frontends(names, max_lines)
    poses, depths, pieces = [], [], []
    views = render_pairs(clip) if stereo else ((view,) for view in render_clip(clip))
    for index, (view, *right) in enumerate(views):
        frontends.look(frame_of(index, view, *right), view)
        poses.append(view.pose[:3])
        depths.append(np.median(view.depth))
        pieces.append((view.ids, view.segments_world))
    visible = merged(np.concatenate([ids for ids, _ in pieces]), np.concatenate([ends for _, ends in pieces]))
    every = np.concatenate([build_scene(clip.kind, clip.seed).lines, visible])
    lines = TrueLines(visible, every, float(np.median(depths)))
    return Seen(clip.K[0, 0], "RFU", np.array(poses), frontends.tracks, lines)


def posed(folder: Path, part: slice, names: list[str], max_lines: int = 0, *, stereo: bool = False) -> Seen:
    """Some frames of a folder with images, calibration and poses, as KITTI's are handed around; InputError.

    The right camera's images of a pair are in `images_right/`.
    """
    clip, frontends = PosedClip(folder), Frontends(names, max_lines)
    for index, frame in enumerate(list(open_stereo(folder) if stereo else clip)[part]):
        frontends.look(replace(frame, index=index, stamp_ns=index * PERIOD_NS))
    return Seen(clip.K[0, 0], "RDF", clip.poses[part], frontends.tracks)


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
