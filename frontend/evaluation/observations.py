"""All that a tracker said of a clip, track by track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frontend.evaluation.truth import Tracked
from frontend.tracks import LineTracks


@dataclass(frozen=True)
class Observations:
    """Rows of a tracker's run, in the order of tracks and, in each, of time.

    Attributes:
        ids: (R,) int64 track ids, ascending.
        frames: (R,) int64 the clip's frame, from 0.
        observed_px: (R, 2, 2) float64 as measured in that frame.
        segments_px: (R, 2, 2) float64 as the tracker fused it.
        measured: (R,) bool found by the tracker, not detected.
        stable: (R,) bool handed out as a landmark.
    """

    ids: NDArray[np.int64]
    frames: NDArray[np.int64]
    observed_px: NDArray[np.float64]
    segments_px: NDArray[np.float64]
    measured: NDArray[np.bool_]
    stable: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def starts(self) -> NDArray[np.intp]:
        """(T + 1,) the first row of every track, and the number of rows."""
        return np.append(np.flatnonzero(np.diff(self.ids, prepend=-1)), len(self.ids))

    def seen_in(self, frames: int) -> NDArray[np.bool_]:
        """(R,) mask of the tracks seen in so many frames and more."""
        counts = np.diff(self.starts)
        return np.repeat(counts >= frames, counts)

    def take(self, rows: NDArray[np.bool_] | slice) -> Observations:
        """Some of the rows."""
        return Observations(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


def collect(run: Sequence[Tracked | LineTracks]) -> Observations:
    """The observations of a tracker's answers, one for every frame of a clip."""
    ids = np.concatenate([np.zeros(0, np.int64), *(tracks.ids for tracks in run)])
    order = np.argsort(ids, kind="stable")

    def joined(name: str, dtype: type, *shape: int) -> NDArray[Any]:
        arrays = [np.zeros((0, *shape), dtype), *(getattr(tracks, name) for tracks in run)]
        return np.concatenate(arrays)[order]

    return Observations(
        ids=ids[order],
        frames=np.repeat(np.arange(len(run)), [len(tracks.ids) for tracks in run])[order],
        observed_px=joined("observed_px", np.float64, 2, 2),
        segments_px=joined("segments_px", np.float64, 2, 2),
        measured=joined("measured", np.bool_),
        stable=joined("stable", np.bool_),
    )
