"""Image files, told by their bytes: JPEG, PNG, WebP, BMP, TIFF, PNM, GIF, AVIF and HEIC.

Pillow reads what a file says of itself before OpenCV, which keeps 16 bits, may allocate for its pixels. An image of
more than 64 megapixels is refused, and one for which its file is too short by what its format can compress at most.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from pkgutil import resolve_name
from threading import Lock
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
from PIL.ExifTags import Base
from PIL.Image import DecompressionBombError, Exif
from PIL.ImageFile import ImageFile

from airline.errors import AirLineError, InputError, from_extra
from frontend.sources import tiff
from frontend.sources.orientation import turned
from frontend.sources.reading import Bytes, Image, UndecodableError, as_frame_image

MOST_PIXELS = 1 << 26
_FLAT = 1 << 22  # pixels that any file may have
_HEAD = 64  # bytes by which a file is told

# How its files begin, what opens them, and how many pixels a byte can hold: every block of 8x8 pixels of a JPEG takes a
# bit at least (ITU-T T.81), one of 16x16 of a WebP two (RFC 6386); deflate makes 1032 bytes of one at most.
_CODECS: dict[str, tuple[bytes, str, int]] = {
    "JPEG": (rb"\xff\xd8\xff", "PIL.JpegImagePlugin:JpegImageFile", 512),
    "PNG": (rb"\x89PNG\r\n\x1a\n", "PIL.PngImagePlugin:PngImageFile", 8 * 1032),
    "WebP": (rb"RIFF....WEBP", "PIL.WebPImagePlugin:WebPImageFile", 1024),
    "GIF": (rb"GIF8[79]a", "PIL.GifImagePlugin:GifImageFile", MOST_PIXELS),
    "TIFF": (rb"II[*+]\0|MM\0[*+]", "", MOST_PIXELS),
    "BMP": (rb"BM.{12}[\x0c\x28\x34\x38\x40\x6c\x7c]", "PIL.BmpImagePlugin:BmpImageFile", 128),
    "PNM": (rb"P[1-6][\s#]", "PIL.PpmImagePlugin:PpmImageFile", 8),
    "AVIF": (rb"....ftyp(....)*avi[fs]", "PIL.AvifImagePlugin:AvifImageFile", MOST_PIXELS),
    "HEIC": (rb"....ftyp(....)*(hei[cxms]|hev[cx]|mif1|msf1)", "pillow_heif:HeifImageFile", MOST_PIXELS),
}
_ENDS = {"JPEG": b"\xff\xd9", "PNG": b"IEND\xaeB`\x82"}  # neither can be in the pixels' data; cameras pad after it
_PNG_DEPTH, _PNG_COLOUR, _PNG_GREY = 24, 25, (0, 4)  # places, and two of the colour types

warnings.filterwarnings("ignore", module=r"PIL\.TiffImagePlugin")  # damaged EXIF data turn nothing


class Header(NamedTuple):
    """What a file says of itself.

    Attributes:
        codec: "JPEG", "PNG" and so on.
        exif: the orientation that EXIF data or the format's own state, 1 (as stored) to 8.
        pictures: how many there are in the file, one after the other.
        pages: the same, of a TIFF.
    """

    codec: str
    exif: int = 1
    pictures: int = 1
    pages: tuple[tiff.Page, ...] = ()


class Still(NamedTuple):
    """A decoded file: its first picture, turned by `header.exif` unless that was not wanted."""

    image: Image
    header: Header


def read_image(path: Path) -> Image:
    """(H, W[, 3]) grey or BGR picture in a file that has one and no other; InputError otherwise."""
    try:
        return decode_encoded(path.read_bytes())
    except OSError as error:
        raise InputError(f"cannot read '{path}' ({error.strerror}): give an image file") from error
    except UndecodableError as error:
        raise InputError(f"'{path}' is no image that can be read, {error}: replace or remove it") from error


def decode_encoded(data: Bytes, autorotate: bool = True) -> Image:
    """The image in a file that has no other; see `read_still`."""
    return read_still(data, autorotate, only=True).image


def read_still(data: Bytes, autorotate: bool = True, *, only: bool = False) -> Still:
    """The first picture in a file, from any thread, upright as its EXIF data say unless `autorotate` is off.

    Returns:
        (H, W) or (H, W, 3) BGR, uint8 or uint16 as in the file, without alpha, C-contiguous; and the file's header.

    Raises:
        UndecodableError: no image file; a cut, damaged or too large one; pixels that are measured values (float); with
            `only` an animation or several pages.
        ConfigError: HEIC, and the extra for it is not installed.
    """
    header = read_header(data)
    if only and header.pictures > 1:
        raise UndecodableError("file has several pages" if header.pages else "animated image is not readable")
    if header.pages:
        return Still(decode_page(BytesIO(data), header.pages[0], autorotate), header)
    with reading():
        by_pillow = header.codec in ("GIF", "HEIC")  # of the one OpenCV takes cut files, of the other none
        image = pixels_of(open_image(header.codec, bytes(data))) if by_pillow else _decode(data)
    if header.codec == "JPEG" and np.all(image[-1, -1] == 128) and not _fills_its_image(data):
        raise damaged("it ends before its last pixels")
    if header.codec == "PNG" and image.ndim == 3 and data[_PNG_COLOUR] in _PNG_GREY:
        image = cast("Image", cv2.extractChannel(image, 0))
    return Still(turned(image, header.exif, autorotate, already=header.codec == "HEIC"), header)


def read_header(data: Bytes) -> Header:
    """What a file says of itself; raises UndecodableError for one that cannot be used."""
    head = bytes(data[:_HEAD])
    codec = next((name for name, (begin, *_) in _CODECS.items() if re.match(begin, head, re.DOTALL)), None)
    if codec is None:
        raise UndecodableError("no image file that is known", f"{len(data)} bytes beginning with {head[:4].hex()}")
    with reading():
        if codec == "TIFF":
            pages = tiff.pages_of(BytesIO(data))
            if not pages:
                raise UndecodableError("it has no picture but thumbnails", "a raw photograph is to be developed first")
            return Header(codec, pages[0].exif, len(pages), pages)
        return _header(codec, bytes(data))


def _header(codec: str, data: bytes) -> Header:
    image = open_image(codec, data)
    bits = data[_PNG_DEPTH] * len(image.getbands()) if codec == "PNG" else 1
    check_size(*image.size, _CODECS[codec][2] * len(data) // bits + _FLAT)
    if codec in _ENDS and image.fp and data.rfind(_ENDS[codec], image.fp.tell()) < 0:
        raise damaged("it is cut")
    if codec == "PNG":
        open_image(codec, data).verify()  # every chunk by its CRC, to the end
        if b"eXIf" in data:
            image.load()  # it may come after the pixels
    pictures = 1 if codec == "HEIC" else getattr(image, "n_frames", 1) - getattr(image, "default_image", False)
    return Header(codec, _orientation(image), pictures)


def open_image(codec: str, data: bytes) -> ImageFile:
    """By Pillow, without the limits and the warnings of `Image.open`."""
    with from_extra("heic"):
        return cast("ImageFile", resolve_name(_CODECS[codec][1])(BytesIO(data)))


def _orientation(image: ImageFile) -> int:
    """What EXIF data state, 1 to 8; 1 where they state none or are damaged."""
    exif = Exif()
    try:
        exif.load(image.info.get("exif", b""))
    except Exception:  # whatever Pillow raises for damaged data
        return 1
    stated: Any = image.info.get("original_orientation", exif.get(Base.Orientation))  # the former of HEIC
    return stated if stated in range(1, 9) else 1


def decode_page(file: BytesIO, page: tiff.Page, autorotate: bool) -> Image:
    """A page of a TIFF; changes the file."""
    check_size(page.width, page.height, MOST_PIXELS if page.compressed else 8 * file.getbuffer().nbytes)
    with reading():
        image = _decode(tiff.put_first(file, page))
    return turned(image, page.exif, autorotate, already=True)  # by OpenCV


def pixels_of(image: ImageFile) -> Image:
    """(H, W, 3) BGR or (H, W) grey of a picture that Pillow decodes."""
    if image.getbands()[0] in ("L", "I") and image.format != "GIF":  # of which only some pictures may be grey
        return cast("Image", np.array(image.getchannel(0)))
    return cast("Image", cv2.cvtColor(np.asarray(image.convert("RGB")), cv2.COLOR_RGB2BGR))


def _decode(data: Bytes) -> Image:
    """By OpenCV; raises UndecodableError for pixels of other types than uint8 and uint16."""
    pixels: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None or not pixels.size:
        raise damaged("its pixels cannot be decoded")
    image = as_frame_image(pixels)
    if image is None and pixels.dtype.kind == "f":
        raise UndecodableError(f"its pixels are measured values of {pixels.dtype}, convert them to 8 or 16 bits")
    if image is None:
        raise UndecodableError(f"its pixels are {pixels.dtype}, convert them to unsigned ones of 8 or 16 bits")
    return image


def _fills_its_image(data: Bytes) -> bool:
    """Whether FFmpeg, too, finds pixels for the whole JPEG.

    Where a file was cut and then ended properly, OpenCV leaves the rest of the image at a grey of 128 without an error.
    FFmpeg takes twice the time and so is only asked about images that end in this grey.
    """
    import av  # takes time

    codec = av.CodecContext.create("mjpeg", "r")
    codec.options = {"err_detect": "explode", "max_pixels": str(MOST_PIXELS)}
    try:
        codec.decode(av.Packet(bytes(data)))
    except av.error.FFmpegError as error:  # of another kind for what only OpenCV can decode
        return not isinstance(error, av.error.InvalidDataError)
    return True


def check_size(width: int, height: int, most: int = MOST_PIXELS) -> None:
    """Raises UndecodableError for no pixels, too many, or more than `most`, which a file can hold."""
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
def reading() -> Iterator[None]:
    """Make one error of the many that libraries raise, and silence OpenCV's log while any thread is inside."""
    with _lock:
        _levels.append(cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT))
    try:
        yield
    except AirLineError:
        raise
    except DecompressionBombError as error:
        raise UndecodableError("image is too large", str(error)) from error
    except Exception as error:
        raise damaged(str(error)) from error
    finally:
        with _lock:
            former = _levels.pop()  # the first of them was not silent, and is the last to go
            if not _levels:
                cv2.utils.logging.setLogLevel(former)
