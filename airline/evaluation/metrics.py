"""Scores of detections: pixels against annotated lines, and whether lines are found again in another view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, nan

import cv2
import numpy as np
from numpy.typing import NDArray

MAX_DISTANCE = 3.0  # px
MIN_OVERLAP = 0.5
MAX_ANGLE = np.deg2rad(30.0)
MIN_LENGTH = 10.0  # px in the common area
BEST = 50  # matches that count for the localisation
RADII = (0, 1, 2, 3, 5, 10)


@dataclass(frozen=True)
class PixelScores:
    """Scores of one image, or the mean over many, in percent.

    Attributes:
        lp: Line Precision per radius of `RADII` (equation 7 of the AirLine paper): the share of the sparsely
            annotated pixels within r px of a detected one. It is a recall, so read it beside a precision.
        p1: share of the detected pixels within 1 px of a densely annotated one.
        r1: share of the densely annotated pixels within 1 px of a detected one.
        p2: `p1` at 2 px.
        r2: `r1` at 2 px.
    """

    lp: tuple[float, ...]
    p1: float
    r1: float
    p2: float
    r2: float

    @property
    def f1(self) -> float:
        """F-score at 1 px: the harmonic mean of `p1` and `r1`."""
        return 2 * self.p1 * self.r1 / ((self.p1 + self.r1) or 1)

    @property
    def f2(self) -> float:
        """F-score at 2 px."""
        return 2 * self.p2 * self.r2 / ((self.p2 + self.r2) or 1)


def draw(segments: NDArray[np.floating], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W) mask of one-pixel-wide lines through (N, 2, 2) segments, px.

    End points are rounded to whole pixels (halves to even), as for published scores.
    """
    canvas = np.zeros(shape, np.uint8)
    cv2.polylines(canvas, list(np.rint(segments).astype(np.int32)), isClosed=False, color=1)
    return canvas > 0


def distance_to(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W) Euclidean distance of every pixel to the nearest one of the mask, px; infinite for an empty mask."""
    if not mask.any():
        return np.full(mask.shape, np.inf, np.float32)
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)


def coverage(mask: NDArray[np.bool_], distance: NDArray[np.float32], radius: float) -> float:
    """Percentage of a mask's pixels whose distance is at most `radius` px; 100 for an empty mask."""
    near = distance[mask] <= radius + 1e-3
    return 100 * float(near.mean()) if near.size else 100.0


def pixel_scores(
    segments: NDArray[np.floating], sparse: NDArray[np.floating], dense: NDArray[np.floating], shape: tuple[int, int]
) -> PixelScores:
    """Scores of the segments of one image; nothing detected has full precision, nothing annotated is fully recalled.

    Args:
        segments: (N, 2, 2) detections, px.
        sparse: (K, 2, 2) annotation for `lp`, px.
        dense: (L, 2, 2) annotation for precision and recall, px.
        shape: (height, width) of the image.
    """
    found, few, many = (draw(lines, shape) for lines in (segments, sparse, dense))
    to_found, to_many = distance_to(found), distance_to(many)
    lp = tuple(coverage(few, to_found, radius) for radius in RADII)
    pairs = [(coverage(found, to_many, radius), coverage(many, to_found, radius)) for radius in (1, 2)]
    return PixelScores(lp, *pairs[0], *pairs[1])


def mean(scores: Sequence[PixelScores]) -> PixelScores:
    """Mean over images; its F-scores are those of the mean precision and recall."""
    lp = np.mean([s.lp for s in scores], axis=0).tolist()
    return PixelScores(tuple(lp), *np.mean([(s.p1, s.r1, s.p2, s.r2) for s in scores], axis=0).tolist())


Lines = NDArray[np.floating]
Homography = NDArray[np.floating]


@dataclass(frozen=True)
class PairScores:
    """Scores of the lines of an image and of a view of it.

    Attributes:
        repeatability: share in [0, 1] of the lines in the common area that are matched, mean of both directions.
        localisation: mean distance of the 50 best matches, px; NaN where nothing is matched.
    """

    repeatability: float
    localisation: float


def random_view(rng: np.random.Generator, image: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], Homography]:
    """Another view of a (H, W) grey image under other light, and the (3, 3) homography from image to view.

    It is turned by up to 15 degrees, scaled by 0.8 to 1.25, each corner moved by up to a tenth of the image, with a
    random gamma and gain. The mirrored surroundings of the image fill it up.
    """
    height, width = image.shape
    frame = corners(image.shape)
    angle, scale = np.deg2rad(rng.uniform(-15, 15)), np.exp(rng.uniform(np.log(0.8), np.log(1.25)))
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = (frame - frame.mean(axis=0)) @ turn.T + frame.mean(axis=0)
    moved += rng.uniform(-0.1, 0.1, (4, 2)) * (width, height)
    homography = cv2.getPerspectiveTransform(frame.astype(np.float32), moved.astype(np.float32))
    view = cv2.warpPerspective(image, homography, (width, height), borderMode=cv2.BORDER_REFLECT_101)
    gamma, gain = np.exp(rng.uniform(-0.4, 0.4)), rng.uniform(0.6, 1.1)
    light = np.clip(np.rint(255 * gain * (np.arange(256) / 255) ** gamma), 0, 255).astype(np.uint8)
    return light[view], homography


def compare(image_lines: Lines, view_lines: Lines, homography: Homography, shape: tuple[int, int]) -> PairScores:
    """Match (N, 2, 2) lines of an image and (M, 2, 2) lines of a view of it, px; both have the same (height, width).

    Lines are cut to the area that both see and measured in the image; of those that keep 10 px, pairs are matched
    one to one, the nearest first, when distance, overlap and angle allow. Without lines the repeatability is 0.
    """
    inverse = np.linalg.inv(homography)
    seen = clip(image_lines, warp(corners(shape), inverse)), clip(view_lines, warp(corners(shape), homography))
    first, second = (
        lines[np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1) >= MIN_LENGTH]
        for lines in (seen[0], warp(seen[1], inverse))
    )
    if not len(first) or not len(second):
        return PairScores(0.0, nan)
    distances = match(first, second)
    share = (len(distances) / len(first) + len(distances) / len(second)) / 2
    return PairScores(share, float(np.mean(distances[:BEST])) if len(distances) else nan)


def match(first: Lines, second: Lines) -> NDArray[np.float64]:
    """Ascending distances, px, of a one-to-one matching of (N, 2, 2) and (M, 2, 2) lines, the nearest pairs first."""
    distance, overlap, cosine = measure_pairs(first, second)
    distance[(overlap < MIN_OVERLAP) | (cosine < np.cos(MAX_ANGLE))] = inf
    rows, columns = np.nonzero(distance <= MAX_DISTANCE)
    free_rows, free_columns = np.ones(len(first), bool), np.ones(len(second), bool)
    matched = []
    for k in np.argsort(distance[rows, columns], kind="stable"):
        row, column = rows[k], columns[k]
        if free_rows[row] and free_columns[column]:
            free_rows[row] = free_columns[column] = False
            matched.append(distance[row, column])
    return np.array(matched, np.float64)


def measure_pairs(first: Lines, second: Lines) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(N, M) distances (px), overlaps and absolute cosines of all pairs of (N, 2, 2) and (M, 2, 2) lines.

    The distance is the mean of the four distances of an end point to the other's infinite line; the overlap the share
    of a line that the other covers along it, mean of both (the measures of SOLD2, Pautrat et al. 2021).
    """
    distance_a, overlap_a = _project(second, first)
    distance_b, overlap_b = _project(first, second)
    cosine = np.abs(_directions(first) @ _directions(second).T)
    return (distance_a.T + distance_b) / 2, (overlap_a.T + overlap_b) / 2, cosine


def _project(lines: Lines, onto: Lines) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(N, M) mean distance of the end points of N lines to M others, and the share of the others that they cover."""
    direction = _directions(onto)
    length = np.linalg.norm(onto[:, 1] - onto[:, 0], axis=1)
    x, y = np.moveaxis(lines[:, None] - onto[None, :, 0, None], -1, 0)  # (N, M, 2) each
    across = np.abs(y * direction[:, None, 0] - x * direction[:, None, 1]).mean(axis=2)
    along = (x * direction[:, None, 0] + y * direction[:, None, 1]) / length[:, None]
    along = np.clip(along, 0, 1)
    return across, along.max(axis=2) - along.min(axis=2)


def _directions(lines: Lines) -> NDArray[np.float64]:
    delta = np.asarray(lines[:, 1] - lines[:, 0], np.float64)
    return np.asarray(delta / np.linalg.norm(delta, axis=1, keepdims=True))


def corners(shape: tuple[int, int]) -> NDArray[np.float64]:
    """(4, 2) centres of the corner pixels of a (height, width) image, clockwise on the screen."""
    right, bottom = shape[1] - 1, shape[0] - 1
    return np.array([[0, 0], [right, 0], [right, bottom], [0, bottom]], np.float64)


def warp(points: Lines, homography: Homography) -> NDArray[np.float64]:
    """Points (..., 2) through a (3, 3) homography."""
    mapped = np.asarray(points, np.float64) @ homography[:, :2].T + homography[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def clip(lines: Lines, polygon: NDArray[np.float64]) -> NDArray[np.float64]:
    """The parts of (N, 2, 2) lines inside a convex polygon, (K, 2) clockwise on the screen (Cyrus and Beck 1978)."""
    lines = np.asarray(lines, np.float64)
    start, delta = lines[:, 0], lines[:, 1] - lines[:, 0]
    low, high = np.zeros(len(lines)), np.ones(len(lines))
    for corner, following in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        inward = np.array([corner[1] - following[1], following[0] - corner[0]])
        depth, slope = (start - corner) @ inward, delta @ inward
        crossing = -depth / np.where(slope == 0, 1, slope)
        low = np.where(slope > 0, np.maximum(low, crossing), low)
        high = np.where(slope < 0, np.minimum(high, crossing), high)
        high[(slope == 0) & (depth < 0)] = -inf
    inside = high > low
    ends = np.stack([low, high], axis=1)[inside, :, None]
    return np.asarray(start[inside, None] + ends * delta[inside, None])
