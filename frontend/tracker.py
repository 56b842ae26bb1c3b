"""Tracking of lines by descriptor overlap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError
from airline.image import to_uint8
from airline.lines import LineSet
from airline.trace import Trace
from frontend.frame import Frame
from frontend.history import Confirmations
from frontend.stereo.partners import PartnerFinder
from frontend.tracking.camera_motion import Motion
from frontend.tracking.config import TrackerConfig
from frontend.tracking.correction import corrected
from frontend.tracking.extents import MIN_EDGE
from frontend.tracking.flow import WorkingImage, working_image
from frontend.tracking.guided import look_for
from frontend.tracking.measurement import with_bias, with_rest
from frontend.tracking.overlap import absorbed, covered, doubles, parents
from frontend.tracking.pairing import Pairs, gated, pair
from frontend.tracking.points import PointTracker
from frontend.tracking.prediction import camera_of, focal_of, predicted
from frontend.tracking.seen import Seen, detected
from frontend.tracking.selection import Selection
from frontend.tracking.state import line_part, new_covariances
from frontend.tracking.table import TrackTable, new_tracks, no_tracks
from frontend.tracks import LineTracks, TrackState

MIN_VISIBLE = 5.0  # px; a track of which less is left in the image ends
MOST_DOUBLED = 5  # frames in a row that a track may lie on an older one
FIRST_PATIENCE = 2  # frames that a track may be missed, and half of those in which it was seen
MAX_INCONSISTENCY, MIN_STABLE = 1.5, 15.0  # of a stable track: most consistency, least length in px
CUT_FLOW = 0.2  # share of consistent flow below which an image may show another scene,
CUT_TRACKS = 0.1  # if no more than this share of the tracks goes on
CUT_LEAST = 10  # and there are so many tracks and lines that this is not chance


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
        self._points = PointTracker() if self.config.points else None
        self._partners = PartnerFinder()
        self._next_id = 0
        self._tracks: TrackTable | None = None
        self._image: WorkingImage | None = None
        self._size = (0, 0)
        self._stamp_ns = 0
        self._motion = Motion()
        self._confirmations = Confirmations()

    def update(
        self, frame: Frame, lines: LineSet, edges: NDArray[np.float32] | None = None, right: Trace | None = None
    ) -> LineTracks:
        """Take the lines of the next frame and return the tracks that were seen in it.

        Args:
            frame: the image, in time order.
            lines: its detected lines.
            edges: (H, W) float32 edge probability of the image, on which tracks without a line are looked for.
            right: the detector's results for `frame.right`, in which the tracks' partners are looked for.

        Raises:
            InputError: lines that are not finite, or edges of another type, or of another size than the image's.
        """
        gray = to_uint8(frame.gray)
        if not np.isfinite(lines.segments).all():
            raise InputError("the lines' end points must be finite numbers")
        if edges is not None and (edges.shape != gray.shape or edges.dtype != np.float32):
            raise InputError(
                f"the edges are {edges.dtype} {edges.shape}: give float32 of the image's size {gray.shape}"
            )
        blind = not len(lines) and (edges is None or not (edges >= MIN_EDGE).any())
        image, size = working_image(gray), (gray.shape[1], gray.shape[0])
        camera = camera_of(frame.camera, size)
        seen = detected(lines, gray)
        earlier = no_tracks(seen.features) if self._tracks is None else self._tracks
        tracks, pairs, lengths, noise = earlier, np.full(len(earlier), -1, np.int32), np.full(len(earlier), np.inf), 1.0
        reset, motion = self._reset_reason(frame.stamp_ns, size), None
        if reset is None and len(earlier) and not blind:
            ahead = predicted(earlier, image if self._image is None else self._image, image, camera, size, self._motion)
            tracks, lengths, self._motion = ahead.tracks, ahead.lengths, ahead.motion
            motion = ahead.motion
            pairs = pair(tracks, seen.features, self.config)
            reset = _cut_reason(ahead.trusted, earlier.visible, pairs, len(lines))
            if reset is None:
                pairs, noise = gated(tracks, pairs, seen, self.config)
                if edges is not None:
                    pairs, seen = look_for(tracks, pairs, lengths, seen, edges, gray, self.config, noise)
        if reset is not None:
            tracks, pairs, lengths = no_tracks(seen.features), np.zeros(0, np.int32), np.zeros(0)
            self._motion = Motion()
        tracks = corrected(tracks, pairs, seen, edges, size, self.config, noise)
        tracks, line_of = self._next(tracks, pairs, seen, frame.index, lengths, focal_of(camera))
        if not blind or reset is not None:
            self._image = image
        else:  # an image without any edge says nothing: the tracks wait where they were
            tracks = replace(tracks, visible=earlier.visible[np.searchsorted(earlier.ids, tracks.ids)])
        self._tracks, self._size, self._stamp_ns = tracks, size, frame.stamp_ns
        ended = np.setdiff1d(earlier.ids, tracks.ids, assume_unique=True)
        found = self._result(frame, seen, tracks, line_of, ended, reset)
        if self._points is not None:
            if blind or reset is not None:
                self._points.end_all()
            if not blind:
                point_ids, points = self._points.update(gray, image, camera, motion)
                found = replace(found, point_ids=point_ids, points_px=points)
        found = self._selection.of(found, size)
        if right is None or reset is not None:
            self._partners = PartnerFinder()
        if right is not None:
            found = self._partners.update(found, frame, right)
        return self._confirmations.add(found)

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

    def _next(
        self,
        tracks: TrackTable,
        pairs: Pairs,
        seen: Seen,
        frame_index: int,
        lengths: NDArray[np.float64],
        focal: float,
    ) -> tuple[TrackTable, Pairs]:
        """Those of the tracks that go on, and new ones for the lines that are left; and the line of each."""
        hit = pairs >= 0
        observed = seen.features.segments[pairs[hit]]
        tracks = tracks.with_rows(hit, {"doubled": np.where(doubles(tracks.segments[hit]), tracks.doubled[hit] + 1, 0)})
        alive = self._alive(tracks, hit, observed, lengths)
        free = np.ones(seen.detected, np.bool_)
        free[pairs[hit & (pairs < seen.detected)]] = False
        free[free] = ~covered(seen.features.segments[: seen.detected][free], observed)  # a line that was detected twice
        new = np.flatnonzero(free).astype(np.int32)
        begun = seen.features.take(new)
        parent = parents(np.concatenate([observed, begun.segments]), tracks.segments[hit])
        of_parent = np.append(np.where(tracks.fragment_of >= 0, tracks.fragment_of, tracks.ids)[hit], -1)[parent]
        tracks = tracks.with_rows(hit, {"fragment_of": np.maximum(tracks.fragment_of[hit], of_parent[: hit.sum()])})
        covariances = new_covariances(begun.segments, seen.errors[new], focal)
        begun_tracks = new_tracks(self._next_id, frame_index, begun, covariances, of_parent[hit.sum() :])
        self._next_id += len(new)
        return tracks.take(alive).append(begun_tracks), np.concatenate([pairs[alive], new])

    def _alive(
        self, tracks: TrackTable, hit: NDArray[np.bool_], observed: NDArray[np.float32], lengths: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """(N,) mask: seen lately, in the image, no piece that is part of its whole line again, not on an older one."""
        confirmed = tracks.hits >= self.config.confirm_hits
        patience = np.minimum(self.config.max_missed, FIRST_PATIENCE + tracks.hits // 2)
        patience = np.where(confirmed, patience, self.config.max_missed_tentative)
        place = np.searchsorted(tracks.ids[hit], tracks.fragment_of)
        found = np.append(tracks.ids[hit], -2)[place] == tracks.fragment_of
        whole_again = absorbed(tracks.segments, np.where(found & ~hit, place, -1), observed)
        alive: NDArray[np.bool_] = (tracks.missed <= patience) & ~whole_again & (hit | (lengths >= MIN_VISIBLE))
        return alive & (tracks.doubled <= MOST_DOUBLED)

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
        errors = seen.errors[rows]
        fused = with_rest(line_part(here.segments, here.covariances), errors, here.across)
        certain, consistency = confirmed[line_of >= 0], np.sqrt(here.surprise)
        length = np.linalg.norm(here.segments[:, 1] - here.segments[:, 0], axis=1)
        return LineTracks(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            ids=here.ids,
            segments_px=here.segments,
            observed_px=seen.along(rows, here.segments).segments,
            covariances=with_bias(fused, here.across),
            observed_covariances=with_bias(errors, here.across),
            scores=seen.scores[rows],
            descriptors=here.descriptors,
            states=np.where(certain, TrackState.CONFIRMED, TrackState.TENTATIVE).astype(np.uint8),
            ages=np.maximum(frame.index - here.born, 0).astype(np.int32),
            hits=here.hits,
            measured=rows >= seen.detected,
            consistency=consistency,
            stable=certain & (consistency <= MAX_INCONSISTENCY) & (length >= MIN_STABLE),
            line_indices=np.where(rows < seen.detected, rows, -1).astype(np.int32),
            fragment_of=here.fragment_of,
            lost_ids=tracks.ids[lost],
            lost_segments_px=tracks.segments[lost],
            lost_frames=tracks.missed[lost],
            ended_ids=ended_ids,
            camera=frame.camera,
            reset=reset,
        )


def _cut_reason(trusted: float, visible: NDArray[np.bool_], pairs: Pairs, lines: int) -> str | None:
    """Why this image shows another scene, if it does: nothing flows there, and hardly a track goes on."""
    if min(visible.sum(), lines) < CUT_LEAST or trusted >= CUT_FLOW:
        return None
    share = (pairs[visible] >= 0).mean()
    return f"scene cut: {100 * share:.0f} % of the tracks go on" if share <= CUT_TRACKS else None
