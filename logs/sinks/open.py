"""Which sink the name of an output or an address stands for."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from airline.errors import InputError
from logs.live.address import parse_address
from logs.sinks.output import check_new

if TYPE_CHECKING:
    from frontend.protocols import Sink
    from logs.live.foxglove import FoxgloveServer
    from logs.live.zeromq import ZmqPublisher

KINDS = {  # what to give, and the module and class that write it
    "mcap": ("NAME.mcap (for Foxglove)", "logs.sinks.mcap_tracks", "McapTrackSink"),
    "parquet": ("NAME.parquet", "logs.sinks.parquet", "ParquetTrackSink"),
    "csv": ("NAME.csv", "logs.sinks.csv", "CsvTrackSink"),
    "plvins": ("plvins.mcap or plvins:NAME.mcap (for PL-VINS)", "logs.sinks.plvins", "PlVinsTrackSink"),
    "limap": ("limap/ or limap:FOLDER (for LIMAP)", "logs.sinks.limap", "LimapTrackSink"),
}


def kind_and_path(spec: str) -> tuple[str, Path]:
    """The kind of output that a name stands for, and where it goes.

    Args:
        spec: `KIND:PATH`; or a path, whose ending tells: `plvins.mcap`, other `.mcap`, `.parquet`, `.csv`, a folder
            named `limap` or written with a slash at its end.

    Raises:
        InputError: a name that stands for nothing.
    """
    prefix, colon, rest = spec.partition(":")
    if colon and prefix in KINDS and rest:
        return prefix, Path(rest)
    path = Path(spec)
    name = path.name.lower()
    if spec.endswith(("/", os.sep)) or name == "limap":
        return "limap", path
    if name.endswith("plvins.mcap"):
        return "plvins", path
    if path.suffix.lower() in (".mcap", ".parquet", ".csv"):
        return path.suffix.lower()[1:], path
    raise InputError(f"cannot tell what to write into '{spec}': give {', '.join(name for name, *_ in KINDS.values())}")


def check(spec: str, overwrite: bool = False) -> None:
    """Refuse, before any work, an output that exists or that cannot be made; raises InputError."""
    kind, path = kind_and_path(spec)
    if kind == "limap":
        from logs.sinks.limap import check_folder

        check_folder(path, overwrite)
    elif kind == "parquet":
        from logs.sinks.parquet import check_table

        check_table(path, overwrite)
    else:
        check_new(path, overwrite)


def open_track_sink(spec: str, *, overwrite: bool = False, with_images: bool = False, labels: bool = False) -> Sink:
    """Open an output for tracked lines.

    Args:
        spec: see `kind_and_path`.
        overwrite: replace what is there, which is an InputError otherwise.
        with_images, labels: write the images, and ids beside the lines, where the format can (MCAP for Foxglove).
    """
    kind, path = kind_and_path(spec)
    _, module, sink = KINDS[kind]
    options = {"with_images": with_images, "labels": labels} if kind == "mcap" else {}
    opened: Sink = getattr(import_module(module), sink)(path, overwrite=overwrite, **options)
    return opened


def open_publisher(address: str, name: str, *, labels: bool = False) -> ZmqPublisher | FoxgloveServer:
    """Bind an address for tracked lines.

    Args:
        address: see `parse_address`.
        name: of the input.
        labels: write ids beside the lines, where a viewer is served.

    Raises:
        ConfigError: no address, or the extra that serves it is not installed.
        InputError: the address is taken, or cannot be had.
    """
    parsed = parse_address(address)
    if parsed.scheme == "ws":
        from logs.live.foxglove import FoxgloveServer

        return FoxgloveServer(parsed, name, labels=labels)
    from logs.live.zeromq import ZmqPublisher

    return ZmqPublisher(parsed, name)
