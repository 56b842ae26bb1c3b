"""How well predicted tracks and detected lines cover each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

AGAIN = 0.65  # weight of the part seen last against the whole track in what a line covers


@dataclass(frozen=True)
class Looks:
    """Segments, and what tells them apart from their neighbours.

    Attributes:
        segments: (N, 2, 2) float32 px.
        descriptors: (N, C) float32 orientation descriptors, unit rows.
        profiles: (N, K) float32 grey levels across the lines, see `appearance.side_profiles`.
    """

    segments: NDArray[np.float32]
    descriptors: NDArray[np.float32]
    profiles: NDArray[np.float32]

    def take(self, rows: NDArray[np.bool_] | NDArray[np.int32]) -> Looks:
        """Some of the segments."""
        return Looks(self.segments[rows], self.descriptors[rows], self.profiles[rows])


def overlap_votes(
    tracks: Looks,
    lines: Looks,
    bands: NDArray[np.float32],
    parts: NDArray[np.float32],
    *,
    max_angle: float,
    min_agreement: float,
    min_appearance: float,
) -> NDArray[np.float32]:
    """Votes of every track, where it should be by now, for every detected line.

    The samples of a track that fall on a line earn it votes: in the limit of dense samples, the length along which
    the two run side by side within the band, as a share of the shorter one; and the same with the part of the track
    that was seen last, as a share of the longer one. This cover is weighted by closeness, (1 - distance / band)^2, by
    the descriptors' dot product, and by how alike both sides look.

    Args:
        tracks: N predicted tracks.
        lines: M detected lines.
        bands: (N,) float32 half width of each track's search band, px.
        parts: (N, 2, 2) float32 px, the part of each track that was seen last: of the pieces of a broken line it goes
            on with that one.
        max_angle: lines that differ more in direction earn nothing, radians.
        min_agreement: nor do those whose descriptors have a smaller dot product,
        min_appearance: or whose profiles have a smaller one, in [-1, 1].

    Returns:
        (N, M) float32 in [0, 1].
    """
    votes: NDArray[np.float32] = _votes(
        tracks.segments,
        tracks.descriptors,
        tracks.profiles,
        lines.segments,
        lines.descriptors,
        lines.profiles,
        bands,
        parts,
        np.cos(max_angle),
        min_agreement,
        min_appearance,
    )
    return votes


@njit(cache=True, nogil=True)
def beside(track, line):  # type: ignore[no-untyped-def]
    """Where a line runs beside a track: shared length, px, its distance there at both ends, and the cosine.

    The cosine of their directions has the sign of the line's direction along the track.
    """
    x0, y0 = track[0, 0], track[0, 1]
    ux, uy = track[1, 0] - x0, track[1, 1] - y0
    length = np.hypot(ux, uy)
    vx, vy = line[1, 0] - line[0, 0], line[1, 1] - line[0, 1]
    other = np.hypot(vx, vy)
    if length < 1e-3 or other < 1e-3:
        return 0.0, 0.0, 0.0, 0.0
    ux, uy = ux / length, uy / length
    cosine = (ux * vx + uy * vy) / other
    ta = (line[0, 0] - x0) * ux + (line[0, 1] - y0) * uy
    tb = (line[1, 0] - x0) * ux + (line[1, 1] - y0) * uy
    da = (line[0, 1] - y0) * ux - (line[0, 0] - x0) * uy
    db = (line[1, 1] - y0) * ux - (line[1, 0] - x0) * uy
    if ta > tb:
        ta, tb, da, db = tb, ta, db, da
    low, high = max(ta, 0.0), min(tb, length)
    if high <= low:
        return 0.0, 0.0, 0.0, cosine
    slope = (db - da) / max(tb - ta, 1e-3)
    return high - low, abs(da + slope * (low - ta)), abs(da + slope * (high - ta)), cosine


@njit(cache=True, nogil=True)
def _votes(  # type: ignore[no-untyped-def]
    tracks, looks, profiles, lines, line_looks, line_profiles, bands, parts, min_cos, min_agreement, min_alike
):
    votes = np.zeros((len(tracks), len(lines)), np.float32)
    middles = np.empty((len(lines), 2), np.float32)
    lengths = np.empty(len(lines), np.float32)
    for j in range(len(lines)):
        middles[j] = 0.5 * (lines[j, 0] + lines[j, 1])
        lengths[j] = np.hypot(lines[j, 1, 0] - lines[j, 0, 0], lines[j, 1, 1] - lines[j, 0, 1])
    width = profiles.shape[1]
    for i in range(len(tracks)):
        track = tracks[i]
        mx, my = 0.5 * (track[0, 0] + track[1, 0]), 0.5 * (track[0, 1] + track[1, 1])
        length = np.hypot(track[1, 0] - track[0, 0], track[1, 1] - track[0, 1])
        band = bands[i]
        for j in range(len(lines)):
            near = 0.5 * (length + lengths[j]) + band
            if abs(middles[j, 0] - mx) > near or abs(middles[j, 1] - my) > near:
                continue
            shared, at_low, at_high, cosine = beside(track, lines[j])
            distance = 0.5 * (at_low + at_high)
            if shared <= 0 or abs(cosine) < min_cos or distance >= band or max(at_low, at_high) > 1.5 * band:
                continue
            agreement = np.float32(0)
            for c in range(looks.shape[1]):
                agreement += looks[i, c] * line_looks[j, c]
            if agreement < min_agreement:
                continue
            alike = np.float32(0)
            for c in range(width):
                alike += profiles[i, c] * line_profiles[j, c if cosine > 0 else width - 1 - c]
            if alike < min_alike:
                continue
            part = np.hypot(parts[i, 1, 0] - parts[i, 0, 0], parts[i, 1, 1] - parts[i, 0, 1])
            again = beside(parts[i], lines[j])[0] / max(part, lengths[j], np.float32(1))
            cover = (1 - AGAIN) * shared / min(length, lengths[j]) + AGAIN * again
            closeness = 1 - distance / band
            votes[i, j] = cover * closeness * closeness * agreement * 0.5 * (1 + alike)
    return votes
