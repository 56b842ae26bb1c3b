"""Frames of a folder of images."""

from __future__ import annotations

import logging
import os
from bisect import bisect_left
from collections.abc import Iterator
from pathlib import Path

from airline.errors import InputError
from frontend.frame import Frame
from frontend.sources.layouts import list_images
from frontend.sources.opencv import Image, decode_image
from frontend.sources.skips import Skips

log = logging.getLogger(__name__)


class FolderSource:
    """Images of a folder in natural order (2.png before 10.png), or of a EuRoC, TUM RGB-D or KITTI sequence.

    Images that are missing or cannot be read are skipped and keep their number. Grey and 16-bit images stay so.

    Args:
        path: a folder, a glob pattern, or one image; see `frontend.sources.layouts` for the layouts with times.
        fps: frames per second where no layout gives times.

    Raises:
        InputError: there is no such folder, no image in it, or its times cannot be read; while iterating, when not
            one image can be read.
    """

    def __init__(self, path: str | os.PathLike[str], fps: float = 30.0) -> None:
        self._rows = list_images(path, fps)
        self._name = _name(Path(path), self._rows[0].path)
        self._skips = Skips(self._name)
        self._start = 0

    @property
    def name(self) -> str:
        return self._name

    @property
    def frame_count(self) -> int | None:
        return len(self._rows) - self._start

    @property
    def skipped(self) -> int:
        return self._skips.count

    @property
    def first_stamp_ns(self) -> int:
        """Stamp of the first image, from which `seek` counts."""
        return self._rows[0].stamp_ns

    def seek(self, start_s: float) -> None:
        """Begin iteration with the first image at or after start_s seconds."""
        start_ns = self.first_stamp_ns + round(start_s * 1e9)
        self._start = bisect_left(self._rows, start_ns, key=lambda row: row.stamp_ns)

    def __iter__(self) -> Iterator[Frame]:
        found = False
        try:
            for index in range(self._start, len(self._rows)):
                row = self._rows[index]
                image = _read(row.path)
                if image is None:
                    self._skips.add(str(row.path))
                    continue
                found = True
                yield Frame(index, row.stamp_ns, image)
        finally:
            self._skips.report(log)
        if self._skips.count and not found:
            raise InputError(f"not one image of '{self._name}' can be read; the first is '{self._skips.first}'")

    def close(self) -> None:
        """Nothing stays open."""


def _name(path: Path, first_image: Path) -> str:
    if path.is_file():
        return path.stem
    return (path if path.is_dir() else first_image.parent).resolve().name or "images"


def _read(path: Path) -> Image | None:
    try:
        return decode_image(path.read_bytes()) if path.is_file() else None
    except (OSError, ValueError):  # no permission; a name that no file can have
        return None
