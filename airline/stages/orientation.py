"""Stage 2: orientation descriptors of edge pixels."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.config import OrientationConfig
from airline.image import Gray, to_uint8
from airline.kernels.compiled import njit
from airline.kernels.threads import ALONE, ThreadTeam


class OrientationDetector(Protocol):
    """Describes which way the edge runs at each edge pixel."""

    def describe(self, edges: NDArray[np.float32], gray: Gray, pixels: NDArray[np.int32]) -> NDArray[np.float32]:
        """(M, C) float32 descriptors at (M, 2) int32 pixels (x, y), rows of unit length (zero where the map is empty).

        `edges` is the (H, W) float32 edge probability, `gray` the (H, W) image itself.
        """
        ...


def line_kernels(channels: int, size: int) -> NDArray[np.float32]:
    """(channels, size, size) kernels, each a line of `size` pixels through the centre at n * 180 / channels degrees.

    Angles turn from x (right) towards y (down).
    """
    kernels = np.zeros((channels, size, size), np.float32)
    steps = np.arange(size) - size // 2
    for n in range(channels):
        cos, sin = np.cos(n * np.pi / channels), np.sin(n * np.pi / channels)
        major = max(abs(cos), abs(sin))
        x, y = (np.rint(steps * component / major - 1e-9 * np.sign(steps)).astype(int) for component in (cos, sin))
        kernels[n, y + size // 2, x + size // 2] = 1
    return kernels


NOTHING = np.float32(1e-11)  # squared length of a descriptor that rounding errors make out
BLOCK = 256  # pixels that are described at a time


@dataclass(frozen=True)
class LineKernelOrientation:
    """Correlation of the edge map with line kernels, then L2 normalisation (equation 2 of the AirLine paper)."""

    config: OrientationConfig = field(default_factory=OrientationConfig)
    team: ThreadTeam = field(default=ALONE, repr=False, compare=False)

    @cached_property
    def _taps(self) -> NDArray[np.int32]:
        """(channels, kernel_size, 2) places (y, x) of each line's pixels from the centre, px."""
        channels, size = self.config.channels, self.config.kernel_size
        taps = np.argwhere(line_kernels(channels, size))[:, 1:] - size // 2
        return taps.reshape(channels, size, 2).astype(np.int32)

    def describe(self, edges: NDArray[np.float32], gray: Gray, pixels: NDArray[np.int32]) -> NDArray[np.float32]:
        """Descriptors at given pixels; the image itself is not looked at."""
        height, width = edges.shape
        taps, flat, subtract_mean = self._taps, edges.ravel(), self.config.subtract_mean
        offsets = tuple(tuple(line) for line in taps[:, :, 0] * width + taps[:, :, 1])
        described = np.empty((len(pixels), len(taps)), np.float32)

        def describe(start: int, end: int) -> None:
            _correlate(flat, height, width, pixels[start:end], taps, offsets, subtract_mean, described[start:end])

        self.team.map_range(len(pixels), 4 * BLOCK, describe)
        return described


@dataclass(frozen=True)
class GradientOrientation:
    """The unit image gradient (2 channels), for the paper's ablation."""

    def describe(self, edges: NDArray[np.float32], gray: Gray, pixels: NDArray[np.int32]) -> NDArray[np.float32]:
        """Descriptors at given pixels; the edge map is not looked at."""
        image = cv2.GaussianBlur(to_uint8(gray), (0, 0), 1.0)
        x, y = pixels[:, 0], pixels[:, 1]
        gradient = np.stack([cv2.Sobel(image, cv2.CV_32F, *order)[y, x] for order in ((1, 0), (0, 1))], axis=1)
        norm = np.linalg.norm(gradient, axis=1, keepdims=True)
        unit: NDArray[np.float32] = (gradient / np.maximum(norm, 1e-12)).astype(np.float32)
        return unit


@njit()
def _correlate(flat, height, width, pixels, taps, offsets, subtract_mean, out):  # type: ignore[no-untyped-def]
    """Set `out`, (M, N) float32 descriptors.

    Args:
        flat: (H * W,) float32 edge map.
        pixels: (M, 2) int32 (x, y).
        taps: (N, size, 2) int32 (y, x) from the pixel.
        offsets: the same as places in the flat map; tuples, since loops over those unroll.
    """
    work = np.empty((len(offsets) + 2) * BLOCK, np.float32)
    for start in range(0, len(pixels), BLOCK):
        count = min(BLOCK, len(pixels) - start)
        _sums(flat, height, width, pixels, start, count, taps, offsets, work)
        _scales(count, offsets, subtract_mean, work)
        for n in range(len(offsets)):
            for k in range(count):
                value = work[n * BLOCK + k] - work[len(offsets) * BLOCK + k]
                out[start + k, n] = value * work[(len(offsets) + 1) * BLOCK + k]


@njit()
def _sums(flat, height, width, pixels, start, count, taps, offsets, work):  # type: ignore[no-untyped-def]
    """Set the first N rows of BLOCK in `work` to the sums along each line; there is nothing beyond the border."""
    half = taps.shape[1] // 2
    for k in range(count):
        x, y = pixels[start + k, 0], pixels[start + k, 1]
        if half <= x < width - half and half <= y < height - half:
            place = y * width + x
            for n in range(len(offsets)):
                total = np.float32(0)
                for i in range(len(offsets[0])):
                    total += flat[np.uint64(place + offsets[n][i])]
                work[np.uint64(n * BLOCK + k)] = total
        else:
            for n in range(len(offsets)):
                total = np.float32(0)
                for i in range(taps.shape[1]):
                    row, column = y + taps[n, i, 0], x + taps[n, i, 1]
                    if 0 <= row < height and 0 <= column < width:
                        total += flat[row * width + column]
                work[np.uint64(n * BLOCK + k)] = total


@njit(fastmath={"contract"})
def _scales(count, offsets, subtract_mean, work):  # type: ignore[no-untyped-def]
    """Set the next two rows of `work` to what to subtract from each pixel's sums, and then to multiply by."""
    channels = len(offsets)
    share = np.float32(1 / channels) if subtract_mean else np.float32(0)
    for k in range(count):
        mean, squared = np.float32(0), np.float32(0)
        for n in range(len(offsets)):
            mean += work[n * BLOCK + k]
        mean *= share
        for n in range(len(offsets)):
            value = work[n * BLOCK + k] - mean
            squared += value * value
        work[channels * BLOCK + k] = mean
        work[(channels + 1) * BLOCK + k] = np.float32(1) / np.sqrt(squared) if squared > NOTHING else np.float32(0)
