"""Which folder, file or topic is the right camera's, by what data sets call the two."""

from __future__ import annotations

import re
from pathlib import Path

from airline.errors import InputError

_NAMES = (  # of the left and of the right camera
    *(("cam0", "cam1"), ("cam_0", "cam_1"), ("camera0", "camera1"), ("camera_0", "camera_1")),
    *(("image_0", "image_1"), ("image_00", "image_01"), ("image_2", "image_3"), ("image_02", "image_03")),
    *(("image_l", "image_r"), ("images_l", "images_r"), ("infra1", "infra2"), ("left", "right")),
)


def partner_of(name: str) -> str | None:
    """What the right camera's is called where a name tells that it is the left one's; None where it does not."""
    for left, right in _NAMES:
        found, count = re.subn(rf"(?<![^\W_]){left}(?![^\W_])", right, name)
        if count:
            return found
    return "images_right" if name == "images" else None


def find_pair(spec: str) -> tuple[str, str]:
    """Left and right folder of a sequence (`cam0` and `cam1`, below `mav0` or not, `left` and `right`, ...), or a left
    folder or file and the right one beside it.

    Raises:
        InputError: there is no such pair.
    """
    root = Path(spec)
    for folder in (root, root / "mav0"):
        names = [child.name for child in folder.iterdir() if child.is_dir()] if folder.is_dir() else []
        for name in sorted(names, key=lambda name: (len(name), name)):  # depth_left comes late
            if (right := partner_of(name)) in names:
                return str(folder / name), str(folder / right)
    absolute = root.absolute()
    for left in (absolute, absolute.parent) if root.name == "data" else (absolute,):
        if (name_beside := partner_of(left.name)) is not None and (beside := left.with_name(name_beside)).exists():
            return spec if left == absolute else str(left), str(beside)
    raise InputError(f"'{spec}' shows no second camera by its names: give the right one's images with --right")
