"""Tracking of lines by descriptor overlap."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airline.image import to_uint8
from airline.lines import LineSet
from frontend.camera.model import CameraModel
from frontend.frame import Frame
from frontend.history import Confirmations
from frontend.tracking.appearance import side_profiles
from frontend.tracking.assignment import assign
from frontend.tracking.camera_motion import Motion
from frontend.tracking.config import TrackerConfig
from frontend.tracking.flow import WorkingImage, working_image
from frontend.tracking.guided import measure, supported
from frontend.tracking.measurement import MEASURED, line_covariances, with_bias
from frontend.tracking.overlap import LineFeatures, absorbed, covered, overlap_votes, parents
from frontend.tracking.prediction import camera_of, focal_of, predicted
from frontend.tracking.selection import Selection
from frontend.tracking.state import innovations, line_part, new_covariances, slide, update, usual_extents
from frontend.tracking.table import TrackTable, new_tracks, no_tracks
from frontend.tracks import LineTracks, TrackState

MIN_VISIBLE = 5.0  # px; a track of which less is left in the image ends
MEMORY = 0.5  # weight of the past in a track's profile
CALM = 0.8  # weight of the past in how surprising a track's lines are
MEDIAN_SQUARE = 1.386  # of a chi-square of two degrees of freedom
NEAR_ENOUGH = 1.0  # px; lines that end no farther from their track are not gated
MOST_SURPRISE = 4.0  # of a track that they still go on with
CALM_SQUARE = 5.0  # squared innovation that casts no doubt on a line that looks unlike its track at its birth
MAX_GUIDED = 3.0  # px, widest band in which a track is looked for on the edge map
CUT_FLOW = 0.2  # share of consistent flow below which an image may show another scene,
CUT_TRACKS = 0.1  # if no more than this share of the tracks goes on
CUT_LEAST = 10  # and there are so many tracks and lines that this is not chance

Pairs = NDArray[np.int32]  # row of the line that each track goes on with, or -1


@dataclass(frozen=True)
class Seen:
    """Lines of one frame: first those detected, then those measured for tracks that no detected line takes.

    Attributes:
        features: of all lines.
        errors: (N, 2, 2) float32 covariances of offset and angle.
        scores: (N,) float32.
        detected: how many of them are.
    """

    features: LineFeatures
    errors: NDArray[np.float32]
    scores: NDArray[np.float32]
    detected: int


class LineTracker:
    """Gives the same physical line the same id from frame to frame.

    Predict each track by the camera's motion and its own depth, lay it over the new lines, let it vote for those it
    overlaps, weighted by how well their orientation descriptors and both their sides agree, pair one to one, look for
    the others on the edge map, filter. Tracks that were just seen choose first; those that were missed may take what is
    left.
    """

    def __init__(self, config: TrackerConfig | None = None) -> None:
        self.config = config or TrackerConfig()
        self._selection = Selection(self.config.max_lines)
        self._next_id = 0
        self._tracks: TrackTable | None = None
        self._image: WorkingImage | None = None
        self._size = (0, 0)
        self._stamp_ns = 0
        self._motion = Motion()
        self._noise = 1.0
        self._confirmations = Confirmations()

    def update(self, frame: Frame, lines: LineSet, edges: NDArray[np.float32] | None = None) -> LineTracks:
        """Take the lines of the next frame and return the tracks that were seen in it.

        Args:
            frame: the image, in time order.
            lines: its detected lines.
            edges: (H, W) float32 edge probability of the image, on which tracks without a line are looked for.
        """
        gray = to_uint8(frame.gray)
        image, size = working_image(gray), (gray.shape[1], gray.shape[0])
        camera = camera_of(frame.camera, size)
        features = LineFeatures(lines.segments, lines.descriptors, side_profiles(gray, lines.segments))
        seen = Seen(features, line_covariances(lines.segments, lines.residuals), lines.scores, len(lines))
        earlier = no_tracks(features) if self._tracks is None else self._tracks
        tracks, pairs, lengths = earlier, np.full(len(earlier), -1, np.int32), np.full(len(earlier), np.inf)
        reset = self._reset_reason(frame.stamp_ns, size)
        if reset is None and len(earlier) and len(lines):
            ahead = predicted(earlier, image if self._image is None else self._image, image, camera, self._motion)
            tracks, lengths, self._motion = ahead.tracks, ahead.lengths, ahead.motion
            pairs = self._pair(tracks, features)
            reset = _cut_reason(ahead.trusted, earlier.visible, pairs, len(lines))
        if reset is not None:
            tracks, pairs, lengths, self._motion = no_tracks(features), np.zeros(0, np.int32), np.zeros(0), Motion()
        elif len(lines):
            pairs = self._gated(tracks, pairs, seen)
            if edges is not None:
                pairs, seen = self._guided(tracks, pairs, seen, edges, gray, lengths)
        tracks, line_of = self._next(tracks, pairs, seen, frame.index, edges, focal_of(camera), lengths)
        if len(lines) or reset is not None:
            self._image = image
        else:  # an image without lines says nothing: the tracks wait where they were
            tracks = replace(tracks, visible=earlier.visible[np.searchsorted(earlier.ids, tracks.ids)])
        self._tracks, self._size, self._stamp_ns = tracks, size, frame.stamp_ns
        ended = np.setdiff1d(earlier.ids, tracks.ids, assume_unique=True)
        found = self._result(frame, seen, tracks, line_of, ended, reset)
        return self._confirmations.add(self._selection.of(found, size))

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

    def _pair(self, tracks: TrackTable, seen: LineFeatures) -> Pairs:
        """The line of each track: first for those seen in the last frame, then for the others."""
        config = self.config
        current = tracks.missed == 0
        most = np.where(current, config.max_band, config.max_lost_band)
        bands = np.minimum(config.band + 3 * _spread(tracks), most).astype(np.float32)
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

    def _gated(self, tracks: TrackTable, pairs: Pairs, seen: Seen) -> Pairs:
        """The pairs without those of which the line is not where the track must be, or looks unlike it at its birth."""
        hit = np.flatnonzero(pairs >= 0)
        paired, profiles = tracks.take(hit), seen.features.profiles[pairs[hit]].copy()
        _, _, squares, away = _innovations(paired, seen, pairs[hit])
        self._noise = max(1.0, float(np.median(squares)) / MEDIAN_SQUARE) if len(hit) >= CUT_LEAST else 1.0
        surprise = squares / self._noise
        backwards = _runs_backwards(paired.segments, seen.features.segments[pairs[hit]])
        profiles[backwards] = profiles[backwards, ::-1]
        changed = (profiles * paired.first_profiles).sum(axis=1) < self.config.min_appearance_first
        far = (surprise > self.config.gate) & ((away > NEAR_ENOUGH) | (paired.surprise > MOST_SURPRISE))
        kept = pairs.copy()
        kept[hit[far | (changed & (surprise > CALM_SQUARE))]] = -1
        return kept

    def _guided(
        self, tracks: TrackTable, pairs: Pairs, seen: Seen, edges: NDArray[np.float32], gray: NDArray[np.uint8], lengths: NDArray[np.float64]
    ) -> tuple[Pairs, Seen]:
        """Measure the tracks without a line on the edge map."""
        rows = np.flatnonzero((pairs < 0) & (lengths >= 8) & (tracks.missed <= 3))
        if not len(rows):
            return pairs, seen
        alone = tracks.take(rows)
        bands = np.minimum(1.0 + 2 * _spread(alone), MAX_GUIDED).astype(np.float32)
        found = measure(edges, alone.segments, bands)
        long = np.linalg.norm(found.segments[:, 1] - found.segments[:, 0], axis=1)
        good = (found.support >= self.config.min_support) & (long >= np.maximum(8, 0.5 * lengths[rows]))
        profiles = side_profiles(gray, found.segments)
        good &= (profiles * alone.profiles).sum(axis=1) >= self.config.min_appearance_measured
        good &= (profiles * alone.first_profiles).sum(axis=1) >= self.config.min_appearance_first
        features = LineFeatures(found.segments, alone.descriptors, profiles)
        errors = line_covariances(found.segments, found.residuals, MEASURED)
        squares = innovations(
            alone.segments.astype(np.float64), alone.covariances.astype(np.float64), found.segments.astype(np.float64), errors.astype(np.float64)
        )[2]
        good &= squares <= self.config.gate * self._noise
        good[good] = ~covered(found.segments[good], seen.features.segments)
        chosen = np.flatnonzero(good)
        pairs = pairs.copy()
        pairs[rows[chosen]] = len(seen.scores) + np.arange(len(chosen))
        more = Seen(
            seen.features.append(features.take(chosen)),
            np.concatenate([seen.errors, errors[chosen]]),
            np.concatenate([seen.scores, (found.support * found.strength)[chosen]]),
            seen.detected,
        )
        return pairs, more

    def _next(
        self,
        tracks: TrackTable,
        pairs: Pairs,
        seen: Seen,
        frame_index: int,
        edges: NDArray[np.float32] | None,
        focal: float,
        lengths: NDArray[np.float64],
    ) -> tuple[TrackTable, Pairs]:
        """The tracks after this frame: those that go on, filtered with their lines, and new ones; and the line of each."""
        features = seen.features
        hit = pairs >= 0
        tracks = self._updated(tracks, hit, seen, pairs[hit], edges)
        observed = features.segments[pairs[hit]]
        alive = self._alive(tracks, hit, observed, lengths)
        free = np.ones(seen.detected, np.bool_)
        free[pairs[hit & (pairs < seen.detected)]] = False
        new = np.flatnonzero(free).astype(np.int32)
        parent = parents(np.concatenate([observed, features.segments[new]]), tracks.segments[hit])
        of_parent = np.append(np.where(tracks.fragment_of >= 0, tracks.fragment_of, tracks.ids)[hit], -1)[parent]
        tracks = tracks.with_rows(hit, {"fragment_of": np.maximum(tracks.fragment_of[hit], of_parent[: hit.sum()])})
        fragment_of = of_parent[hit.sum() :]
        begun = features.take(new)
        covariances = new_covariances(begun.segments, seen.errors[new], focal)
        begun_tracks = new_tracks(self._next_id, frame_index, begun, covariances, fragment_of)
        self._next_id += len(new)
        return tracks.take(alive).append(begun_tracks), np.concatenate([pairs[alive], new])

    def _updated(
        self, tracks: TrackTable, hit: NDArray[np.bool_], seen: Seen, rows: Pairs, edges: NDArray[np.float32] | None
    ) -> TrackTable:
        """The tracks with one more frame; those that were hit are filtered with their lines."""
        here = tracks.take(hit)
        lines = seen.features.take(rows)
        backwards = _runs_backwards(here.segments, lines.segments)
        observed, profiles = lines.segments.copy(), lines.profiles.copy()
        observed[backwards], profiles[backwards] = observed[backwards, ::-1], profiles[backwards, ::-1]
        offsets, spread, squares, _ = _innovations(here, seen, rows)
        squares /= self._noise
        spread *= np.maximum(1, squares / self.config.gate)[:, None, None]
        segments, depths, covariances = update(
            here.segments.astype(np.float64), here.depths.astype(np.float64), here.covariances.astype(np.float64), offsets, spread
        )
        ends = np.concatenate([here.ends[:, :, 1:], _along(segments, observed)[:, :, None]], axis=2)
        extents = usual_extents(ends)
        if edges is not None:
            extents = supported(edges, segments, ends[:, :, -1].astype(np.float64), extents)
        low, high = np.ascontiguousarray(extents.T)
        segments, depths, covariances = slide(segments, depths, covariances, low, high)
        ends = (ends - low[:, None, None]) / (high - low)[:, None, None]
        filtered = {
            "segments": segments.astype(np.float32),
            "depths": depths.astype(np.float32),
            "covariances": covariances.astype(np.float32),
            "ends": ends.astype(np.float32),
            "descriptors": lines.descriptors,
            "profiles": MEMORY * here.profiles + (1 - MEMORY) * profiles,
            "surprise": CALM * here.surprise + (1 - CALM) * (np.minimum(squares, 2 * self.config.gate) / 2).astype(np.float32),
        }
        return replace(
            tracks.with_rows(hit, filtered),
            hits=(tracks.hits + hit).astype(np.int32),
            missed=np.where(hit, 0, tracks.missed + 1).astype(np.int32),
            visible=hit,
        )

    def _alive(
        self, tracks: TrackTable, hit: NDArray[np.bool_], observed: NDArray[np.float32], lengths: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """(N,) mask: seen lately, still in the image, and no piece that is part of its whole line again."""
        confirmed = tracks.hits >= self.config.confirm_hits
        patience = np.where(confirmed, np.minimum(self.config.max_missed, 2 + tracks.hits // 2), self.config.max_missed_tentative)
        place = np.searchsorted(tracks.ids[hit], tracks.fragment_of)
        found = np.append(tracks.ids[hit], -2)[place] == tracks.fragment_of
        whole_again = absorbed(tracks.segments, np.where(found & ~hit, place, -1), observed)
        alive: NDArray[np.bool_] = (tracks.missed <= patience) & ~whole_again & (hit | (lengths >= MIN_VISIBLE))
        return alive

    def _result(
        self,
        frame: Frame,
        seen: Seen,
        tracks: TrackTable,
        line_of: Pairs,
        ended_ids: NDArray[np.int64],
        reset: str | None,
    ) -> LineTracks:
        confirmed = tracks.hits >= self.config.confirm_hits
        lost = (line_of < 0) & confirmed
        here, rows = tracks.take(line_of >= 0), line_of[line_of >= 0]
        observed = seen.features.segments[rows]
        backwards = _runs_backwards(here.segments, observed)
        observed[backwards] = observed[backwards, ::-1]
        consistency = np.sqrt(here.surprise)
        certain = confirmed[line_of >= 0]
        length = np.linalg.norm(here.segments[:, 1] - here.segments[:, 0], axis=1)
        return LineTracks(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            ids=here.ids,
            segments_px=here.segments,
            observed_px=observed,
            covariances=with_bias(line_part(here.segments, here.covariances), here.across),
            observed_covariances=with_bias(seen.errors[rows], here.across),
            scores=seen.scores[rows],
            descriptors=here.descriptors,
            states=np.where(certain, TrackState.CONFIRMED, TrackState.TENTATIVE).astype(np.uint8),
            ages=(frame.index - here.born).astype(np.int32),
            hits=here.hits,
            measured=rows >= seen.detected,
            consistency=consistency,
            stable=certain & (consistency <= 1.5) & (length >= 15),
            line_indices=np.where(rows < seen.detected, rows, -1).astype(np.int32),
            fragment_of=here.fragment_of,
            lost_ids=tracks.ids[lost],
            lost_segments_px=tracks.segments[lost],
            lost_frames=tracks.missed[lost],
            ended_ids=ended_ids,
            camera=frame.camera,
            reset=reset,
        )


def _spread(tracks: TrackTable) -> NDArray[np.float32]:
    """(N,) standard deviation of where each track should be, px, the larger one of its ends'."""
    return np.sqrt(np.maximum(tracks.covariances[:, 0, 0], tracks.covariances[:, 1, 1]))


def _innovations(tracks: TrackTable, seen: Seen, rows: Pairs) -> tuple[NDArray[np.float64], ...]:
    """What `state.innovations` says of tracks and the lines that are paired with them."""
    measured = seen.features.segments[rows].astype(np.float64)
    backwards = _runs_backwards(tracks.segments, seen.features.segments[rows])
    measured[backwards] = measured[backwards, ::-1]
    states = tracks.segments.astype(np.float64), tracks.covariances.astype(np.float64)
    found: tuple[NDArray[np.float64], ...] = innovations(*states, measured, seen.errors[rows].astype(np.float64))
    return found


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
