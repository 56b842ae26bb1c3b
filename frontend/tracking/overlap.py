"""How lines lie beside each other: votes of tracks for detected lines, and which lines are pieces of one that broke."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airline.kernels.compiled import njit

AGAIN = 0.65  # weight of the part seen last against the whole track in what a line covers
# A piece of a line that broke is
MAX_DISTANCE = 1.0  # px from that line at most
MIN_COS = np.cos(np.deg2rad(8.0))  # of the angle between both,
MIN_INSIDE = 0.5  # of its length within the extent of the whole line, and
MAX_TWICE = 0.3  # share of a piece beside the piece that the track goes on with: more is a parallel line


@dataclass(frozen=True)
class LineFeatures:
    """Segments, and what tells them apart from their neighbours.

    Attributes:
        segments: (N, 2, 2) float32 px.
        descriptors: (N, C) float32 orientation descriptors, unit rows.
        profiles: (N, K) float32 grey levels across the lines, see `appearance.side_profiles`.
    """

    segments: NDArray[np.float32]
    descriptors: NDArray[np.float32]
    profiles: NDArray[np.float32]

    def take(self, rows: NDArray[np.bool_] | NDArray[np.int32]) -> LineFeatures:
        """Some of the segments."""
        return LineFeatures(self.segments[rows], self.descriptors[rows], self.profiles[rows])

    def append(self, other: LineFeatures) -> LineFeatures:
        """These segments, then the others."""
        arrays = ("segments", "descriptors", "profiles")
        return LineFeatures(*(np.concatenate([getattr(self, a), getattr(other, a)]) for a in arrays))


def overlap_votes(
    tracks: LineFeatures,
    lines: LineFeatures,
    bands: NDArray[np.float32],
    parts: NDArray[np.float32],
    min_appearance: NDArray[np.float32],
    *,
    max_angle: float,
    min_agreement: float,
) -> NDArray[np.float32]:
    """Votes of every track, where it should be by now, for every detected line.

    The samples of a track that fall on a line earn it votes: in the limit of dense samples, the length along which
    the two run side by side within the band, as a share of the shorter one; and the same with the part of the track
    that was seen last, as a share of the longer one. This cover times closeness, 1 - distance / band, is squared and
    weighted by the descriptors' dot product and by how alike both sides look.

    Args:
        tracks: N predicted tracks.
        lines: M detected lines.
        bands: (N,) float32 half width of each track's search band, px.
        parts: (N, 2, 2) float32 px, the part of each track that was seen last: of the pieces of a broken line it goes
            on with that one.
        min_appearance: (N,) float32 lines whose profiles have a smaller dot product with the track's earn nothing,
        max_angle: nor do those that differ more in direction, radians,
        min_agreement: or whose descriptors have a smaller dot product.

    Returns:
        (N, M) float32 in [0, 1].
    """
    each = [(one.segments, one.descriptors, one.profiles) for one in (tracks, lines)]
    votes: NDArray[np.float32] = _votes(
        *each[0], *each[1], bands, parts, min_appearance, np.cos(max_angle), min_agreement
    )
    return votes


@njit()
def beside(track, line):  # type: ignore[no-untyped-def]
    """Where a line runs beside a track: shared length, px, its distance there at both ends, and the cosine.

    The cosine of their directions has the sign of the line's direction along the track.
    """
    x0, y0 = track[0, 0], track[0, 1]
    ux, uy = track[1, 0] - x0, track[1, 1] - y0
    length = np.sqrt(ux * ux + uy * uy)
    vx, vy = line[1, 0] - line[0, 0], line[1, 1] - line[0, 1]
    other = np.sqrt(vx * vx + vy * vy)
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


@njit()
def _votes(  # type: ignore[no-untyped-def]  # shapes and dtypes as in `LineFeatures` and `overlap_votes`
    tracks,
    descriptors,
    profiles,
    lines,
    line_descriptors,
    line_profiles,
    bands,
    parts,
    min_alike,
    min_cos,
    min_agreement,
):
    votes = np.zeros((len(tracks), len(lines)), np.float32)
    x, y, lengths = middles_and_lengths(lines)
    width = profiles.shape[1]
    near = np.empty(len(lines), np.int64)
    for i in range(len(tracks)):
        track, band = tracks[i], bands[i]
        length = np.hypot(track[1, 0] - track[0, 0], track[1, 1] - track[0, 1])
        for c in range(lines_near(track, length, band, x, y, lengths, np.sqrt(1 - min_cos**2), near)):
            j = near[c]
            shared, at_low, at_high, cosine = beside(track, lines[j])
            distance = 0.5 * (at_low + at_high)
            if shared <= 0 or abs(cosine) < min_cos or distance >= band or max(at_low, at_high) > 1.5 * band:
                continue
            agreement = np.float32(0)
            for k in range(descriptors.shape[1]):
                agreement += descriptors[i, k] * line_descriptors[j, k]
            if agreement < min_agreement:
                continue
            alike = np.float32(0)
            for k in range(width):
                alike += profiles[i, k] * line_profiles[j, k if cosine > 0 else width - 1 - k]
            if alike < min_alike[i]:
                continue
            part = np.hypot(parts[i, 1, 0] - parts[i, 0, 0], parts[i, 1, 1] - parts[i, 0, 1])
            again = beside(parts[i], lines[j])[0] / max(part, lengths[j], np.float32(1))
            cover = (1 - AGAIN) * shared / min(length, lengths[j]) + AGAIN * again
            together = cover * (1 - distance / band)
            votes[i, j] = together**2 * agreement * 0.5 * (1 + alike)
    return votes


@njit()
def middles_and_lengths(lines):  # type: ignore[no-untyped-def]
    """x and y of the middles of (N, 2, 2) segments, and their lengths, as `lines_near` takes them."""
    half = np.float32(0.5)
    x, y = half * (lines[:, 0, 0] + lines[:, 1, 0]), half * (lines[:, 0, 1] + lines[:, 1, 1])
    return x, y, np.hypot(lines[:, 1, 0] - lines[:, 0, 0], lines[:, 1, 1] - lines[:, 0, 1])


@njit()
def lines_near(track, length, band, x, y, lengths, slant, near):  # type: ignore[no-untyped-def]
    """Write down which lines may lie beside a track, and return how many; most of the time goes into saying no."""
    mx, my = np.float32(0.5) * (track[0, 0] + track[1, 0]), np.float32(0.5) * (track[0, 1] + track[1, 1])
    dx, dy = track[1, 0] - track[0, 0], track[1, 1] - track[0, 1]
    reach, across = np.float32(0.5 * length + band), np.float32(1.5 * band * length)
    turned = np.float32(0.5 * slant * length)
    possible = np.empty(len(x), np.bool_)
    for j in range(len(x)):  # without a branch, so that the compiler does eight at a time
        ax, ay = x[j] - mx, y[j] - my
        possible[j] = (
            (abs(ax * dy - ay * dx) <= across + turned * lengths[j])
            & (abs(ax) <= reach + np.float32(0.5) * lengths[j])
            & (abs(ay) <= reach + np.float32(0.5) * lengths[j])
        )
    count = 0
    for j in range(len(x)):
        near[count] = j
        count += possible[j]
    return count


@njit()
def parents(seen: NDArray[np.float32], whole: NDArray[np.float32]) -> NDArray[np.int64]:
    """The older track whose line each line is a piece of.

    Args:
        seen: (M, 2, 2) float32 px, the lines of this frame: first those of the N tracks that go on, by their age, then
            those of no track yet.
        whole: (N, 2, 2) float32 px, the tracks' fused segments.

    Returns:
        (M,) int64 row of the track, or -1.
    """
    rows = np.full(len(seen), -1, np.int64)
    x, y, lengths = middles_and_lengths(whole)
    near = np.empty(len(whole), np.int64)
    for m in range(len(seen)):
        piece, nearest = seen[m], MAX_DISTANCE
        length = np.hypot(piece[1, 0] - piece[0, 0], piece[1, 1] - piece[0, 1])
        for c in range(lines_near(piece, length, MAX_DISTANCE, x, y, lengths, np.sqrt(1 - MIN_COS**2), near)):
            n = near[c]
            if n >= m:
                break
            shared, at_low, at_high, cosine = beside(whole[n], piece)
            distance = max(at_low, at_high)
            if shared < MIN_INSIDE * length or abs(cosine) < MIN_COS or distance >= nearest:
                continue
            if beside(seen[n], piece)[0] <= MAX_TWICE * length:
                nearest, rows[m] = distance, n
    return rows


@njit()
def absorbed(
    pieces: NDArray[np.float32], parent_rows: NDArray[np.int64], seen: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Which missed pieces have become part of their parent's line again.

    Args:
        pieces: (M, 2, 2) float32 px, where the pieces should be.
        parent_rows: (M,) int64 row of each one's parent among the lines, or -1.
        seen: (N, 2, 2) float32 px, the lines that the tracks go on with.

    Returns:
        (M,) mask.
    """
    mask = np.zeros(len(pieces), np.bool_)
    for m in range(len(pieces)):
        if parent_rows[m] >= 0:
            length = np.hypot(pieces[m, 1, 0] - pieces[m, 0, 0], pieces[m, 1, 1] - pieces[m, 0, 1])
            shared, at_low, at_high, _ = beside(seen[parent_rows[m]], pieces[m])
            mask[m] = shared >= MIN_INSIDE * length and max(at_low, at_high) < 2 * MAX_DISTANCE
    return mask


def doubles(segments: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(N,) mask of the (N, 2, 2) segments, px, that lie on one before them."""
    mask: NDArray[np.bool_] = covered(segments, segments[:0])
    return mask


@njit()
def covered(found: NDArray[np.float32], lines: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which lines lie on one of others, or on one before them.

    Args:
        found: (M, 2, 2) float32 px.
        lines: (N, 2, 2) float32 px.

    Returns:
        (M,) mask.
    """
    mask = np.zeros(len(found), np.bool_)
    everything = np.concatenate((lines, found))
    x, y, lengths = middles_and_lengths(everything)
    near = np.empty(len(everything), np.int64)
    for m in range(len(found)):
        length = lengths[len(lines) + m]
        count = lines_near(found[m], length, MAX_DISTANCE, x, y, lengths, np.sqrt(1 - MIN_COS**2), near)
        for c in range(count):
            n = near[c]
            if n >= len(lines) + m:
                break
            if n >= len(lines) and mask[n - len(lines)]:
                continue
            shared, at_low, at_high, cosine = beside(everything[n], found[m])
            if shared >= MIN_INSIDE * length and abs(cosine) >= MIN_COS and max(at_low, at_high) < MAX_DISTANCE:
                mask[m] = True
                break
    return mask
