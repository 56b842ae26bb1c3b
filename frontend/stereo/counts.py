"""What a run's tracks came to in the right images, and whether these look like those of a rectified pair."""

from __future__ import annotations

from collections import deque
from statistics import median

import numpy as np

from frontend.tracks import LineTracks

LEAST = 100  # confirmed tracks, of all frames together, that tell something
FEW = 0.4  # of them with a partner, below which hardly a pair was given
STILL, MANY = 0.5, 0.5  # px from the ends of a line to its partner's, and the share of such that are no second view
ROWS_OFF, FRAMES = 0.7, 1000  # px, of the median of so many last frames


class PartnerCounts:
    """Adds up the partners of confirmed tracks, frame by frame.

    Attributes:
        stereo: whether there was a right image.
        confirmed, found, known: tracks of all frames; those of them with a partner, and with a known depth.
    """

    def __init__(self) -> None:
        self.stereo = False
        self.confirmed = self.found = self.known = 0
        self._still = 0
        self._rows_off: deque[float] = deque(maxlen=FRAMES)

    def add(self, tracks: LineTracks) -> None:
        """Count one frame's tracks."""
        if not len(tracks.right_hits) or tracks.depth_known is None:
            return
        self.stereo = True
        found, apart = tracks.right_hits > 0, tracks.right_px - tracks.observed_px
        self.confirmed += int(tracks.confirmed.sum())
        self.found += int((tracks.confirmed & found).sum())
        self.known += int((tracks.confirmed & tracks.depth_known).sum())
        self._still += int((tracks.confirmed & found & (np.abs(apart) < STILL).all(axis=(1, 2))).sum())
        whole = tracks.depth_known & ~tracks.right_measured & ~tracks.measured  # whose ends were detected in both
        if whole.any():
            self._rows_off.append(float(np.median(apart[whole, :, 1])))

    def notes(self) -> list[str]:
        """A sentence where what was given is hardly a rectified pair."""
        if self.confirmed < LEAST:
            return []
        if self.found < FEW * self.confirmed:
            return [
                f"{self.found / self.confirmed:.0%} of the lines have a partner, so the images may be no rectified "
                "pair: check --calib, --right-calib and --rectified"
            ]
        if self._still > MANY * self.found:
            return ["both images show nearly the same: check that the right ones are the right camera's"]
        off = median(self._rows_off) if self._rows_off else 0.0
        if abs(off) > ROWS_OFF:
            return [f"the right image's rows are {off:+.1f} px off, so depths are wrong: rectify by a calibration"]
        return []
