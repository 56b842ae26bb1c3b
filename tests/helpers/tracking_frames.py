"""Frames of a textured plane that moves, lines with the descriptors of six line kernels, and edge maps of lines."""

from __future__ import annotations

import cv2
import numpy as np

from airline import LineSet
from frontend import Frame

MARGIN = 100  # px that the plane may move in either direction
EDGE = 0.8  # px, standard deviation of an edge map's ridges across themselves


def line_set(segments: np.ndarray) -> LineSet:
    """Lines with descriptors made of their angles."""
    segments = np.asarray(segments, np.float32).reshape(-1, 2, 2)
    delta = segments[:, 1] - segments[:, 0]
    angles = np.arctan2(delta[:, 1], delta[:, 0])[:, None] - np.arange(6) * np.pi / 6
    descriptors = np.cos(2 * angles).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    return LineSet(segments, np.ones(len(segments), np.float32), descriptors)


def texture(seed: int = 0, size: tuple[int, int] = (200, 160)) -> np.ndarray:
    """(H + 2 MARGIN, W + 2 MARGIN) uint8 soft noise."""
    noise = np.random.default_rng(seed).normal(0, 60, (size[1] + 2 * MARGIN, size[0] + 2 * MARGIN))
    return np.clip(128 + 4 * cv2.GaussianBlur(noise, (0, 0), 2), 0, 255).astype(np.uint8)


def frame(
    index: int, shift: int = 0, stamp_ns: int | None = None, size: tuple[int, int] = (200, 160), seed: int = 0
) -> Frame:
    """A frame of the plane, moved to the right by `shift` px; 30 frames per second unless a stamp is given."""
    left, plane = MARGIN - shift, texture(seed, size)
    image = np.ascontiguousarray(plane[MARGIN : MARGIN + size[1], left : left + size[0]])
    return Frame(index, index * 33_000_000 if stamp_ns is None else stamp_ns, image)


def drawn(index: int, segments: np.ndarray, size: tuple[int, int] = (200, 160)) -> Frame:
    """A frame of a resting plane of faint texture with lines on it."""
    image = np.ascontiguousarray(100 + (texture(0, size)[MARGIN:-MARGIN, MARGIN:-MARGIN] - 128.0) / 4)
    for start, end in np.rint(np.reshape(segments, (-1, 2, 2))).astype(int).tolist():
        cv2.line(image, start, end, 220, 2)
    return Frame(index, index * 33_000_000, image.astype(np.uint8))


def edge_map(segments: np.ndarray, size: tuple[int, int] = (200, 160), strength: float = 0.9) -> np.ndarray:
    """(H, W) float32 edge probability, as a network gives it: a ridge about two pixels wide along every segment."""
    y, x = np.mgrid[: size[1], : size[0]]
    edges = np.zeros(x.shape)
    for start, end in np.reshape(segments, (-1, 2, 2)):
        length = np.hypot(*(end - start))
        ux, uy = (end - start) / length
        along = np.clip((x - start[0]) * ux + (y - start[1]) * uy, 0, length)
        away = np.hypot(x - start[0] - along * ux, y - start[1] - along * uy)
        edges = np.maximum(edges, strength * np.exp(-0.5 * (away / EDGE) ** 2))
    return edges.astype(np.float32)
