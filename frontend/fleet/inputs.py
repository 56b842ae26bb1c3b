"""Which recordings are meant, and how to tell that one has changed."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from natsort import natsorted

from airline.errors import InputError


def find_recordings(patterns: Iterable[str | os.PathLike[str]], out: Path) -> list[Path]:
    """Absolute paths of all recordings, each once; those of one pattern in natural order.

    Args:
        patterns: files, folders or globs, in which `**` stands for folders of any depth.
        out: where results go; what lies in it, or holds it, is no recording.

    Raises:
        InputError: a pattern without a recording.
    """
    found: dict[Path, None] = {}
    for pattern in patterns:
        expanded = os.path.expanduser(os.fspath(pattern))  # noqa: PTH111  a quoted pattern comes with its ~
        matches = [expanded] if os.path.lexists(expanded) else natsorted(glob.glob(expanded, recursive=True))  # noqa: PTH207
        if not matches:
            raise InputError(f"there is no recording '{pattern}': give files, folders or globs of recordings")
        kept = [match for match in matches if not _overlaps(Path(match), out)]
        if not kept:
            raise InputError(f"'{pattern}' is where the results go: give another --out")
        found.update(dict.fromkeys(Path(os.path.abspath(match)) for match in kept))  # noqa: PTH100  keeps links
    return list(found)


def fingerprint(path: Path) -> dict[str, int]:
    """Size in bytes and time of the last change in ns of a file, or of all files in a folder; zeros for none."""
    files = [stat for file in _files(path) if (stat := _stat(file)) is not None]
    return {
        "bytes": sum(stat.st_size for stat in files),
        "modified_ns": max((stat.st_mtime_ns for stat in files), default=0),
    }


def _overlaps(path: Path, out: Path) -> bool:
    path, out = path.resolve(), out.resolve()
    return path == out or out in path.parents or path in out.parents


def _files(path: Path) -> Iterator[Path]:
    if not path.is_dir():
        yield path
        return
    for folder, _, names in os.walk(path):
        yield from (Path(folder, name) for name in names)


def _stat(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except OSError:  # a broken link: opening it will tell
        return None
