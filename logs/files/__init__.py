"""Log files by their kind."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from airline.errors import InputError

if TYPE_CHECKING:
    from logs.files.types import LogFile

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""What every MCAP file begins with."""

_SUFFIXES = (".mcap", ".bag", ".db3")
_MAGICS = {MCAP_MAGIC: ".mcap", b"#ROSBAG V": ".bag", b"SQLite format 3\0": ".db3"}
_METADATA_BYTES = 4096


def open_log(path: str | os.PathLike[str]) -> LogFile:
    """Open a log of any kind: MCAP, ROS 1 bag, ROS 2 bag folder or database. Its content decides, not its name.

    Raises:
        InputError: it cannot be read, or is no log.
    """
    log = Path(path)
    kind = _kind(log)
    if kind == ".mcap":
        from logs.files.mcap_file import McapFile

        return McapFile(log)
    if kind is None:
        raise InputError(
            f"'{log}' is no log: give an MCAP file, a ROS 1 .bag, or the folder or .db3 file of a ROS 2 bag"
        )
    from logs.files.bag_file import BagFile

    return BagFile(log)


def is_log(path: str | os.PathLike[str]) -> bool:
    """Whether a path looks like a log: by its suffix, or as a folder that a ROS 2 recorder has written."""
    log = Path(path)
    return log.suffix.lower() in _SUFFIXES or _is_bag_folder(log)


def _kind(log: Path) -> str | None:
    """The suffix that a log of its content has."""
    try:
        if log.is_dir():
            return "folder" if _is_bag_folder(log) else None
        with log.open("rb") as file:
            start = file.read(16)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot open the log '{log}': {error}") from error
    for magic, kind in _MAGICS.items():
        if start.startswith(magic):
            return kind
    return None


def _is_bag_folder(folder: Path) -> bool:
    """By its metadata; a recording that was killed has none, but files named as ROS 2 names them."""
    try:
        if (folder / "metadata.yaml").is_file():
            with (folder / "metadata.yaml").open("rb") as file:
                return b"rosbag2_bagfile_information" in file.read(_METADATA_BYTES)
        return folder.is_dir() and any(
            child.suffix in (".db3", ".mcap") and child.stem.rpartition("_")[2].isdigit() for child in folder.iterdir()
        )
    except (OSError, ValueError):  # no permission; a name that no file can have
        return False
