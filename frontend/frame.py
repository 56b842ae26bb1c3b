"""One image of a stream."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from frontend.camera.model import CameraModel

if TYPE_CHECKING:
    from airline.image import Gray


@dataclass(frozen=True)
class Frame:
    """An image with its time.

    Attributes:
        index: position in the source from 0; skipped and unreadable frames keep their number.
        stamp_ns: sensor time in nanoseconds (for a video file: time since its first frame).
        image: (H, W) grey or (H, W, 3) BGR, uint8 or uint16.
        camera: the camera that took it, where known.
        right: of a stereo pair, the second camera's image, of the same size and with the same rows: what both see is
            in `image` at x and here at x - disparity; `camera.baseline_m` makes metres of it.
        name: of the image's file, relative to the folder that holds all of them; empty for other sources.
        read_s: `time.perf_counter()` when it had been read; latencies count from then.
    """

    index: int
    stamp_ns: int
    image: NDArray[np.uint8] | NDArray[np.uint16]
    camera: CameraModel | None = None
    right: NDArray[np.uint8] | NDArray[np.uint16] | None = field(default=None, kw_only=True)
    name: str = field(default="", kw_only=True)
    read_s: float = field(default_factory=time.perf_counter, kw_only=True, compare=False, repr=False)

    @cached_property
    def gray(self) -> Gray:
        """(H, W) luminance of the image, of its dtype; computed once, for detector and tracker.

        Raises:
            InputError: the image is none that `airline` takes.
        """
        from airline.image import to_gray  # brings OpenCV, which a reader of tracks need not load

        return to_gray(self.image)

    @cached_property
    def right_gray(self) -> Gray | None:
        """As `gray`, of the right image; None without one."""
        from airline.image import to_gray

        return None if self.right is None else to_gray(self.right)
