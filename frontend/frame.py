"""One image of a stream."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airline.image import Gray, to_gray
from frontend.camera import CameraModel


@dataclass(frozen=True)
class Frame:
    """An image with its time.

    Attributes:
        index: position in the source from 0; skipped and unreadable frames keep their number.
        stamp_ns: sensor time in nanoseconds (for a video file: time since its first frame).
        image: (H, W) grey or (H, W, 3) BGR, uint8 or uint16.
        camera: the camera that took it, where known.
    """

    index: int
    stamp_ns: int
    image: NDArray[np.uint8] | NDArray[np.uint16]
    camera: CameraModel | None = None

    @cached_property
    def gray(self) -> Gray:
        """(H, W) luminance of the image, of its dtype; computed once, for detector and tracker.

        Raises:
            InputError: the image is none that `airline` takes.
        """
        return to_gray(self.image)
