"""Image files, told by their bytes: JPEG, PNG, WebP, BMP, TIFF, PNM, GIF, AVIF and HEIC.

A file's header is read before a decoder may allocate for it. An image of more than 64 megapixels is refused, and one
for which its file is too short by what its format can compress at most.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.sources import heif, tiff
from frontend.sources.orientation import upright
from frontend.sources.reading import Bytes, Image, UndecodableError, as_frame_image

MOST_PIXELS = 1 << 26
_MOST_JPEG_SEGMENTS = 10_000
_FLAT_WEBP = 1 << 22
_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_PNG_GREY = {0, 4}
_PNM_SIDES = re.compile(rb"P[1-6](?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s")
_PAM_SIDE = re.compile(rb"^(WIDTH|HEIGHT)[ \t]+(\d{1,9})\s", re.MULTILINE)
_HEAD = 64  # bytes by which a file is told


class Header(NamedTuple):
    """What a file says of itself.

    Attributes:
        codec: "JPEG", "PNG" and so on.
        exif: the orientation that EXIF data or the format's own state, 1 (as stored) to 8.
        durations_ns: of an animation's pictures; 0 where none is stated.
        pages: the directories of a TIFF's pictures.
    """

    codec: str
    exif: int = 1
    durations_ns: tuple[int, ...] = ()
    pages: tuple[tiff.Directory, ...] = ()

    @property
    def pictures(self) -> int:
        """How many there are in the file, one after the other."""
        return max(1, len(self.durations_ns), len(self.pages))


class Still(NamedTuple):
    """A decoded file: its first picture, turned by `header.exif` unless that was not wanted."""

    image: Image
    header: Header


def decode_encoded(data: Bytes, autorotate: bool = True) -> Image:
    """The image in a file; see `read_only_still`."""
    return read_only_still(data, autorotate).image


def read_only_still(data: Bytes, autorotate: bool = True) -> Still:
    """The picture in a file, from any thread; see `read_still`.

    Raises:
        UndecodableError: as there, and for an animation or several pages.
    """
    header = read_header(data)
    if header.pictures > 1:
        raise UndecodableError("animated image is not readable" if header.durations_ns else "file has several pages")
    return Still(decode_picture(data, header, autorotate), header)


def read_still(data: Bytes, autorotate: bool = True) -> Still:
    """The first picture in a file, from any thread, upright as its EXIF data say unless `autorotate` is off.

    Returns:
        (H, W) or (H, W, 3) BGR, uint8 or uint16 as in the file, without alpha, C-contiguous; and the file's header.

    Raises:
        UndecodableError: no image file; a cut, damaged or too large one; pixels that are measured values (float).
        ConfigError: HEIC, and the extra for it is not installed.
    """
    header = read_header(data)
    return Still(decode_picture(data, header, autorotate), header)


def codec_of(head: bytes) -> str | None:
    """What image file begins with these bytes, 64 or more; None for none."""
    if head.startswith(_JPEG):
        return "JPEG"
    if head.startswith(_PNG):
        return "PNG"
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return "WebP"
    if head[:6] in (b"GIF87a", b"GIF89a"):
        return "GIF"
    if head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return "TIFF"
    if head[:2] == b"BM" and head[14:15] in (b"\x0c", b"\x28", b"\x34", b"\x38", b"\x40", b"\x6c", b"\x7c"):
        return "BMP"
    if re.match(rb"P[1-7][\s#]", head):
        return "PNM"
    return heif.brand_of(head)


def read_header(data: Bytes) -> Header:
    """What a file says of itself; raises UndecodableError for one that cannot be used."""
    head = bytes(data[:_HEAD])
    codec = codec_of(head)
    if codec is None:
        raise UndecodableError("no image file that is known", f"{len(data)} bytes beginning with {head[:4].hex()}")
    try:
        return _READERS[codec](data)
    except (struct.error, IndexError, KeyError) as error:  # reading beyond the end
        raise damaged("it is cut") from error


def decode_picture(data: Bytes, header: Header, autorotate: bool) -> Image:
    """The first picture of a file whose header has been read."""
    if header.codec == "HEIC":
        pixels = heif.decode_heic(data, header.exif)
    else:
        if header.codec == "TIFF":
            data = _with_page_first(memoryview(bytearray(data)), header.pages[0])
        pixels = _pixels(data)
    image = frame_of(pixels)
    if header.codec == "JPEG" and np.all(image[-1, -1] == 128) and not _fills_its_image(data):
        raise damaged("it ends before its last pixels")
    if header.codec == "PNG" and image.ndim == 3 and data[25] in _PNG_GREY:
        image = cast("Image", cv2.extractChannel(image, 0))
    return upright(image, header.exif) if autorotate else image


def decode_page(buffer: memoryview, page: tiff.Directory, autorotate: bool) -> Image:
    """A page of a TIFF file in writable memory, which is changed."""
    exif = _tiff_page(buffer, page)
    image = frame_of(_pixels(_with_page_first(buffer, page)))
    return upright(image, exif) if autorotate else image


def _with_page_first(buffer: memoryview, page: tiff.Directory) -> memoryview:
    """Make a TIFF file begin with a page, and state no orientation: OpenCV turns by that, always."""
    file = tiff.Tiff(buffer)
    struct.pack_into(f"{file.order}{'Q' if file.wide else 'I'}", buffer, file.first_at, page.place)
    if tiff.ORIENTATION in page.tags:
        place, code = page.tags[tiff.ORIENTATION]
        struct.pack_into(file.order + code, buffer, place, 1)
    return buffer


def frame_of(pixels: NDArray[Any]) -> Image:
    """Decoded pixels as a frame has them; raises UndecodableError for other types than uint8 and uint16."""
    image = as_frame_image(pixels)
    if image is None and pixels.dtype.kind == "f":
        raise UndecodableError(f"its pixels are measured values of {pixels.dtype}, convert them to 8 or 16 bits")
    if image is None:
        raise UndecodableError(f"its pixels are {pixels.dtype}, convert them to unsigned ones of 8 or 16 bits")
    return image


def _pixels(data: Bytes) -> NDArray[Any]:
    try:
        with silence():
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise damaged(str(error)) from error
    if pixels is None or not pixels.size:
        raise damaged("its pixels cannot be decoded")
    return cast("NDArray[Any]", pixels)


def _jpeg(data: Bytes) -> Header:
    """Check the size and that the file has an end (ITU-T T.81, annex B).

    Every block of 8x8 pixels takes at least one bit (its DC coefficient in a progressive file): 512 pixels per byte.
    Arithmetic coding, which has no such bound, lossless and hierarchical files are not readable.
    """
    place, exif = 2, 1
    for _ in range(_MOST_JPEG_SEGMENTS):
        mark, marker, length = struct.unpack_from(">BBH", data, place)
        if mark != 0xFF or marker in (0x00, 0xD8, 0xD9, 0xDA):
            raise damaged("it has no frame header")
        if marker == 0xFF:  # a fill byte
            place += 1
        elif marker == 0x01 or 0xD0 <= marker <= 0xD7:
            place += 2
        elif marker in (0xC0, 0xC1, 0xC2):
            height, width = struct.unpack_from(">HH", data, place + 5)
            _check_size(width, height, 512 * len(data))
            # A coded 0xff is followed by a zero, so these bytes can only be the end. Cameras pad after it.
            if bytes(data[-2:]) != b"\xff\xd9" and bytes(data[place:]).rfind(b"\xff\xd9") < 0:
                raise damaged("it is cut")
            return Header("JPEG", exif)
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            raise UndecodableError("kind of JPEG is not readable", f"SOF{marker - 0xC0}")
        else:
            if marker == 0xE1 and bytes(data[place + 4 : place + 10]) == b"Exif\0\0":
                exif = tiff.exif_orientation(data[place + 10 : place + 2 + length])
            place += 2 + max(length, 2)
    raise damaged("it has no frame header")


def _fills_its_image(data: Bytes) -> bool:
    """Whether FFmpeg, too, finds pixels for the whole JPEG; without FFmpeg it counts as whole.

    Where a file was cut and then ended properly, OpenCV leaves the rest of the image at a grey of 128 without an error.
    FFmpeg takes twice the time and so is only asked about images that end in this grey.
    """
    try:
        import av
    except ModuleNotFoundError:
        return True
    codec = av.CodecContext.create("mjpeg", "r")
    codec.options = {"err_detect": "explode", "max_pixels": str(MOST_PIXELS)}
    packet = av.Packet(len(data))
    packet.update(bytes(data))
    try:
        codec.decode(packet)
    except av.error.InvalidDataError:
        return False
    except av.error.FFmpegError:
        pass  # a rare kind that only OpenCV can decode
    return True


def _png(data: Bytes) -> Header:
    """Check the size, and every chunk by its CRC, to the end (ISO/IEC 15948).

    Deflate makes at most 1032 bytes of one (258 of two bits).
    """
    view = memoryview(data)
    width, height, depth, colour = struct.unpack_from(">IIBB", data, 16)
    row = (width * _PNG_CHANNELS.get(colour, 1) * depth + 7) // 8 + 1
    _check_size(width, height, MOST_PIXELS if row * height <= 1032 * len(data) else 0)
    place, exif, animated, durations = len(_PNG), 1, False, list[int]()
    while True:
        length, kind = struct.unpack_from(">I4s", data, place)
        (crc,) = struct.unpack_from(">I", data, place + 8 + length)
        if zlib.crc32(view[place + 4 : place + 8 + length]) != crc or (place == len(_PNG)) != (kind == b"IHDR"):
            raise damaged("a chunk does not match its checksum")
        if kind == b"IEND":
            return Header("PNG", exif, tuple(durations) if animated else ())
        if kind == b"eXIf":
            exif = tiff.exif_orientation(view[place + 8 : place + 8 + length])
        elif kind == b"acTL":
            animated = True
        elif kind == b"fcTL":
            ticks, per_second = struct.unpack_from(">HH", data, place + 28)
            durations.append(ticks * 10**9 // (per_second or 100))
        place += 12 + length


def _webp(data: Bytes) -> Header:
    """Check the size and that the file is whole (RFC 9649, RFC 6386).

    Lossy: a block of 16x16 pixels takes at least two bits for its modes, which makes 1024 pixels per byte. Lossless and
    alpha: an image of one colour takes no bytes at all, so 4 megapixels are always allowed.
    """
    (length,) = struct.unpack_from("<I", data, 4)
    if length + 8 > len(data):
        raise damaged("it is cut")
    kind = bytes(data[12:16])
    exif, durations = 1, list[int]()
    if kind == b"VP8 ":
        width, height = (side & 0x3FFF for side in struct.unpack_from("<HH", data, 26))
    elif kind == b"VP8L":
        (sides,) = struct.unpack_from("<I", data, 21)
        width, height = (sides & 0x3FFF) + 1, (sides >> 14 & 0x3FFF) + 1
    elif kind == b"VP8X":
        sides = int.from_bytes(data[24:30], "little")
        width, height = (sides & 0xFFFFFF) + 1, (sides >> 24) + 1
        place = 12
        while place + 8 <= length + 8:
            name, size = struct.unpack_from("<4sI", data, place)
            if name == b"ANMF":
                durations.append(int.from_bytes(data[place + 20 : place + 23], "little") * 10**6)
            elif name == b"EXIF":
                block = data[place + 8 : place + 8 + size]
                exif = tiff.exif_orientation(block[6:] if bytes(block[:6]) == b"Exif\0\0" else block)
            place += 8 + size + size % 2
    else:
        raise damaged("it has no image")
    _check_size(width, height, 1024 * len(data) + _FLAT_WEBP)
    return Header("WebP", exif, tuple(durations))


def _gif(data: Bytes) -> Header:
    """Check the size and count the pictures, to the end (GIF89a)."""
    width, height, flags = struct.unpack_from("<HHB", data, 6)
    _check_size(width, height, MOST_PIXELS)
    place, delay, durations = 13 + _gif_colours(flags), 0, list[int]()
    while data[place] != 0x3B:
        if data[place] == 0x21:
            if data[place + 1] == 0xF9:
                (delay,) = struct.unpack_from("<H", data, place + 4)
            place += 2
        elif data[place] == 0x2C:
            durations.append(delay * 10**7)
            delay = 0
            place += 11 + _gif_colours(data[place + 9])
        else:
            raise damaged("it has an unknown block")
        while data[place]:
            place += 1 + data[place]
        place += 1
    if not durations:
        raise damaged("it has no image")
    return Header("GIF", 1, tuple(durations))


def _gif_colours(flags: int) -> int:
    """Bytes of a table of colours."""
    return 3 << (flags & 7) + 1 if flags & 0x80 else 0


def _tiff(data: Bytes) -> Header:
    """Check the size of the first page."""
    pages = tuple(tiff.Tiff(data).pages())
    if not pages:
        raise UndecodableError("it has no picture but thumbnails", "a raw photograph is to be developed first")
    return Header("TIFF", _tiff_page(data, pages[0]), (), pages)


def _tiff_page(data: Bytes, page: tiff.Directory) -> int:
    """Check the size of a page; returns its orientation. What compressed data can hold has no bound."""
    try:
        file = tiff.Tiff(data)
        width, height, bits, samples, compression, exif = (
            file.value(page, tag, default)
            for tag, default in (
                (tiff.WIDTH, 0),
                (tiff.HEIGHT, 0),
                (tiff.BITS, 1),
                (tiff.SAMPLES, 1),
                (tiff.COMPRESSION, 1),
                (tiff.ORIENTATION, 1),
            )
        )
    except struct.error as error:
        raise damaged("it is cut") from error
    if bits * samples > 256:
        raise UndecodableError("kind of TIFF is not readable", f"{samples} samples of {bits} bits per pixel")
    _check_size(width, height, 8 * len(data) // max(bits * samples, 1) if compression == 1 else MOST_PIXELS)
    return exif if 1 <= exif <= 8 else 1


def _bmp(data: Bytes) -> Header:
    """Check the size."""
    (header,) = struct.unpack_from("<I", data, 14)
    if header == 12:
        width, height, _, bits = struct.unpack_from("<HHHH", data, 18)
        compression = 0
    else:
        width, height, _, bits, compression = struct.unpack_from("<iiHHI", data, 18)
    _check_size(width, abs(height), MOST_PIXELS if compression in (1, 2) else 8 * len(data) // max(bits, 1))
    return Header("BMP")


def _pnm(data: Bytes) -> Header:
    """Check the size; a pixel takes a bit at least."""
    head = bytes(data[:1024])
    found = _PNM_SIDES.match(head)
    sides = dict(cast("list[tuple[bytes, bytes]]", _PAM_SIDE.findall(head)))
    width, height = map(int, found.groups() if found else (sides[b"WIDTH"], sides[b"HEIGHT"]))
    _check_size(width, height, 8 * len(data))
    return Header("PNM")


def _heif(data: Bytes) -> Header:
    """Check the size."""
    width, height, exif = heif.shape_of(data)
    _check_size(width, height, MOST_PIXELS)
    codec = heif.brand_of(bytes(data[:_HEAD]))
    assert codec is not None
    return Header(codec, exif)


_READERS: dict[str, Callable[[Bytes], Header]] = {
    "JPEG": _jpeg,
    "PNG": _png,
    "WebP": _webp,
    "GIF": _gif,
    "TIFF": _tiff,
    "BMP": _bmp,
    "PNM": _pnm,
    "AVIF": _heif,
    "HEIC": _heif,
}


def _check_size(width: int, height: int, most: int) -> None:
    if width < 1 or height < 1:
        raise damaged("it has no pixels")
    if width * height > MOST_PIXELS:
        raise UndecodableError("image is too large", f"{width}x{height} pixels")
    if width * height > most:
        raise damaged(f"it is too short for {width}x{height} pixels")


def damaged(detail: str) -> UndecodableError:
    return UndecodableError("cut or damaged image", detail)


_lock = Lock()
_levels: list[int] = []  # OpenCV's log levels before each of the blocks that threads are in


@contextmanager
def silence() -> Iterator[None]:
    """Silence OpenCV's log while any thread is inside."""
    with _lock:
        _levels.append(cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT))
    try:
        yield
    finally:
        with _lock:
            former = _levels.pop()  # the first of them was not silent, and is the last to go
            if not _levels:
                cv2.utils.logging.setLogLevel(former)
