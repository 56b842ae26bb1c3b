"""Tracking of lines by descriptor overlap."""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.image import to_gray, to_uint8
from airline.lines import LineSet
from frontend.frame import Frame
from frontend.motion import predict_segments
from frontend.overlap import assign, overlap_votes
from frontend.tracks import LineTracks, TrackState


class TrackerConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of the tracker.

    Attributes:
        confirm_hits: a track is confirmed when it was seen in this many frames.
        max_missed: a confirmed track that was not seen in more than this many frames in a row ends; a tentative one
            ends when it is missed once.
        band: a line may be this far from where its track is predicted, px.
        min_agreement: least dot product of the descriptors of a track and its line.
        min_vote: least vote (overlap x closeness x agreement) of a pair.
        max_gap_s: a longer gap between two frames ends all tracks, seconds.
    """

    confirm_hits: int = 3
    max_missed: int = 5
    band: float = 4.0
    min_agreement: Annotated[float, msgspec.Meta(ge=-1, le=1)] = 0.5
    min_vote: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.2
    max_gap_s: float = 1.0

    def __post_init__(self) -> None:
        if self.confirm_hits < 1 or self.max_missed < 0 or self.band <= 0 or self.max_gap_s <= 0:
            raise ConfigError("tracker needs confirm_hits >= 1, max_missed >= 0, band > 0 and max_gap_s > 0")


class LineTracker:
    """Gives the same physical line the same id from frame to frame.

    Predict each track by image motion, lay it over the new lines, let it vote for those it overlaps, weighted by how
    well their orientation descriptors agree, pair one to one, update.
    """

    def __init__(self, config: TrackerConfig | None = None) -> None:
        self.config = config or TrackerConfig()
        self._next_id = 0
        self._image: NDArray[np.uint8] | None = None
        self._stamp_ns = 0
        self._clear(0)

    def _clear(self, channels: int) -> None:
        self._ids = np.zeros(0, np.int64)
        self._segments = np.zeros((0, 2, 2), np.float32)
        self._descriptors = np.zeros((0, channels), np.float32)
        self._born = np.zeros(0, np.int64)
        self._hits = np.zeros(0, np.int32)
        self._missed = np.zeros(0, np.int32)

    def update(self, frame: Frame, lines: LineSet) -> LineTracks:
        """Take the lines of the next frame and return the tracks that were seen in it.

        Args:
            frame: the image, in time order.
            lines: its detected lines.
        """
        image = to_uint8(to_gray(frame.image))
        reset = self._reset_reason(frame, image)
        if reset or self._image is None:
            self._clear(lines.descriptors.shape[1])
        else:
            self._segments = predict_segments(self._image, image, self._segments)
        self._image, self._stamp_ns = image, frame.stamp_ns
        votes = overlap_votes(
            self._segments,
            self._descriptors,
            lines.segments,
            lines.descriptors,
            self.config.band,
            self.config.min_agreement,
        )
        seen = self._pair(assign(votes, self.config.min_vote), lines, frame.index)
        return self._tracks(frame, lines, seen, reset)

    def _reset_reason(self, frame: Frame, image: NDArray[np.uint8]) -> str | None:
        if self._image is None:
            return None
        if self._image.shape != image.shape:
            (old_h, old_w), (new_h, new_w) = self._image.shape, image.shape
            return f"resolution changed from {old_w}x{old_h} to {new_w}x{new_h}"
        gap = (frame.stamp_ns - self._stamp_ns) * 1e-9
        if gap < 0:
            return f"time went back by {-gap:.3f} s"
        if gap > self.config.max_gap_s:
            return f"gap of {gap:.3f} s"
        return None

    def _pair(self, chosen: NDArray[np.int32], lines: LineSet, frame_index: int) -> NDArray[np.int32]:
        """Update the tracks with their lines, end the lost ones, begin new ones; returns the line of each track."""
        hit = chosen >= 0
        matched = lines.segments[chosen[hit]]
        backwards = _runs_backwards(self._segments[hit], matched)
        matched[backwards] = matched[backwards, ::-1]
        self._segments[hit], self._descriptors[hit] = matched, lines.descriptors[chosen[hit]]
        self._hits[hit] += 1
        self._missed = np.where(hit, 0, self._missed + 1).astype(np.int32)
        patience = np.where(self._hits >= self.config.confirm_hits, self.config.max_missed, 0)
        alive = self._missed <= patience
        new = np.setdiff1d(np.arange(len(lines), dtype=np.int32), chosen[hit])
        ids = np.arange(self._next_id, self._next_id + len(new), dtype=np.int64)
        self._next_id += len(new)
        self._ids = np.concatenate([self._ids[alive], ids])
        self._segments = np.concatenate([self._segments[alive], lines.segments[new]])
        self._descriptors = np.concatenate([self._descriptors[alive], lines.descriptors[new]])
        self._born = np.concatenate([self._born[alive], np.full(len(new), frame_index)])
        self._hits = np.concatenate([self._hits[alive], np.ones(len(new), np.int32)])
        self._missed = np.concatenate([self._missed[alive], np.zeros(len(new), np.int32)])
        return np.concatenate([chosen[alive], new])

    def _tracks(self, frame: Frame, lines: LineSet, line_of: NDArray[np.int32], reset: str | None) -> LineTracks:
        seen = line_of >= 0
        confirmed = self._hits[seen] >= self.config.confirm_hits
        return LineTracks(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            ids=self._ids[seen],
            segments_px=self._segments[seen],
            scores=lines.scores[line_of[seen]],
            descriptors=self._descriptors[seen],
            states=np.where(confirmed, TrackState.CONFIRMED, TrackState.TENTATIVE).astype(np.uint8),
            ages=(frame.index - self._born[seen]).astype(np.int32),
            hits=self._hits[seen],
            line_indices=line_of[seen],
            camera=frame.camera,
            reset=reset,
        )


def _runs_backwards(reference: NDArray[np.float32], segments: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(N,) mask of the segments that point against their (N, 2, 2) reference."""
    a, b = reference[:, 1] - reference[:, 0], segments[:, 1] - segments[:, 0]
    backwards: NDArray[np.bool_] = (a * b).sum(axis=1) < 0
    return backwards
