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
from frontend.sources.listing import ImageRow, folder_of, list_images
from frontend.sources.orientation import Turns
from frontend.sources.pages import open_pages
from frontend.sources.reading import Image, Skips, UndecodableError
from frontend.sources.stills import Header, read_still
from frontend.sources.streams import says_depth

log = logging.getLogger(__name__)


class FolderSource(Source):
    """Images of a folder in natural order (2.png before 10.png), or in that of the times that `listing` finds for them.

    Images that are missing or cannot be read are skipped and keep their number. Grey and 16-bit images stay so. Of a
    file with several pictures (TIFF pages, animations) all are frames if it is given alone, else the first.

    Args:
        path: a folder, a glob pattern or one like `%06d.png`, or one image.
        fps: frames per second where nothing gives times.
        calibrated: take the calibration file that lies with the images, where data sets have theirs: frames carry its
            camera, and `calibration` names it from the first that has it on. One that makes no sense costs a warning;
            so does the first image that it does not fit, and such images have no camera.
        autorotate: turn images upright as their EXIF data say.

    Raises:
        InputError: there is no such folder, no image in it, or its times cannot be read; while iterating, when not
            one image can be read, or they are of depth.
    """

    name: str
    kind: str
    notes: list[str]
    codec: str = ""
    calibration: str | None = None
    frame_count: int
    first_stamp_ns: int
    last_stamp_ns: int

    def __init__(
        self, path: str | os.PathLike[str], fps: float = 30.0, *, calibrated: bool = True, autorotate: bool = True
    ) -> None:
        listing = list_images(path, fps)
        self._rows = listing.rows
        self.kind = listing.kind
        self.notes = list(listing.notes)
        folder = Path(path) if os.path.isdir(path) else self._rows[0].path.parent  # noqa: PTH112
        self.name = Path(path).stem if os.path.isfile(path) else folder.resolve().name or "images"  # noqa: PTH113
        self._folder = os.path.commonpath([row.path.parent for row in self._rows])
        self._pages = open_pages(self._rows[0].path, fps) if listing.kind == "one image" else None
        if self._pages is not None:
            self._rows = [ImageRow(self._rows[0].path, stamp) for stamp in self._pages.stamps_ns]
            self.kind = self._pages.kind
            self.notes += self._pages.notes
        self.frame_count = len(self._rows)
        self.first_stamp_ns, self.last_stamp_ns = self._rows[0].stamp_ns, self._rows[-1].stamp_ns
        self._skips = Skips(self.name)
        place = folder_of(self._rows)
        self._found = find_calibration(place) if calibrated and place else None
        self._misfit = False
        self._autorotate = autorotate
        self._turns = Turns(self.notes, autorotate)
        self._several = 0  # files of which only the first picture is taken

    @property
    def orientation(self) -> str:
        return self._turns.words

    @property
    def skipped(self) -> int:
        return self._skips.count

    def seek(self, start_s: float) -> None:
        start_ns = self.first_stamp_ns + round(start_s * 1e9)
        self.frame_count = len(self._rows) - bisect_left(self._rows, start_ns, key=lambda row: row.stamp_ns)

    def __iter__(self) -> Iterator[Frame]:
        found, why = False, ""
        try:
            for index in range(len(self._rows) - self.frame_count, len(self._rows)):
                row = self._rows[index]
                try:
                    image, header = self._read(index)
                except UndecodableError as error:
                    self._skips.add(str(row.path), reason=error.reason)
                    why = why or str(error)
                    continue
                except (OSError, ValueError) as error:  # missing, no permission; a name that no file can have
                    self._skips.add(str(row.path), reason=getattr(error, "strerror", None) or "no such file")
                    continue
                self._look_at(row, image, header, first=not found)
                found = True
                name = row.path.relative_to(self._folder).as_posix() + (f"[{index}]" if self._pages else "")
                yield Frame(index, row.stamp_ns, image, self._camera(image, name), name=name)
        finally:
            self._skips.report(log)
        if self._skips.count and not found:
            reason = f", {why}" if why else ""
            raise InputError(f"not one image of '{self.name}' can be read; the first is '{self._skips.first}'{reason}")

    def _read(self, index: int) -> tuple[Image, Header]:
        if self._pages is not None:
            return self._pages.read(index, autorotate=self._autorotate), self._pages.header
        return read_still(self._rows[index].path.read_bytes(), self._autorotate)

    def _look_at(self, row: ImageRow, image: Image, header: Header, *, first: bool) -> None:
        """Refuse depth, and note what was done to an image."""
        self._turns.add(header.exif)
        if first:
            if image.ndim == 2 and says_depth(row.path):
                raise InputError(
                    f"'{row.path}' holds depth by its name, which is measured, not seen, and shows no lines: "
                    "give the folder of the camera's images"
                )
            if image.ndim == 2 and image.itemsize == 2:
                self.notes.append("grey of 16 bits is taken for what a camera sees, such as heat, not for depth")
            self.codec = header.codec
        if header.pictures > 1 and self._pages is None:
            self._several += 1
            note = f"files with several pictures, of which the first is taken: {self._several}; give one file for all"
            if self._several > 1:
                self.notes.remove(note.replace(f"{self._several};", f"{self._several - 1};"))
            self.notes.append(note)

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
