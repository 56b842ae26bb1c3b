"""The partners of tracked lines in the right image of a rectified pair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from airline.trace import Trace
from frontend.frame import Frame
from frontend.tracks import LineTracks


class PartnerFinder:
    """Finds the tracks' lines in the right images of a stream."""

    def update(self, tracks: LineTracks, frame: Frame, right: Trace) -> LineTracks:
        """The tracks of a frame with their partners.

        Args:
            tracks: N tracks of the left image.
            frame: it, with its right image.
            right: the detector's results for that one.
        """
        return replace(
            tracks,
            right_px=np.full((len(tracks), 2, 2), np.nan, np.float32),
            right_covariances=np.full((len(tracks), 2, 2), np.nan, np.float32),
            right_hits=np.zeros(len(tracks), np.int32),
            right_measured=np.zeros(len(tracks), np.bool_),
        )
