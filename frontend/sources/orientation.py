"""Pictures turned upright, by the eight orientations of EXIF."""

from __future__ import annotations

from typing import Any, cast

import cv2

from frontend.sources.reading import Image

_FLIPS = {2: 1, 3: -1, 4: 0, 6: 1, 7: -1, 8: 0}  # from 5 on after rows and columns are exchanged
_WORDS = {
    2: "mirrored",
    3: "turned by 180 degrees",
    4: "mirrored upside down",
    5: "mirrored and turned by 90 degrees counterclockwise",
    6: "turned by 90 degrees clockwise",
    7: "mirrored and turned by 90 degrees clockwise",
    8: "turned by 90 degrees counterclockwise",
}
_INVERSE = {6: 8, 8: 6}  # the others undo themselves


def upright(image: Image, exif: int) -> Image:
    """The image as its EXIF orientation, 1 to 8, wants it shown; C-contiguous."""
    turned: Any = cv2.transpose(image) if exif >= 5 else image
    return cast("Image", cv2.flip(turned, _FLIPS[exif]) if exif in _FLIPS else turned)


def turned(image: Image, exif: int, autorotate: bool, *, already: bool) -> Image:
    """A picture upright, or, without `autorotate`, as stored; a decoder may have turned it already."""
    if already == autorotate:
        return image
    return upright(image, _INVERSE.get(exif, exif) if already else exif)


class Turns:
    """What a source says of how its pictures were turned: `words` for `Source.orientation`, and notes."""

    def __init__(self, notes: list[str], autorotate: bool) -> None:
        self.words = "as stored"
        self._notes, self._autorotate = notes, autorotate
        self._first: int | None = None
        self._differ = False

    def add(self, exif: int) -> None:
        """Take the next picture's orientation."""
        done = "as stored" if exif == 1 else f"{_WORDS[exif]} (EXIF {exif})"
        words = done if self._autorotate or exif == 1 else f"as stored, not {done}"
        if self._first is None:
            self._first, self.words = exif, words
            if exif != 1 and self._autorotate:
                self._notes.append(f"images are {words}, as their files say: --no-autorotate leaves them as stored")
        elif exif != self._first and not self._differ:
            self._differ = True
            self._notes.append(f"images are not all turned alike: the first are {self.words}, others {words}")
