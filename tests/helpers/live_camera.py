"""A camera that waits for nobody, and an edge detector that is too slow for it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from airline import CannyEdges
from airline.image import Gray
from frontend import Frame, Source

PERIOD_S = 0.005


@cache
def pictures(count: int) -> list[NDArray[np.uint8]]:
    """A bright rectangle that moves."""
    images = [np.full((120, 160), 60, np.uint8) for _ in range(count)]
    for number, image in enumerate(images):
        cv2.rectangle(image, (20 + number % 40, 30), (90 + number % 40, 90), 200, -1)
    return images


class Camera(Source):
    """Frames that come whether or not somebody takes them; asked late, it has already lost some."""

    live = True

    def __init__(self, count: int, error: BaseException | None = None) -> None:
        self.name = "camera-7"
        self.given = 0
        self.closed = False
        self._count, self._error = count, error

    def __iter__(self) -> Iterator[Frame]:
        for number, image in enumerate(pictures(self._count)):
            time.sleep(PERIOD_S)
            self.given += 1
            yield Frame(number, round(1e9 * PERIOD_S * number), image)
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        self.closed = True


class SlowEdges(CannyEdges):
    """Six times slower than the camera."""

    def detect(self, gray: Gray) -> NDArray[np.float32]:
        time.sleep(6 * PERIOD_S)
        return super().detect(gray)
