"""What is kept of a tracker's run: per frame, its tracks beside what is true."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from airline.lines import LineSet
from frontend.evaluation.clip import Truth
from frontend.frame import Frame


@dataclass(frozen=True)
class Tracked:
    """What a tracker says of one frame. Row k of every array speaks of the same track.

    Attributes:
        ids: (N,) int64 track ids, no two alike.
        line_indices: (N,) int32 row of the track's detection in the frame's `LineSet`.
        segments_px: (N, 2, 2) float32 where the tracker has the line, px.
        fragment_of: (N,) int64 the track that this one is known to be a piece of, -1 for none.
    """

    ids: NDArray[np.int64]
    line_indices: NDArray[np.int32]
    segments_px: NDArray[np.float32]
    fragment_of: NDArray[np.int64]

    @property
    def identities(self) -> NDArray[np.int64]:
        """(N,) int64 the track each row is an observation of: for a fragment the one it is a piece of."""
        return np.where(self.fragment_of >= 0, self.fragment_of, self.ids)


class Tracker(Protocol):
    """Anything that tracks lines."""

    def update(self, frame: Frame, lines: LineSet) -> Tracked:
        """Take the lines of the next frame."""
        ...


@dataclass(frozen=True)
class Record:
    """One frame of a tracker's run.

    Attributes:
        tracked: the tracker's answer.
        line_owners: (M,) int64 true line of every detected line, see `frontend.evaluation.truth.owners`.
        truth: what could be seen.
        size: (width, height) of the image, px.
        ms: time of the tracker's update.
    """

    tracked: Tracked
    line_owners: NDArray[np.int64]
    truth: Truth
    size: tuple[int, int]
    ms: float

    @cached_property
    def owners(self) -> NDArray[np.int64]:
        """(N,) int64 true line of every track."""
        return self.line_owners[self.tracked.line_indices]

    @cached_property
    def detected(self) -> NDArray[np.int64]:
        """(K,) int64 ids, ascending, of the true lines that were detected."""
        return np.unique(self.line_owners[self.line_owners >= 0])
