"""Frames of a folder of images."""

from __future__ import annotations

import logging
import os
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from airline.errors import InputError
from frontend.camera.calibration import fit_camera
from frontend.camera.layouts import find_calibration
from frontend.camera.model import CameraModel
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.listing import folder_of, list_images
from frontend.sources.reading import Image, Skips, decode_image

log = logging.getLogger(__name__)


class FolderSource(Source):
    """Images of a folder in natural order (2.png before 10.png), or of a EuRoC, TUM RGB-D or KITTI sequence.

    Images that are missing or cannot be read are skipped and keep their number. Grey and 16-bit images stay so.

    Args:
        path: a folder, a glob pattern, or one image.
        fps: frames per second where no layout gives times.
        calibrated: take the calibration file that lies with the images, where data sets have theirs: frames carry its
            camera, and `calibration` names it from the first that has it on. One that makes no sense costs a warning;
            so does the first image that it does not fit, and such images have no camera.
        autorotate: turn images upright as their EXIF data say.

    Raises:
        InputError: there is no such folder, no image in it, or its times cannot be read; while iterating, when not
            one image can be read.
    """

    name: str
    calibration: str | None = None
    frame_count: int
    first_stamp_ns: int

    def __init__(
        self, path: str | os.PathLike[str], fps: float = 30.0, *, calibrated: bool = True, autorotate: bool = True
    ) -> None:
        self._rows = list_images(path, fps)
        folder = Path(path) if os.path.isdir(path) else self._rows[0].path.parent  # noqa: PTH112
        self.name = Path(path).stem if os.path.isfile(path) else folder.resolve().name or "images"  # noqa: PTH113
        self._folder = os.path.commonpath([row.path.parent for row in self._rows])
        self.frame_count = len(self._rows)
        self.first_stamp_ns = self._rows[0].stamp_ns
        self._skips = Skips(self.name)
        place = folder_of(self._rows)
        self._found = find_calibration(place) if calibrated and place else None
        self._misfit = False
        self._autorotate = autorotate

    @property
    def skipped(self) -> int:
        return self._skips.count

    def seek(self, start_s: float) -> None:
        start_ns = self.first_stamp_ns + round(start_s * 1e9)
        self.frame_count = len(self._rows) - bisect_left(self._rows, start_ns, key=lambda row: row.stamp_ns)

    def __iter__(self) -> Iterator[Frame]:
        found = False
        try:
            for index in range(len(self._rows) - self.frame_count, len(self._rows)):
                row = self._rows[index]
                try:
                    image = decode_image(row.path.read_bytes()) if row.path.is_file() else None
                except (OSError, ValueError):  # no permission; a name that no file can have
                    image = None
                if image is None:
                    self._skips.add(str(row.path))
                    continue
                found = True
                name = row.path.relative_to(self._folder).as_posix()
                yield Frame(index, row.stamp_ns, image, self._camera(image, name), name=name)
        finally:
            self._skips.report(log)
        if self._skips.count and not found:
            raise InputError(f"not one image of '{self.name}' can be read; the first is '{self._skips.first}'")

    def _camera(self, image: Image, name: str) -> CameraModel | None:
        if self._found is None:
            return None
        height, width = image.shape[:2]
        try:
            camera = fit_camera(self._found.camera, width, height)
        except InputError as error:
            if not self._misfit:
                log.warning("going on without '%s' at '%s' and the like: %s", self._found.file, name, error)
            self._misfit = True
            return None
        if camera is not self._found.camera:
            self._found = replace(self._found, camera=camera)
        self.calibration = self.calibration or str(self._found)
        return camera
