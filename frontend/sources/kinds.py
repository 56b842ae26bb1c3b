"""What an input is, by what kind of file it is and by its first bytes; its name only decides where these do not."""

from __future__ import annotations

import bz2
import lzma
import os
import re
import shlex
import stat
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Literal, NamedTuple
from urllib.parse import unquote

from airline.errors import InputError
from frontend.sources.motion_jpeg import JPEG, is_motion_jpeg

Kind = Literal["missing", "folder", "camera", "device", "pipe", "log", "image", "packed", "video", "unknown"]

STDIN = "/dev/stdin"
LOG_SUFFIXES = frozenset({".mcap", ".bag", ".db3"})
_START = 512  # bytes that are looked at
_MOST = 1 << 26  # bytes of a JPEG that are looked at for what is behind it
_VIDEO4LINUX = 81  # the major number of its devices
_CAMERAS = re.compile(r"/dev/(video\d+|v4l/.+)")
_LOGS = {b"\x89MCAP0\r\n": "an MCAP log", b"#ROSBAG V": "a ROS 1 bag", b"SQLite format 3\0": "a ROS 2 bag"}
_FILE_URL = re.compile(r"file:(?://[^/]*)?(/.*)", re.IGNORECASE | re.DOTALL)
_STILLS = (JPEG, b"\x89PNG\r\n\x1a\n", b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"GIF8")
_STILL_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"mif1", b"msf1", b"hevc", b"hevx", b"avif", b"avis")
_MOTION_JPEG = frozenset({".mjpg", ".mjpeg"})  # one JPEG after the other


class _Packing(NamedTuple):
    name: str
    suffixes: tuple[str, ...]
    command: str


_PACKINGS = {
    b"\x1f\x8b": _Packing("gzip", (".gz", ".gzip"), "gunzip -c {file} > {out}"),
    b"\x28\xb5\x2f\xfd": _Packing("zstd", (".zst", ".zstd"), "zstd -d {file} -o {out}"),
    b"BZh": _Packing("bzip2", (".bz2",), "bunzip2 -c {file} > {out}"),
    b"\xfd7zXZ\0": _Packing("xz", (".xz",), "xz -dc {file} > {out}"),
    b"\x04\x22\x4d\x18": _Packing("lz4", (".lz4",), "lz4 -d {file} {out}"),
    b"PK\x03\x04": _Packing("zip", (".zip",), "unzip {file} -d {out}"),
    b"7z\xbc\xaf\x27\x1c": _Packing("7-Zip", (".7z",), "7z x {file} -o{out}"),
    b"Rar!\x1a\x07": _Packing("RAR", (".rar",), "unrar x {file}"),
}
_TAR = _Packing("tar", (".tar",), "tar xf {file}")
_TARRED = "a tar archive"


def local_name(spec: str | os.PathLike[str]) -> str:
    """The path that an input stands for: "-" is the standard input, a file URL its path; others as they are."""
    text = os.fspath(spec)
    if text == "-":
        return STDIN
    if os.path.exists(text):  # noqa: PTH110  pathlib raises for long names
        return text
    if found := _FILE_URL.fullmatch(text):
        return found[1] if os.path.exists(found[1]) else unquote(found[1])  # noqa: PTH110
    return re.sub(r"^[A-Za-z][\w+.-]*://", lambda scheme: scheme[0].lower(), text)


def is_url(text: str) -> bool:
    """Whether a name that is no file's is a URL."""
    return "://" in text and not os.path.exists(text)  # noqa: PTH110


def without_password(url: str) -> str:
    """A URL as messages may show it: without user and password, which may hold any sign, and without its query."""
    scheme, there, place = url.partition("://")
    if not there:
        return url
    server = re.split(r"[/?#]", place)[0]
    if "@" in server or ":" in server:
        place = place.rpartition("@")[2]
    return f"{scheme}://{re.sub(r'[?].*', '?...', place)}"


def title_of(text: str) -> str:
    """A local name as messages show it."""
    return "the standard input" if text == STDIN else f"'{without_password(text)}'"


def kind_of(path: str) -> Kind:
    """What is at a path; nothing is read of a pipe or a device."""
    try:
        mode = os.stat(path)  # noqa: PTH116
    except (OSError, ValueError):
        return "camera" if _CAMERAS.fullmatch(path) else "missing"
    if stat.S_ISDIR(mode.st_mode):
        return "folder"
    if stat.S_ISCHR(mode.st_mode):
        return "camera" if os.major(mode.st_rdev) == _VIDEO4LINUX else "device"
    if stat.S_ISFIFO(mode.st_mode) or stat.S_ISSOCK(mode.st_mode):
        return "pipe"
    if not stat.S_ISREG(mode.st_mode):
        return "device"
    return kind_of_content(start_of(path), Path(path).suffix.lower())


def kind_of_content(start: bytes, suffix: str = "") -> Kind:
    """What a file is that begins with these bytes, and whose name has this suffix."""
    if start.startswith(tuple(_LOGS)):
        return "log"
    if _packing(start) is not None:
        return "packed"
    if is_motion_jpeg(start):
        return "video"
    if _is_still(start) and suffix not in _MOTION_JPEG:
        return "image"
    if start[4:8] == b"ftyp" or start.startswith(b"\x1a\x45\xdf\xa3") or start[8:12] == b"AVI ":
        return "video"
    return "unknown"


def start_of(path: str) -> bytes:
    """What a file begins with, see `start_from`; nothing where it cannot be read."""
    try:
        with open(path, "rb") as file:  # noqa: PTH123
            return start_from(file.read)
    except (OSError, ValueError):
        return b""


def start_from(read: Callable[[int], bytes]) -> bytes:
    """What something begins with that is read by a function: so much that it tells what that is."""
    start = bytearray()
    wanted = _START
    while wanted and (more := read(wanted)):
        start += more
        if len(start) >= _START:
            unclear = start.startswith(JPEG) and len(start) < _MOST and is_motion_jpeg(start) is None
            wanted = max(len(start), 1 << 16) if unclear else 0
        else:
            wanted = _START - len(start)
    return bytes(start)


def packed_error(text: str, start: bytes) -> InputError:
    """What to say of a packed input: what it is, and of a file how to unpack it."""
    packing = _packing(start)
    assert packing is not None
    path = Path(text)
    known = path.suffix.lower() in packing.suffixes
    out = path.with_suffix("") if known else path.with_name(f"{path.name}.unpacked")
    inside = _inside(start, packing, out)
    says = f"{title_of(text)} is packed by {packing.name}{f' and holds {inside}' if inside else ''}: unpack it"
    if text == STDIN or not path.is_file():
        return InputError(f"{says} into a file, and name that")
    command = (_TAR if inside == _TARRED else packing).command.format(file=shlex.quote(text), out=shlex.quote(str(out)))
    return InputError(f"{says} first with `{command}`, and give what comes out")


def is_text(start: bytes) -> bool:
    """Whether a file begins as text does."""
    return bool(start) and all(byte >= 32 or byte in b"\t\n\r\f" for byte in start)


def _packing(start: bytes) -> _Packing | None:
    for magic, packing in _PACKINGS.items():
        if start.startswith(magic):
            return packing
    return _TAR if start[257:262] == b"ustar" else None


def _inside(start: bytes, packing: _Packing, out: Path) -> str:
    """What is packed, by its first bytes where Python unpacks them, else by the first name in an archive or its own."""
    head, first = b"", ""
    with suppress(OSError, ValueError, EOFError, zlib.error, lzma.LZMAError):
        if packing.name == "gzip":
            head = zlib.decompressobj(31).decompress(start, _START)
        elif packing.name == "bzip2":
            head = bz2.BZ2Decompressor().decompress(start, _START)
        elif packing.name == "xz":
            head = lzma.LZMADecompressor(memlimit=1 << 27).decompress(start, _START)
        elif packing.name == "zip":
            first = start[30 : 30 + int.from_bytes(start[26:28], "little")].decode(errors="replace")
        elif packing.name == "tar":
            first = start[:100].rstrip(b"\0").decode(errors="replace")
    for magic, name in _LOGS.items():
        if head.startswith(magic):
            return name
    if head[257:262] == b"ustar" or out.suffix.lower() == ".tar":
        return _TARRED
    told = {"image": "an image", "video": "a video"}.get(kind_of_content(head), "")
    return told or _named(first) or _named(out.name)


def _named(name: str) -> str:
    from frontend.sources.image_names import IMAGE_SUFFIXES, VIDEO_SUFFIXES

    suffix = Path(name).suffix.lower()
    if suffix in LOG_SUFFIXES or name.lower().endswith(".bag.active"):
        return "a log"
    if suffix in IMAGE_SUFFIXES:
        return "images"
    return "a video" if suffix in VIDEO_SUFFIXES else ""


def _is_still(start: bytes) -> bool:
    if start.startswith(_STILLS) or (start[:4] == b"RIFF" and start[8:12] == b"WEBP"):
        return True
    if start[:2] == b"BM" and int.from_bytes(start[14:18], "little") in (12, 40, 52, 56, 64, 108, 124):
        return True
    if re.match(rb"P[1-6]\s+(#[^\n]*\n\s*)*\d", start):
        return True
    return start[4:8] == b"ftyp" and start[8:12] in _STILL_BRANDS
