"""Which recordings are meant, how to tell that one has changed, and what its results are called."""

from __future__ import annotations

import glob
import hashlib
import os
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from natsort import natsorted

from airline.errors import InputError

_LONGEST = 150  # bytes; file systems allow 255, and an unfinished folder's name is longer


def find_recordings(patterns: Iterable[str | os.PathLike[str]], out: Path) -> list[Path]:
    """Absolute paths of the recordings that files, folders and globs name, each once, those of a glob in natural order.

    What lies in the folder `out` of the results, or holds it, is no recording.

    Raises:
        InputError: a pattern without a recording.
    """
    found: dict[Path, None] = {}
    results = out.resolve()
    for pattern in patterns:
        expanded = os.path.expanduser(os.fspath(pattern))  # noqa: PTH111  a quoted pattern comes with its ~
        matches = [expanded] if os.path.lexists(expanded) else natsorted(glob.glob(expanded, recursive=True))  # noqa: PTH207
        if not matches:
            raise InputError(f"there is no recording '{pattern}': give files, folders or globs of recordings")
        kept = [match for match in matches if not _overlap(Path(match).resolve(), results)]
        if not kept:
            raise InputError(f"'{pattern}' is where the results go: give another --out")
        found.update(dict.fromkeys(Path(os.path.abspath(match)) for match in kept))  # noqa: PTH100  keeps links
    return list(found)


def _overlap(path: Path, other: Path) -> bool:
    return path.is_relative_to(other) or other.is_relative_to(path)


def fingerprint(path: Path) -> dict[str, int]:
    """Size in bytes and time of the last change in ns of a file, or of all files in a folder; zeros for none."""
    files = [path]
    if path.is_dir():
        files = [Path(folder, name) for folder, _, names in os.walk(path) for name in names]
    stats = [file.stat() for file in files if file.exists()]  # a broken link: opening it will tell
    return {
        "bytes": sum(stat.st_size for stat in stats),
        "modified_ns": max((stat.st_mtime_ns for stat in stats), default=0),
    }


def unique_names(paths: Iterable[Path], taken: Iterable[str] = ()) -> dict[Path, str]:
    """A folder name for each recording: as short as is distinct, whatever their order.

    `a/x.mcap` becomes `x`; beside `b/x.mcap` it becomes `a-x`, beside `a/x.bag` it becomes `x.mcap`. Names differ by
    more than upper and lower case, also from those that are `taken`.
    """
    choices = {path: list(_choices(path)) for path in paths}
    claims = Counter(key for names in choices.values() for key in set(map(_key, names)))
    claims.update(2 * [*map(_key, taken)])
    return {
        path: next((name for name in names if claims[_key(name)] == 1), names[-1]) for path, names in choices.items()
    }


def _choices(path: Path) -> Iterator[str]:
    """From short to long; the last one belongs to this path alone."""
    stem = path.name if path.is_dir() else path.stem
    for name in dict.fromkeys((stem, path.name)):
        for depth in range(len(path.parts)):
            joined = "-".join((*path.parts[-1 - depth : -1], name))
            # no hidden folder, and only characters that can be printed and stored
            joined = joined.encode("utf-8", "replace").decode().replace("/", "").lstrip(".") or "recording"
            if len(joined.encode()) <= _LONGEST:
                yield joined
    yield f"recording-{hashlib.sha256(os.fsencode(path)).hexdigest()}"


def _key(name: str) -> str:
    """What two names have in common that some file system takes for one."""
    return unicodedata.normalize("NFC", name.casefold())
