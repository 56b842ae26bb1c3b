"""JPEG, PNG and WebP images, told by their bytes.

A file's header is read before OpenCV may allocate for it. An image of more than 64 megapixels is refused, and one for
which its file is too short by what its format can compress at most.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import cast

import cv2
import numpy as np

from frontend.sources.reading import Bytes, Image, UndecodableError, as_frame_image

MOST_PIXELS = 1 << 26
_MOST_JPEG_SEGMENTS = 10_000
_FLAT_WEBP = 1 << 22
_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_PNG_GREY = {0, 4}


def decode_encoded(data: Bytes) -> Image:
    """The image in a file, from any thread: not turned by its EXIF orientation.

    Returns:
        (H, W) or (H, W, 3) BGR, uint8 or uint16 as in the file, without alpha, C-contiguous.

    Raises:
        UndecodableError: no JPEG, PNG or WebP file; a cut, damaged, animated or too large one.
    """
    head = bytes(data[:16])
    try:
        if head.startswith(_JPEG):
            _jpeg(data)
        elif head.startswith(_PNG):
            _png(data)
        elif head[:4] == b"RIFF" and head[8:12] == b"WEBP":
            _webp(data)
        else:
            raise UndecodableError("no JPEG, PNG or WebP image", f"{len(data)} bytes beginning with {head[:4].hex()}")
    except (struct.error, IndexError) as error:  # reading beyond the end
        raise _damaged("it is cut") from error
    try:
        with _silence():
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise _damaged(str(error)) from error
    image = None if pixels is None else as_frame_image(pixels)
    if image is None:
        raise _damaged("its pixels cannot be decoded")
    if head.startswith(_JPEG) and np.all(image[-1, -1] == 128) and not _fills_its_image(data):
        raise _damaged("it ends before its last pixels")
    if head.startswith(_PNG) and image.ndim == 3 and data[25] in _PNG_GREY:
        return cast("Image", cv2.extractChannel(image, 0))
    return image


def _jpeg(data: Bytes) -> None:
    """Check the size and that the file has an end (ITU-T T.81, annex B).

    Every block of 8x8 pixels takes at least one bit (its DC coefficient in a progressive file): 512 pixels per byte.
    Arithmetic coding, which has no such bound, lossless and hierarchical files are not readable.
    """
    place = 2
    for _ in range(_MOST_JPEG_SEGMENTS):
        mark, marker, length = struct.unpack_from(">BBH", data, place)
        if mark != 0xFF or marker in (0x00, 0xD8, 0xD9, 0xDA):
            raise _damaged("it has no frame header")
        if marker == 0xFF:  # a fill byte
            place += 1
        elif marker == 0x01 or 0xD0 <= marker <= 0xD7:
            place += 2
        elif marker in (0xC0, 0xC1, 0xC2):
            height, width = struct.unpack_from(">HH", data, place + 5)
            _check_size(width, height, 512 * len(data))
            # A coded 0xff is followed by a zero, so these bytes can only be the end. Cameras pad after it.
            if bytes(data[-2:]) != b"\xff\xd9" and bytes(data[place:]).rfind(b"\xff\xd9") < 0:
                raise _damaged("it is cut")
            return
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            raise UndecodableError("kind of JPEG is not readable", f"SOF{marker - 0xC0}")
        else:
            place += 2 + max(length, 2)
    raise _damaged("it has no frame header")


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


def _png(data: Bytes) -> None:
    """Check the size, and every chunk by its CRC, to the end (ISO/IEC 15948).

    Deflate makes at most 1032 bytes of one (258 of two bits).
    """
    view = memoryview(data)
    width, height, depth, colour = struct.unpack_from(">IIBB", data, 16)
    row = (width * _PNG_CHANNELS.get(colour, 1) * depth + 7) // 8 + 1
    _check_size(width, height, MOST_PIXELS if row * height <= 1032 * len(data) else 0)
    place = len(_PNG)
    while True:
        length, kind = struct.unpack_from(">I4s", data, place)
        (crc,) = struct.unpack_from(">I", data, place + 8 + length)
        if zlib.crc32(view[place + 4 : place + 8 + length]) != crc or (place == len(_PNG)) != (kind == b"IHDR"):
            raise _damaged("a chunk does not match its checksum")
        if kind == b"acTL":
            raise UndecodableError("animated image is not readable")
        if kind == b"IEND":
            return
        place += 12 + length


def _webp(data: Bytes) -> None:
    """Check the size and that the file is whole (RFC 9649, RFC 6386).

    Lossy: a block of 16x16 pixels takes at least two bits for its modes, which makes 1024 pixels per byte. Lossless and
    alpha: an image of one colour takes no bytes at all, so 4 megapixels are always allowed.
    """
    (length,) = struct.unpack_from("<I", data, 4)
    if length + 8 > len(data):
        raise _damaged("it is cut")
    kind = bytes(data[12:16])
    if kind == b"VP8 ":
        width, height = (side & 0x3FFF for side in struct.unpack_from("<HH", data, 26))
    elif kind == b"VP8L":
        (sides,) = struct.unpack_from("<I", data, 21)
        width, height = (sides & 0x3FFF) + 1, (sides >> 14 & 0x3FFF) + 1
    elif kind == b"VP8X":
        flags, sides = data[20], int.from_bytes(data[24:30], "little")
        if flags & 2:
            raise UndecodableError("animated image is not readable")
        width, height = (sides & 0xFFFFFF) + 1, (sides >> 24) + 1
    else:
        raise _damaged("it has no image")
    _check_size(width, height, 1024 * len(data) + _FLAT_WEBP)


def _check_size(width: int, height: int, most: int) -> None:
    if width < 1 or height < 1:
        raise _damaged("it has no pixels")
    if width * height > MOST_PIXELS:
        raise UndecodableError("image is too large", f"{width}x{height} pixels")
    if width * height > most:
        raise _damaged(f"it is too short for {width}x{height} pixels")


def _damaged(detail: str) -> UndecodableError:
    return UndecodableError("cut or damaged image", detail)


_lock = Lock()
_levels: list[int] = []  # OpenCV's log levels before each of the blocks that threads are in


@contextmanager
def _silence() -> Iterator[None]:
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
