"""Names of the folders that results go into."""

from __future__ import annotations

import hashlib
import os
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

_LONGEST = 150  # bytes; file systems allow 255, and an unfinished folder's name is longer


def unique_names(paths: Iterable[Path], taken: Iterable[str] = ()) -> dict[Path, str]:
    """A folder name for each recording: as short as is distinct, whatever their order.

    `a/x.mcap` becomes `x`; beside `b/x.mcap` it becomes `a-x`, beside `a/x.bag` it becomes `x.mcap`. Names differ by
    more than upper and lower case.

    Args:
        paths: distinct absolute paths.
        taken: names that are in use.
    """
    choices = {path: list(_choices(path)) for path in paths}
    claims = Counter(key for names in choices.values() for key in set(map(_key, names)))
    in_use = set(map(_key, taken))
    return {
        path: next((name for name in names if claims[_key(name)] == 1 and _key(name) not in in_use), names[-1])
        for path, names in choices.items()
    }


def _choices(path: Path) -> Iterator[str]:
    """From short to long; the last one belongs to this path alone."""
    stem = path.name if path.is_dir() else path.stem
    for name in dict.fromkeys((stem, path.name)):
        for depth in range(len(path.parts)):
            joined = _clean("-".join((*path.parts[-1 - depth : -1], name)))
            if len(joined.encode()) <= _LONGEST:
                yield joined
    yield f"recording-{hashlib.sha256(os.fsencode(path)).hexdigest()}"


def _clean(name: str) -> str:
    """No hidden folder, and only characters that can be printed and stored."""
    shown = name.encode("utf-8", "replace").decode().replace("/", "").lstrip(".")
    return shown or "recording"


def _key(name: str) -> str:
    """What two names have in common that some file system takes for one."""
    return unicodedata.normalize("NFC", name.casefold())
