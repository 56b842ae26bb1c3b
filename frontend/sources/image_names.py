"""Which files are images, by their names: of a folder or a pattern, in natural order, and what to say where none is."""

from __future__ import annotations

import glob
import re
from collections import Counter
from pathlib import Path

from natsort import natsorted

from frontend.sources.kinds import LOG_SUFFIXES
from frontend.sources.streams import says_depth

IMAGE_SUFFIXES = frozenset(
    {".png", ".apng", ".jpg", ".jpeg", ".jpe", ".jfif", ".bmp", ".dib", ".tif", ".tiff", ".webp"}
    | {".pbm", ".pgm", ".ppm", ".pnm", ".gif", ".avif", ".heic", ".heif"}
)
VIDEO_SUFFIXES = frozenset({".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v", ".ts"})
_UNREAD = {".jp2", ".j2k", ".jxl", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".tga", ".raw"}
_PRINTF = re.compile(r"(?:%0?(\d*)d|#+)")


def is_image_name(text: str) -> bool:
    return Path(text).suffix.lower() in IMAGE_SUFFIXES


def _is_image(path: Path) -> bool:
    return is_image_name(path.name) and not path.name.startswith(".") and path.is_file()


def images_in(folder: Path) -> list[Path]:
    """The images of a folder by their suffix, in natural order."""
    return in_natural_order([path for path in folder.iterdir() if _is_image(path)])


def unread_in(folder: Path) -> list[str]:
    return natsorted(path.name for path in folder.iterdir() if path.suffix.lower() in _UNREAD)


def in_natural_order(images: list[Path]) -> list[Path]:
    return natsorted(images, key=lambda path: (str(path.parent), path.stem, path.suffix))


def matching(pattern: str) -> list[Path]:
    """The images that a glob pattern or one with a number (`%06d`, `####`) means."""
    files = [Path(name) for name in glob.glob(pattern, recursive=True)]  # noqa: PTH207
    if not files and _PRINTF.search(pattern):
        plain = _PRINTF.split(pattern)[::2]
        widths = [int(found[1] or 1) if found[1] is not None else len(found[0]) for found in _PRINTF.finditer(pattern)]
        digits = [*(rf"\d{{{width},}}" for width in widths), ""]
        expression = re.compile("".join(re.escape(text) + number for text, number in zip(plain, digits, strict=True)))
        names = glob.glob("*".join(map(glob.escape, plain)))  # noqa: PTH207
        files = [Path(name) for name in names if expression.fullmatch(name)]
    return in_natural_order([file for file in files if _is_image(file)])


def is_pattern(spec: str) -> bool:
    """Whether a text that names no file is a pattern for several."""
    return bool(glob.has_magic(spec) or _PRINTF.search(spec))


def nothing_like(root: Path) -> str:
    return f"no image matches '{root}'" if is_pattern(str(root)) else f"there is no folder or image '{root}'"


def image_folders(root: Path) -> list[str]:
    """Folders with images in a folder, in natural order, without those of depth where there are others."""
    inside = natsorted(child.name for child in root.iterdir() if child.is_dir() and images_in(child))
    return [name for name in inside if not says_depth(Path(name))] or inside


def nothing_in(root: Path) -> str:
    """Why a folder is none of images, and what to give."""
    children = list(root.iterdir())
    inside = image_folders(root)
    if inside:
        return f"'{root}' holds no image; its folder '{inside[0]}' has some: give that or another"
    for suffixes, what in ((LOG_SUFFIXES, "recordings"), (VIDEO_SUFFIXES, "videos")):
        found = natsorted(child.name for child in children if child.suffix.lower() in suffixes)
        if found:
            more = f", or all of them to python -m frontend.batch: '{root}/*{Path(found[0]).suffix}'"
            return f"'{root}' holds no image but {what}: name one, such as '{found[0]}'{more if found[1:] else ''}"
    others = Counter(child.suffix for child in children if child.suffix and child.is_file()).most_common(1)
    has = f" but files '{others[0][0]}'" if others else ""
    return f"'{root}' holds no image{has}: give a folder of images or a video file"


def some(names: list[str]) -> str:
    """Three of them, and how many more."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(f"'{name}'" for name in names[:3]) + more
