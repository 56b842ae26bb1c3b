"""Video files for tests."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np


def write_video(path: Path, images: Iterable[np.ndarray], codec: str = "MJPG", fps: int = 30) -> Path:
    """A video of BGR images of one size."""
    first, *rest = images
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), fps, first.shape[1::-1])
    assert writer.isOpened()
    for image in (first, *rest):
        writer.write(image)
    writer.release()
    return path
