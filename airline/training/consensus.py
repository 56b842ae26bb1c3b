"""Pseudo-labels by homographic consensus: lines that a classical detector finds again in random views of an image.

The idea is SuperPoint's homographic adaptation (DeTone et al. 2018), for lines: detect in the image and in random
warps of it, map the segments back, and give every piece of a line the share of views that saw it.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.evaluation.metrics import corners
from airline.kernels.compiled import njit

SUPPORT_DISTANCE = 2.0  # px, between a point of a line and a line of another view
SUPPORT_ANGLE = np.deg2rad(8.0)
PIECE = 8.0  # px, length over which a share is averaged
MIN_LENGTH = 8.0  # px


def detect_lsd(gray: NDArray[np.uint8], scale: float = 1.0) -> NDArray[np.float32]:
    """(N, 2, 2) segments of OpenCV's LSD, px, pixel centres at integers; all of them, since the views sort them out."""
    lines = cv2.createLineSegmentDetector(cv2.LSD_REFINE_NONE, scale=scale).detect(gray)[0]
    if lines is None:
        return np.zeros((0, 2, 2), np.float32)
    # OpenCV scales its result back about the pixel corner; we count from the centre
    segments = (lines.reshape(-1, 2, 2) + (0.5 / scale - 0.5)).astype(np.float32)
    long: NDArray[np.float32] = segments[np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1) >= MIN_LENGTH]
    return long


def random_view(rng: np.random.Generator, width: int, height: int) -> NDArray[np.float64]:
    """(3, 3) homography from the image to a random view of it: any angle, mirror, scale and perspective."""
    centre = np.array([[1, 0, -(width - 1) / 2], [0, 1, -(height - 1) / 2], [0, 0, 1.0]])
    angle, scale = rng.uniform(-np.pi, np.pi), np.exp(rng.uniform(np.log(0.6), np.log(1.6)))
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turn[:, 0] *= rng.choice([-1, 1])
    tilt = np.eye(3)
    tilt[:2, :2] = turn
    tilt[2, :2] = rng.uniform(-0.25, 0.25, 2) / max(width, height)
    seen = cv2.perspectiveTransform(corners((height, width))[None], tilt @ centre)[0]
    back = np.eye(3)
    back[:2, 2] = -seen.min(axis=0)
    homography: NDArray[np.float64] = back @ tilt @ centre
    return homography


def degrade(rng: np.random.Generator, gray: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Random gamma, contrast and a little noise of one view; more would hide real lines from the labels."""
    image: NDArray[Any] = 255 * (gray / np.float32(255)) ** np.float32(np.exp(rng.uniform(-0.4, 0.4)))
    image *= np.float32(rng.uniform(0.8, 1.1))
    image += rng.standard_normal(image.shape, np.float32) * np.float32(rng.uniform(0, 1.5))
    return np.asarray(np.clip(np.rint(image), 0, 255), np.uint8)


def consensus(
    gray: NDArray[np.uint8], views: int, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Pieces of lines of an (H, W) image, and the share of `views` random views beside the image that saw each.

    Returns:
        pieces: (N, 2, 2) float32 px, about `PIECE` long.
        shares: (N,) float32 in [0, 1].
    """
    height, width = gray.shape
    candidates = np.concatenate([detect_lsd(gray), detect_lsd(gray, 0.5)])
    hits = [_view_lines(gray, random_view(rng, width, height), rng) for _ in range(views)]
    ends = np.cumsum([0, *(len(lines) for lines in hits)])
    refined, pieces, shares = _support(candidates, np.concatenate(hits), ends)
    order = np.argsort(-shares, kind="stable")
    keep = _suppress(pieces[order], refined[order])
    return refined[order][keep], shares[order][keep].astype(np.float32)


def _view_lines(
    gray: NDArray[np.uint8], homography: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float32]:
    size = np.ceil(cv2.perspectiveTransform(corners(gray.shape)[None], homography)[0].max(axis=0)).astype(int) + 1
    warped = cv2.warpPerspective(gray, homography, (int(size[0]), int(size[1])), borderMode=cv2.BORDER_REPLICATE)
    lines = detect_lsd(degrade(rng, warped)).astype(np.float64)
    if len(lines):
        lines = cv2.perspectiveTransform(lines.reshape(1, -1, 2), np.linalg.inv(homography)).reshape(-1, 2, 2)
    return lines.astype(np.float32)


@njit()
def _support(candidates, views, offsets):  # type: ignore[no-untyped-def]
    """Cut candidates into pieces; move each line to the mean of its supporters; share of views per piece."""
    n_views = len(offsets) - 1
    total = 0
    for line in candidates:
        total += max(1, int(np.hypot(line[1, 0] - line[0, 0], line[1, 1] - line[0, 1]) / PIECE))
    pieces = np.empty((total, 2, 2), np.float32)
    refined = np.empty((total, 2, 2), np.float32)
    shares = np.empty(total, np.float64)
    view_angles = np.arctan2(views[:, 1, 1] - views[:, 0, 1], views[:, 1, 0] - views[:, 0, 0])
    row = 0
    for line in candidates:
        dx, dy = line[1, 0] - line[0, 0], line[1, 1] - line[0, 1]
        length = np.hypot(dx, dy)
        dx, dy = dx / length, dy / length
        angle = np.arctan2(dy, dx)
        n = max(1, int(length / PIECE))
        support = np.zeros(n)
        # weighted sums of the supporters' offsets for the mean offset and slope along the line
        s0, s1, s2, m0, m1 = 1e-9, 0.0, 0.0, 0.0, 0.0
        for view in range(n_views):
            best = np.full(n, SUPPORT_DISTANCE)
            signed = np.zeros(n)
            for k in range(offsets[view], offsets[view + 1]):
                turn = abs(view_angles[k] - angle) % np.pi
                if min(turn, np.pi - turn) > SUPPORT_ANGLE:
                    continue
                ax, ay = views[k, 0, 0] - line[0, 0], views[k, 0, 1] - line[0, 1]
                bx, by = views[k, 1, 0] - line[0, 0], views[k, 1, 1] - line[0, 1]
                ta, tb = ax * dx + ay * dy, bx * dx + by * dy
                oa, ob = ay * dx - ax * dy, by * dx - bx * dy
                if ta > tb:
                    ta, tb, oa, ob = tb, ta, ob, oa
                for i in range(n):
                    t = (i + 0.5) * length / n
                    if ta - 1 <= t <= tb + 1:
                        offset = oa + (ob - oa) * (t - ta) / max(tb - ta, 1e-6)
                        if abs(offset) < best[i]:
                            best[i] = abs(offset)
                            signed[i] = offset
            for i in range(n):
                if best[i] < SUPPORT_DISTANCE:
                    t = (i + 0.5) * length / n - length / 2
                    support[i] += 1
                    s0 += 1
                    s1 += t
                    s2 += t * t
                    m0 += signed[i]
                    m1 += signed[i] * t
        det = s0 * s2 - s1 * s1
        slope = (s0 * m1 - s1 * m0) / det if det > 1e-3 * s0 * s0 and s0 > 1 else 0.0
        shift = (m0 - slope * s1) / s0
        for i in range(n):
            for end in range(2):
                t = (i + end) * length / n
                x, y = line[0, 0] + t * dx, line[0, 1] + t * dy
                offset = shift + slope * (t - length / 2)
                pieces[row, end, 0], pieces[row, end, 1] = x, y
                refined[row, end, 0], refined[row, end, 1] = x - dy * offset, y + dx * offset
            shares[row] = support[i] / max(n_views, 1)
            row += 1
    return refined, pieces, shares


@njit()
def _suppress(pieces, refined):  # type: ignore[no-untyped-def]
    """Mask of the pieces that no better, nearly parallel piece of another scale already covers."""
    keep = np.ones(len(pieces), np.bool_)
    for i in range(len(pieces)):
        mx, my = refined[i, :, 0].mean(), refined[i, :, 1].mean()
        ix, iy = refined[i, 1, 0] - refined[i, 0, 0], refined[i, 1, 1] - refined[i, 0, 1]
        for j in range(i):
            if not keep[j]:
                continue
            jx, jy = refined[j, 1, 0] - refined[j, 0, 0], refined[j, 1, 1] - refined[j, 0, 1]
            px, py = mx - refined[j, 0, 0], my - refined[j, 0, 1]
            norm = np.hypot(jx, jy)
            if norm < 1e-6 or abs(px) > 24 or abs(py) > 24:
                continue
            along, across = (px * jx + py * jy) / norm, abs(px * jy - py * jx) / norm
            cross = abs(ix * jy - iy * jx) / (norm * np.hypot(ix, iy) + 1e-9)
            if -1 <= along <= norm + 1 and across < 2.0 and cross < 0.2:
                keep[i] = False
                break
    return keep
