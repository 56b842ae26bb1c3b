"""Pictures turned upright, by the eight orientations of EXIF."""

from __future__ import annotations

from typing import Any, cast

import cv2

from frontend.sources.reading import Image

_ROTATIONS = {3: cv2.ROTATE_180, 6: cv2.ROTATE_90_CLOCKWISE, 8: cv2.ROTATE_90_COUNTERCLOCKWISE}
_WORDS = {
    2: "mirrored",
    3: "turned by 180 degrees",
    4: "mirrored upside down",
    5: "mirrored and turned by 90 degrees counterclockwise",
    6: "turned by 90 degrees clockwise",
    7: "mirrored and turned by 90 degrees clockwise",
    8: "turned by 90 degrees counterclockwise",
}
INVERSE = {6: 8, 8: 6}  # the others undo themselves


def upright(image: Image, exif: int) -> Image:
    """The image as its EXIF orientation, 1 to 8, wants it shown; C-contiguous."""
    turned: Any = image
    if exif in (2, 4):
        turned = cv2.flip(image, 1 if exif == 2 else 0)
    elif exif in (5, 7):
        turned = cv2.transpose(image)
        turned = turned if exif == 5 else cv2.rotate(turned, cv2.ROTATE_180)
    elif exif in _ROTATIONS:
        turned = cv2.rotate(image, _ROTATIONS[exif])
    return cast("Image", turned)


def in_words(exif: int, *, autorotate: bool = True) -> str:
    """For `Source.orientation`."""
    if exif == 1:
        return "as stored"
    done = f"{_WORDS[exif]} (EXIF {exif})"
    return done if autorotate else f"as stored, not {done}"
