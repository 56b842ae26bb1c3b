"""Tracking of lines by descriptor overlap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airline.image import to_uint8
from airline.lines import LineSet
from frontend.frame import Frame
from frontend.tracking.appearance import side_profiles
from frontend.tracking.assignment import assign
from frontend.tracking.config import TrackerConfig
from frontend.tracking.fusion import clip, fuse, line_covariances, predicted_covariances, with_bias
from frontend.tracking.motion import WorkingImage, predict_segments, working_image
from frontend.tracking.overlap import LineFeatures, absorbed, overlap_votes, parents
from frontend.tracking.selection import Selection
from frontend.tracking.table import TrackTable, new_tracks, no_tracks
from frontend.tracks import LineTracks, TrackState

MIN_VISIBLE = 5.0  # px; a track of which less is left in the image ends
MEMORY = 0.5  # weight of the past in a track's profile
CUT_FLOW = 0.2  # share of consistent flow below which an image may show another scene,
CUT_TRACKS = 0.1  # if no more than this share of the tracks goes on
CUT_LEAST = 10  # and there are so many tracks and lines that this is not chance

Pairs = NDArray[np.int32]  # row of the line that each track goes on with, or -1


class LineTracker:
    """Gives the same physical line the same id from frame to frame.

    Predict each track by image motion, lay it over the new lines, let it vote for those it overlaps, weighted by how
    well their orientation descriptors and both their sides agree, pair one to one, fuse. Tracks that were just seen
    choose first; those that were missed may take what is left.
    """

    def __init__(self, config: TrackerConfig | None = None) -> None:
        self.config = config or TrackerConfig()
        self._selection = Selection(self.config.max_lines)
        self._next_id = 0
        self._tracks: TrackTable | None = None
        self._image: WorkingImage | None = None
        self._size = (0, 0)
        self._stamp_ns = 0
        self._motion = np.eye(3)

    def update(self, frame: Frame, lines: LineSet, edges: NDArray[np.float32] | None = None) -> LineTracks:
        """Take the lines of the next frame and return the tracks that were seen in it.

        Args:
            frame: the image, in time order.
            lines: its detected lines.
            edges: (H, W) float32 edge probability of the image, on which tracks without a line are looked for.
        """
        gray = to_uint8(frame.gray)
        image, size = working_image(gray), (gray.shape[1], gray.shape[0])
        seen = LineFeatures(lines.segments, lines.descriptors, side_profiles(gray, lines.segments))
        earlier = no_tracks(seen) if self._tracks is None else self._tracks
        tracks, pairs = earlier, np.full(len(earlier), -1, np.int32)
        reset = self._reset_reason(frame.stamp_ns, size)
        if reset is None and len(earlier) and len(lines):
            tracks, trusted = self._predicted(earlier, image, size)
            pairs = self._pair(tracks, seen)
            reset = _cut_reason(trusted, earlier.visible, pairs, len(lines))
        if reset is not None:
            tracks, pairs = no_tracks(seen), np.zeros(0, np.int32)
        tracks, line_of = self._next(tracks, pairs, seen, lines.residuals, frame.index, size)
        if len(lines) or reset is not None:
            self._image = image
        else:  # an image without lines says nothing: the tracks wait where they were
            tracks = replace(tracks, visible=earlier.visible[np.searchsorted(earlier.ids, tracks.ids)])
        self._tracks, self._size, self._stamp_ns = tracks, size, frame.stamp_ns
        ended = np.setdiff1d(earlier.ids, tracks.ids, assume_unique=True)
        return self._selection.of(self._result(frame, lines, tracks, line_of, ended, reset), size)

    def _reset_reason(self, stamp_ns: int, size: tuple[int, int]) -> str | None:
        if self._tracks is None:
            return None
        if self._size != size:
            return f"resolution changed from {self._size[0]}x{self._size[1]} to {size[0]}x{size[1]}"
        gap = (stamp_ns - self._stamp_ns) * 1e-9
        if gap < 0:
            return f"time went back by {-gap:.3f} s"
        if gap > self.config.max_gap_s:
            return f"gap of {gap:.3f} s"
        return None

    def _predicted(self, tracks: TrackTable, image: WorkingImage, size: tuple[int, int]) -> tuple[TrackTable, float]:
        """The tracks where they should be, of length 0 if they left the image; and the share of consistent flow."""
        before = image if self._image is None else self._image
        moved = predict_segments(before, image, tracks.segments, tracks.visible, self._motion)
        self._motion = moved.homography
        segments, _ = clip(moved.segments, size)
        covariances = predicted_covariances(tracks.covariances, tracks.segments, segments, moved.followed)
        return replace(tracks, segments=segments, covariances=covariances, visible=moved.followed), moved.trusted

    def _pair(self, tracks: TrackTable, seen: LineFeatures) -> Pairs:
        """The line of each track: first for those seen in the last frame, then for the others."""
        config = self.config
        slack = tracks.missed + np.where(tracks.visible, 0, 1)
        bands = np.minimum(config.band + config.lost_band * slack, config.max_band).astype(np.float32)
        current = tracks.missed == 0
        votes = overlap_votes(
            tracks.features,
            seen,
            bands,
            tracks.seen_parts,
            np.where(current, config.min_appearance, config.min_appearance_lost).astype(np.float32),
            max_angle=np.deg2rad(config.max_angle),
            min_agreement=config.min_agreement,
        )
        pairs = assign(votes, config.min_vote, rows=current)
        free = np.ones(len(seen.segments), np.bool_)
        free[pairs[pairs >= 0]] = False
        return np.maximum(pairs, assign(votes, config.min_vote, rows=~current, columns=free))

    def _next(
        self,
        tracks: TrackTable,
        pairs: Pairs,
        seen: LineFeatures,
        residuals: NDArray[np.float32] | None,
        frame_index: int,
        size: tuple[int, int],
    ) -> tuple[TrackTable, Pairs]:
        """The tracks after this frame: those that go on, fused with their lines, and new ones; and the line of each."""
        errors = line_covariances(seen.segments, residuals)
        hit = pairs >= 0
        tracks = _updated(tracks, hit, seen.take(pairs[hit]), errors[pairs[hit]], size)
        observed = seen.segments[pairs[hit]]
        alive = self._alive(tracks, hit, observed, size)
        free = np.ones(len(seen.segments), np.bool_)
        free[pairs[hit]] = False
        new = np.flatnonzero(free).astype(np.int32)
        parent = parents(np.concatenate([observed, seen.segments[new]]), tracks.segments[hit])
        of_parent = np.append(np.where(tracks.fragment_of >= 0, tracks.fragment_of, tracks.ids)[hit], -1)[parent]
        tracks = tracks.with_rows(hit, {"fragment_of": np.maximum(tracks.fragment_of[hit], of_parent[: hit.sum()])})
        fragment_of = of_parent[hit.sum() :]
        begun = new_tracks(self._next_id, frame_index, seen.take(new), errors[new], fragment_of)
        self._next_id += len(new)
        return tracks.take(alive).append(begun), np.concatenate([pairs[alive], new])

    def _alive(
        self, tracks: TrackTable, hit: NDArray[np.bool_], observed: NDArray[np.float32], size: tuple[int, int]
    ) -> NDArray[np.bool_]:
        """(N,) mask: seen lately, still in the image, and no piece that is part of its whole line again."""
        confirmed = tracks.hits >= self.config.confirm_hits
        patience = np.where(confirmed, self.config.max_missed, self.config.max_missed_tentative)
        place = np.searchsorted(tracks.ids[hit], tracks.fragment_of)
        found = np.append(tracks.ids[hit], -2)[place] == tracks.fragment_of
        whole_again = absorbed(tracks.segments, np.where(found & ~hit, place, -1), observed)
        left = clip(tracks.segments, size)[1] < MIN_VISIBLE
        alive: NDArray[np.bool_] = (tracks.missed <= patience) & ~whole_again & (hit | ~left)
        return alive

    def _result(
        self,
        frame: Frame,
        lines: LineSet,
        tracks: TrackTable,
        line_of: Pairs,
        ended_ids: NDArray[np.int64],
        reset: str | None,
    ) -> LineTracks:
        confirmed = tracks.hits >= self.config.confirm_hits
        lost = (line_of < 0) & confirmed
        here, rows = tracks.take(line_of >= 0), line_of[line_of >= 0]
        observed = lines.segments[rows]
        backwards = _runs_backwards(here.segments, observed)
        observed[backwards] = observed[backwards, ::-1]
        return LineTracks(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            ids=here.ids,
            segments_px=here.segments,
            observed_px=observed,
            covariances=with_bias(here.covariances),
            observed_covariances=line_covariances(lines.segments, lines.residuals)[rows],
            scores=lines.scores[rows],
            descriptors=here.descriptors,
            states=np.where(confirmed[line_of >= 0], TrackState.CONFIRMED, TrackState.TENTATIVE).astype(np.uint8),
            ages=(frame.index - here.born).astype(np.int32),
            hits=here.hits,
            measured=np.zeros(len(rows), np.bool_),
            consistency=np.ones(len(rows), np.float32),
            stable=confirmed[line_of >= 0],
            line_indices=rows,
            fragment_of=here.fragment_of,
            lost_ids=tracks.ids[lost],
            lost_segments_px=tracks.segments[lost],
            lost_frames=tracks.missed[lost],
            ended_ids=ended_ids,
            camera=frame.camera,
            reset=reset,
        )


def _updated(
    tracks: TrackTable, hit: NDArray[np.bool_], lines: LineFeatures, errors: NDArray[np.float32], size: tuple[int, int]
) -> TrackTable:
    """The tracks with one more frame; those that were hit are fused with their lines."""
    backwards = _runs_backwards(tracks.segments[hit], lines.segments)
    observed, profiles = lines.segments.copy(), lines.profiles.copy()
    observed[backwards], profiles[backwards] = observed[backwards, ::-1], profiles[backwards, ::-1]
    segments, covariances = fuse(tracks.segments[hit], tracks.covariances[hit], observed, errors, size)
    fused = {
        "segments": segments,
        "parts": _along(segments, observed),
        "covariances": covariances,
        "descriptors": lines.descriptors,
        "profiles": MEMORY * tracks.profiles[hit] + (1 - MEMORY) * profiles,
    }
    return replace(
        tracks.with_rows(hit, fused),
        hits=(tracks.hits + hit).astype(np.int32),
        missed=np.where(hit, 0, tracks.missed + 1).astype(np.int32),
        visible=hit,
    )


def _cut_reason(trusted: float, visible: NDArray[np.bool_], pairs: Pairs, lines: int) -> str | None:
    """Why this image shows another scene, if it does: nothing flows there, and hardly a track goes on."""
    if min(visible.sum(), lines) < CUT_LEAST or trusted >= CUT_FLOW:
        return None
    share = (pairs[visible] >= 0).mean()
    return f"scene cut: {100 * share:.0f} % of the tracks go on" if share <= CUT_TRACKS else None


def _along(segments: NDArray[np.float32], points: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, K) places of (N, K, 2) points along (N, 2, 2) segments, from 0 at the start to 1 at the end."""
    delta = segments[:, None, 1] - segments[:, None, 0]
    dots = ((points - segments[:, :1]) * delta).sum(axis=2)
    return np.asarray(dots / np.maximum((delta * delta).sum(axis=2), 1e-6))


def _runs_backwards(reference: NDArray[np.float32], segments: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(N,) mask of the segments that point against their (N, 2, 2) reference."""
    a, b = reference[:, 1] - reference[:, 0], segments[:, 1] - segments[:, 0]
    backwards: NDArray[np.bool_] = (a * b).sum(axis=1) < 0
    return backwards
