"""Lines in space from tracks under known poses, as LIMAP builds them."""

from __future__ import annotations

from collections.abc import Sequence

from line_odometry.geometry import Array
from line_odometry.triangulation import triangulate
from line_odometry.views import Ids, View, gather

LEAST_VIEWS = 5
MAX_RMS = 1.0  # px
SPREAD = 0.004  # of a line's worse end, see `Triangulated`: 4 mm at a metre


def map_lines(views: Sequence[View], poses: Array, focal: float) -> tuple[Ids, Array]:
    """The lines that tracks agree on.

    Args:
        views: what was seen in each frame.
        poses: (K, 3, 4) world_from_camera of each.
        focal: px.

    Returns:
        (N,) tracks, and (N, 2, 3) their end points in space: of each line what at least three views saw.
    """
    seen = gather(views, focal, LEAST_VIEWS)
    found = triangulate(seen, poses)
    good = found.ahead & (found.rms < MAX_RMS) & (found.spread < SPREAD)
    return seen.ids[good], found.segments[good]
