"""Lines of two images, and which are the same, by the votes that tracks give: no video is needed.

Points that look alike (SIFT) say how the image moves, RANSAC which of them to believe. Each line of the first image is
laid over the second one by a homography and by what the points nearest its ends move beyond that; every such place is a
hypothesis with a vote for the lines that it overlaps, and the pairs are those with the most votes in total.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from airline.detector import AirLine
from airline.errors import ConfigError, from_extra
from airline.evaluation.metrics import warp
from airline.image import to_gray, to_uint8
from airline.lines import LineSet
from frontend.camera.calibration import fit_camera
from frontend.camera.model import CameraModel
from frontend.sources.stills import read_image
from frontend.tracking.appearance import side_profiles
from frontend.tracking.assignment import assign
from frontend.tracking.extents import visible_parts
from frontend.tracking.overlap import LineFeatures, overlap_votes
from frontend.tracking.seen import runs_backwards

Gray8 = NDArray[np.uint8]
Array = NDArray[np.float64]
Geometry = Literal["none", "homography", "fundamental", "essential"]

MOST_POINTS, CONTRAST, RATIO = 2000, 0.01, 0.85  # of SIFT: points of an image; the faintest; Lowe's ratio
PLANE_ERROR, EPIPOLAR_ERROR = 2.0, 1.5  # px that a point may lie beside where the geometry wants it
LEAST_POINTS = 25  # that agree; two views of different things have up to 19
PLANAR = 0.9  # share of the points that agree with two views of anything, from which they are two views of a plane
NEAREST = 3  # points whose motion each end may have
# Wider than the tracker's limits, as no state predicts where a line is, but stricter about its looks
BAND, MAX_ANGLE, MIN_AGREEMENT, MIN_APPEARANCE, MIN_VOTE = 7.0, 20.0, 0.5, 0.3, 0.03


@dataclass(frozen=True)
class LineMatches:
    """The lines of two images and which are the same.

    Attributes:
        first: the N lines of the first image.
        second: the M lines of the second one; those of pairs are turned so that their end points correspond.
        pairs: (P, 2) int32 rows of the first and the second image's lines that are one line, each once at most.
        votes: (P,) float32 in [0, 1], how well each pair overlaps.
        geometry: "homography" where the points lie in a plane or the camera turned on the spot, otherwise "essential"
            with a camera and "fundamental" without; "none" where too few points agree.
        matrix: (3, 3) float64 for homogeneous columns x of the first and y of the second image: y ~ matrix x of a
            homography, y^T matrix x = 0 of the others. They are px, for "essential" on the plane z = 1.
        homography: (3, 3) float64 px, the one that most points agree with, whatever the geometry is; else the identity.
        inliers: how many of the points agree with it, and `points` how many there are.
        notes: what was guessed or left out, in sentences.
    """

    first: LineSet
    second: LineSet
    pairs: NDArray[np.int32]
    votes: NDArray[np.float32]
    geometry: Geometry
    matrix: Array
    homography: Array
    inliers: int
    points: int
    notes: tuple[str, ...] = ()


def match_lines(
    first: str | Path | ArrayLike,
    second: str | Path | ArrayLike,
    *,
    camera: CameraModel | None = None,
    detector: Callable[[ArrayLike], LineSet] | None = None,
) -> LineMatches:
    """Detect and pair the lines of two images.

    Args:
        first: an image file, or (H, W) grey or (H, W, 3) BGR, uint8.
        second: the other one; its size may differ.
        camera: that took both, in this or another resolution, for an essential matrix.
        detector: of lines, from an image; AirLine by default.

    Raises:
        InputError: an image cannot be read, or the camera is for images of another shape.
    """
    detector = detector or AirLine()
    sources = (read_image(Path(image)) if isinstance(image, str | Path) else image for image in (first, second))
    images = [to_uint8(to_gray(image)) for image in sources]
    cameras = None if camera is None else [fit_camera(camera, image.shape[1], image.shape[0]) for image in images]
    lines, others = (detector(image) for image in images)
    points = _alike(*images)
    geometry, matrix, homography, agree, notes = _geometry(points, cameras)
    votes, moved = _votes(images, lines, others, points[agree], homography)
    chosen = assign(votes, MIN_VOTE)
    rows = np.flatnonzero(chosen >= 0)
    pairs = np.column_stack([rows, chosen[rows]]).astype(np.int32)
    back = pairs[runs_backwards(moved[pairs[:, 0]], others.segments[pairs[:, 1]]), 1]
    segments = others.segments.copy()
    segments[back] = segments[back, ::-1]
    found = int(agree.sum()) if geometry != "none" else 0
    others = replace(others, segments=segments)
    return LineMatches(
        lines, others, pairs, votes[tuple(pairs.T)], geometry, matrix, homography, found, len(points), notes
    )


def _alike(first: Gray8, second: Gray8) -> Array:
    """(P, 2, 2) places, px, in both images of points that are each other's most similar (SIFT, Lowe 2004).

    Descriptors are compared by their roots (RootSIFT, Arandjelovic and Zisserman 2012).
    """
    sift = cv2.SIFT.create(MOST_POINTS, contrastThreshold=CONTRAST)
    (ours, described), (theirs, others) = (sift.detectAndCompute(image, None) for image in (first, second))
    if min(len(ours), len(theirs)) < 2:
        return np.zeros((0, 2, 2))
    described, others = (np.sqrt(rows / np.maximum(rows.sum(axis=1, keepdims=True), 1)) for rows in (described, others))
    matcher = cv2.BFMatcher()
    back = {match.queryIdx: match.trainIdx for match in matcher.match(others, described)}
    good = [
        (ours[best.queryIdx].pt, theirs[best.trainIdx].pt)
        for best, next_best in matcher.knnMatch(described, others, 2)
        if best.distance < RATIO * next_best.distance and back[best.trainIdx] == best.queryIdx
    ]
    return np.array(good, np.float64).reshape(-1, 2, 2)


def _geometry(
    points: Array, cameras: list[CameraModel] | None
) -> tuple[Geometry, Array, Array, NDArray[np.bool_], tuple[str, ...]]:
    """The geometry and its matrix, a homography for all, the mask of the points that agree, and notes."""
    nothing: tuple[Geometry, Array, Array] = ("none", np.eye(3), np.eye(3))
    everything = np.ones(len(points), np.bool_)
    try:
        with from_extra("poses"):
            import poselib
    except ConfigError as error:
        return *nothing, everything, (f"without geometry pairs are found in near views alone: {error}",)
    few = (
        f"no geometry: fewer than {LEAST_POINTS} of {len(points)} points agree, so pairs are found in near views alone"
    )
    if len(points) < LEAST_POINTS:
        return *nothing, everything, (few,)
    plane, found = poselib.estimate_homography(points[:, 0], points[:, 1], {"max_reproj_error": PLANE_ERROR})
    on_plane = np.array(found["inliers"], np.bool_)
    limit = {"max_epipolar_error": EPIPOLAR_ERROR}
    kind: Geometry = "fundamental" if cameras is None else "essential"
    agree = np.zeros(len(points), np.bool_)
    if cameras is None:
        matrix, found = poselib.estimate_fundamental(points[:, 0], points[:, 1], limit)
        agree[:] = found["inliers"]
    else:
        straight = [c.normalize(points[:, k]) * (c.fx, c.fy) + (c.cx, c.cy) for k, c in enumerate(cameras)]
        known = np.isfinite(straight).all(axis=(0, 2))  # a lens model may end within the image
        pinholes = [
            {"model": "PINHOLE", "width": c.width, "height": c.height, "params": [c.fx, c.fy, c.cx, c.cy]}
            for c in cameras
        ]
        pose, found = poselib.estimate_relative_pose(straight[0][known], straight[1][known], *pinholes, limit)
        agree[known] = found["inliers"]
        matrix = np.cross(pose.t, pose.R.T).T  # [t]x R
    if on_plane.sum() >= max(PLANAR * agree.sum(), LEAST_POINTS):
        return "homography", np.asarray(plane), np.asarray(plane), on_plane, ()
    if agree.sum() < LEAST_POINTS:
        return *nothing, everything, (few,)
    return kind, np.asarray(matrix), np.asarray(plane), agree, ()


def _votes(
    images: list[Gray8], lines: LineSet, others: LineSet, points: Array, homography: Array
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(N, M) mean votes of the hypotheses, and (N, 2, 2) the first of these: where the homography has the lines."""
    size = images[1].shape[1], images[1].shape[0]
    moved = warp(lines.segments, homography)
    depth = lines.segments @ homography[2, :2] + homography[2, 2]
    moved[(depth * np.sign(np.linalg.det(homography)) <= 0).any(axis=1)] = -1e6  # beyond the plane's horizon
    turn = _angles(moved) - _angles(lines.segments)
    carried = np.asarray(cv2.warpPerspective(images[0], homography, size), np.uint8)
    looks = _turned(lines.descriptors, turn), side_profiles(carried, moved.astype(np.float32))
    seen = LineFeatures(others.segments, others.descriptors, side_profiles(images[1], others.segments))
    limits = (np.full(len(lines), value, np.float32) for value in (BAND, MIN_APPEARANCE))
    bands, appearance = limits
    shifts = [np.zeros_like(moved)]
    if len(points):
        beyond = points[:, 1] - warp(points[:, 0], homography)
        away = np.linalg.norm(lines.segments[:, :, None] - points[:, 0], axis=3)
        near = beyond[np.argsort(away, axis=2, kind="stable")[:, :, :NEAREST]]
        count = range(near.shape[2])
        shifts += [np.stack([near[:, 0, i], near[:, 1, j]], axis=1) for i in count for j in count]
    total = np.zeros((len(lines), len(others)), np.float32)
    for shift in shifts:
        low, high, _ = visible_parts(moved + shift, size)
        start, delta = moved[:, :1] + shift[:, :1], np.diff(moved + shift, axis=1)
        there = (start + np.stack([low, high], axis=1)[:, :, None] * delta).astype(np.float32)
        limits_of_votes: dict[str, Any] = {"max_angle": np.deg2rad(MAX_ANGLE), "min_agreement": MIN_AGREEMENT}
        total += overlap_votes(LineFeatures(there, *looks), seen, bands, there, appearance, **limits_of_votes)
    return total / np.float32(len(shifts)), moved.astype(np.float32)


def _angles(segments: NDArray[np.floating]) -> Array:
    delta = np.float64(segments[:, 1]) - segments[:, 0]
    return np.asarray(np.arctan2(delta[:, 1], delta[:, 0]))


def _turned(descriptors: NDArray[np.float32], angles: Array) -> NDArray[np.float32]:
    """Descriptors of lines turned by (N,) radians: channels are directions, so they move on, in between linearly."""
    channels, rows = descriptors.shape[1], np.arange(len(descriptors))[:, None]
    place = np.arange(channels) - angles[:, None] * channels / np.pi
    low = np.floor(place).astype(np.int64)
    part = place - low
    turned = (1 - part) * descriptors[rows, low % channels] + part * descriptors[rows, (low + 1) % channels]
    return np.asarray(turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-9), np.float32)
