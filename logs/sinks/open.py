"""Which sink the name of an output or an address stands for."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from airline.errors import ConfigError, InputError
from logs.sinks.output import check_csv, check_folder, check_new, check_table, journal_of, tables_of

if TYPE_CHECKING:
    from frontend.protocols import Sink
    from logs.sinks.foxglove import FoxgloveServer
    from logs.sinks.zeromq import ZmqPublisher

KINDS = {  # what to give, the module and class that write it, and what refuses a place
    "mcap": ("NAME.mcap (for Foxglove)", "foxglove", "McapTrackSink", check_new),
    "parquet": ("NAME.parquet", "tables", "ParquetTrackSink", check_table),
    "csv": ("NAME.csv", "tables", "CsvTrackSink", check_csv),
    "bag": ("NAME.bag (for PL-VINS, in ROS 1)", "plvins", "VinsSink", check_new),
    "plvins": ("plvins.mcap or plvins:NAME.mcap (the same in MCAP)", "plvins", "VinsSink", check_new),
    "eplf": ("eplf.bag or eplf.mcap (for EPLF-VINS)", "plvins", "VinsSink", check_new),
    "uvslam": ("uvslam.bag or uvslam.mcap (for UV-SLAM)", "plvins", "VinsSink", check_new),
    "limap": ("limap/ or limap:FOLDER (for LIMAP)", "limap", "LimapTrackSink", check_folder),
}
VINS = ("plvins", "eplf", "uvslam")


def kind_and_path(spec: str) -> tuple[str, Path]:
    """The kind of output that a name stands for, and where it goes.

    Args:
        spec: `KIND:PATH`; or a path, whose ending tells: `plvins`, `eplf` or `uvslam` and `.bag` or `.mcap`, other
            `.mcap`, `.parquet`, `.csv`, `.bag`, a folder named `limap` or written with a slash at its end.

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
    stem, _, kind = name.rpartition(".")
    for system in VINS:
        if kind in ("bag", "mcap") and stem.endswith(system):
            return system, path
    if kind in KINDS.keys() - {*VINS, "limap"}:
        return kind, path
    raise InputError(f"cannot tell what to write into '{spec}': give {', '.join(name for name, *_ in KINDS.values())}")


def guess_of(spec: str) -> str | None:
    """A sentence on an output that is for one of PL-VINS's kin by the end of its name alone; None for others."""
    from logs.sinks.clouds import SYSTEMS

    kind, path = kind_and_path(spec)
    if kind not in VINS or spec.startswith(f"{kind}:") or path.stem.lower() == kind:
        return None
    other = path.suffix.lower()[1:]
    reader = "Foxglove" if other == "mcap" else SYSTEMS["plvins"].name
    if SYSTEMS[kind].name == reader:
        return None
    return f"{path} is for {SYSTEMS[kind].name}, as its name ends with '{kind}': give {other}:{path} for {reader}"


def files_of(spec: str) -> list[Path]:
    """What an output writes: the file or folder that it is named after, and what lies beside it."""
    kind, path = kind_and_path(spec)
    return [path, *(tables_of(path) if kind == "csv" else [journal_of(path)] if kind == "parquet" else [])]


def check(spec: str, overwrite: bool = False, points: bool = False) -> None:
    """Refuse, before any work, an output that exists, cannot be made, or needs points; raises AirLineError."""
    from logs.sinks.clouds import check_points

    kind, path = kind_and_path(spec)
    if kind in VINS:
        check_points(kind, points)
    *_, refuse = KINDS[kind]
    refuse(path, overwrite)


def open_track_sink(
    spec: str,
    *,
    overwrite: bool = False,
    with_images: bool = False,
    labels: bool = False,
    stride: int = 1,
    points: bool = False,
) -> Sink:
    """Open an output for tracked lines; raises InputError where `check` does, and ConfigError without points for it.

    Args:
        spec: see `kind_and_path`.
        overwrite: replace what is there.
        with_images, labels: write the images, and ids beside the lines, where the format can (MCAP for Foxglove).
        stride: the frames will be every stride-th of the recording, which PL-VINS's formats have to know.
        points: the tracks will have points, which PL-VINS and its kin can take, too.
    """
    kind, path = kind_and_path(spec)
    _, module, sink, _ = KINDS[kind]
    options: dict[str, Any] = {"with_images": with_images, "labels": labels} if kind == "mcap" else {}
    if module == "plvins":
        system, bag = ("plvins", True) if kind == "bag" else (kind, path.suffix.lower() == ".bag")
        options = {"system": system, "bag": bag, "stride": stride, "points": points}
    opened: Sink = getattr(import_module(f"logs.sinks.{module}"), sink)(path, overwrite=overwrite, **options)
    return opened


@dataclass(frozen=True)
class Address:
    """Where something listens.

    Attributes:
        scheme: "tcp" or "ipc" for ZeroMQ, "ws" for Foxglove.
        host: the machine's name or number, "*" for all of its networks; empty for "ipc".
        port: 0 for any that is free.
        path: of the socket's file, for "ipc".
    """

    scheme: str
    host: str = ""
    port: int = 0
    path: str = ""

    def __str__(self) -> str:
        if self.scheme == "ipc":
            return f"ipc://{self.path}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def parse_address(text: str) -> Address:
    """The address of a line stream: `tcp://[HOST]:PORT`, `ws://[HOST]:PORT` or `ipc://PATH`; this machine by default.

    Raises:
        ConfigError: a text that is no such address.
    """
    scheme, separator, rest = text.partition("://")
    if separator and scheme == "ipc" and rest and rest.isprintable():
        return Address(scheme, path=rest)
    if separator and scheme in ("tcp", "ws"):
        with suppress(ValueError):  # a port that is none
            parts = urlsplit(text)
            if parts.port is not None and "@" not in parts.netloc and not (parts.path or parts.query or parts.fragment):
                return Address(scheme, parts.hostname or "127.0.0.1", parts.port)
    raise ConfigError(
        f"'{text}' is no address of a line stream: give tcp://127.0.0.1:5555, ipc:///tmp/lines (ZeroMQ) or "
        "ws://127.0.0.1:8765 (Foxglove)"
    )


def cannot_publish(address: Address, reason: str) -> InputError:
    """The error for an address that cannot be bound."""
    return InputError(f"cannot publish at {address} ({reason}): choose another address")


def open_publisher(address: str, name: str, *, labels: bool = False, stride: int = 1) -> ZmqPublisher | FoxgloveServer:
    """Bind an address, see `parse_address`, for tracked lines of every stride-th frame; viewers also get ids as labels.

    Raises:
        ConfigError: no address, or the extra that serves it is not installed.
        InputError: the address is taken, or cannot be had.
    """
    parsed = parse_address(address)
    if parsed.scheme == "ws":
        from logs.sinks.foxglove import FoxgloveServer

        return FoxgloveServer(parsed, name, labels=labels)
    from logs.sinks.zeromq import ZmqPublisher

    return ZmqPublisher(parsed, name, stride)
