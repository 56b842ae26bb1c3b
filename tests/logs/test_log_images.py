"""Raw and encoded images to pixels: every encoding against an independent judge, sizes that lie, cut files."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frontend.sources.reading import UndecodableError
from frontend.sources.stills import decode_encoded
from logs.images.decoder import decode_pixels, decode_still
from logs.messages.readers import reader_for
from logs.messages.types import EncodedImage, RawImage
from tests.helpers.camera_messages import cdr, image_fields, picture, ros1

DEPTH = (np.random.default_rng(3).integers(0, 65536, (64, 96))).astype(np.uint16)
COLOUR16 = np.dstack([DEPTH, DEPTH // 3, 65535 - DEPTH])
BAYER = ("rggb", "bggr", "gbrg", "grbg")


def mosaic(bgr: np.ndarray, pattern: str) -> np.ndarray:
    """What a sensor behind a colour filter sees; the pattern in reading order."""
    seen = np.empty(bgr.shape[:2], np.uint8)
    for place, colour in enumerate(pattern):
        y, x = divmod(place, 2)
        seen[y::2, x::2] = bgr[y::2, x::2, "bgr".index(colour)]
    return seen


def yuv(bgr: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Luminance, and colour differences at half the resolution, both in the limited range of BT.601."""
    height, width = bgr.shape[:2]
    planes = cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_I420).reshape(-1)
    luminance, rest = planes[: height * width].reshape(height, width), planes[height * width :]
    return luminance, rest.reshape(2, height // 2, width // 2).transpose(1, 2, 0)


def packed(bgr: np.ndarray, order: str) -> np.ndarray:
    luminance, colour = yuv(bgr)
    colour = colour.repeat(2, axis=0)
    channels = {"1": luminance[:, ::2], "2": luminance[:, 1::2], "u": colour[:, :, 0], "v": colour[:, :, 1]}
    return np.dstack([channels[name] for name in order]).reshape(bgr.shape[0], -1)


def planes(bgr: np.ndarray, swap: bool) -> np.ndarray:
    luminance, colour = yuv(bgr)
    return np.vstack([luminance, colour[:, :, :: -1 if swap else 1].reshape(len(colour), -1)])


def with_alpha(image: np.ndarray) -> np.ndarray:
    return np.dstack([image, np.full(image.shape[:2], 9, np.uint8)])


@cache
def grey() -> np.ndarray:
    return cv2.cvtColor(picture(), cv2.COLOR_BGR2GRAY)


RAW: dict[str, Callable[[], tuple[np.ndarray, np.ndarray, float]]] = {  # sent, meant, largest mean difference
    **dict.fromkeys(("mono8", "8UC1"), lambda: (grey(), grey(), 0)),
    **dict.fromkeys(("mono16", "16UC1"), lambda: (DEPTH, DEPTH, 0)),
    **dict.fromkeys(("bgr8", "8UC3"), lambda: (picture(), picture(), 0)),
    **{
        f"bayer_{order}16": partial(
            lambda order: (mosaic(picture(), order).astype(np.uint16) * 257, picture().astype(np.uint16) * 257, 1100),
            order,
        )
        for order in BAYER
    },
    "8UC2": lambda: (np.dstack([grey(), grey() // 2]), grey(), 0),
    **dict.fromkeys(("bgr16", "16UC3"), lambda: (COLOUR16, COLOUR16, 0)),
    "rgb16": lambda: (np.ascontiguousarray(COLOUR16[:, :, ::-1]), COLOUR16, 0),
    **dict.fromkeys(("bgra16", "16UC4"), lambda: (np.dstack([COLOUR16, DEPTH]), COLOUR16, 0)),
    "rgba16": lambda: (np.dstack([COLOUR16[:, :, ::-1], DEPTH]), COLOUR16, 0),
    "rgb8": lambda: (picture()[:, :, ::-1], picture(), 0),
    **dict.fromkeys(("bgra8", "8UC4"), lambda: (with_alpha(picture()), picture(), 0)),
    "rgba8": lambda: (with_alpha(picture()[:, :, ::-1]), picture(), 0),
    **{f"bayer_{order}8": partial(lambda order: (mosaic(picture(), order), picture(), 4.0), order) for order in BAYER},
    **dict.fromkeys(("yuv422", "uyvy"), lambda: (packed(picture(), "u1v2"), picture(), 2.5)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), lambda: (packed(picture(), "1u2v"), picture(), 2.5)),
    "nv12": lambda: (planes(picture(), False), picture(), 2.5),
    "nv21": lambda: (planes(picture(), True), picture(), 2.5),
}


def rows(sent: np.ndarray, padding: int, big_endian: bool) -> tuple[bytes, int]:
    """The rows as bytes, each but the last with padding, and the step."""
    lines = [line.tobytes() + b"\xee" * padding for line in (sent.byteswap() if big_endian else sent)]
    data = b"".join(lines)
    return data[: len(data) - padding], len(lines[0])


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("padding", [0, 5, 64])
@pytest.mark.parametrize("encoding", RAW)
def test_raw_encodings(encoding: str, padding: int, big_endian: bool) -> None:
    sent, meant, tolerance = RAW[encoding]()
    data, step = rows(sent, padding, big_endian)
    fields = image_fields(data, 96, 64, encoding, step, big_endian)
    images = []
    for schema, message_encoding, message in (
        ("sensor_msgs/msg/Image", "cdr", cdr("Image", **fields)),
        ("sensor_msgs/Image", "ros1", ros1("Image", **fields)),
    ):
        reader = reader_for(schema, message_encoding)
        assert reader is not None
        record = reader(message)
        assert isinstance(record, RawImage)
        images.append(decode_pixels(record))
    image = images[0]
    np.testing.assert_array_equal(image, images[1])
    assert image.dtype == meant.dtype
    assert image.dtype.isnative
    assert image.flags.c_contiguous
    assert image.flags.writeable
    assert image.shape == meant.shape
    assert np.abs(image.astype(int) - meant)[2:-2, 2:-2].mean() <= tolerance


@pytest.mark.parametrize(
    ("width", "height", "encoding", "step", "length", "reason"),
    [
        (0, 4, "mono8", 0, 16, "image size contradicts its data"),
        (4, 4, "mono8", 3, 16, "image size contradicts its data"),
        (4, 4, "mono8", 0, 15, "image size contradicts its data"),
        (4, 4, "mono8", 5, 18, "image size contradicts its data"),
        (2**32, 2**32, "mono8", 0, 16, "image size contradicts its data"),
        (4, 4, "mono16", 0, 31, "image size contradicts its data"),
        (5, 4, "yuv422", 0, 64, "image size contradicts its data"),
        (4, 3, "nv12", 0, 64, "image size contradicts its data"),
        (4, 4, "nv12", 0, 23, "image size contradicts its data"),
        (2, 2, "bayer_rggb8", 0, 4, "image size contradicts its data"),
        (4, 4, "32FC1", 0, 64, "image encoding is not readable"),
        (4, 4, "x" * 10**6, 0, 64, "image encoding is not readable"),
    ],
)
def test_raw_images_that_contradict_themselves(width, height, encoding, step, length, reason):
    with pytest.raises(UndecodableError) as caught:
        decode_pixels(RawImage(0, "", width, height, encoding, step, False, bytes(length)))
    assert caught.value.reason == reason
    assert len(str(caught.value)) < 200


size = st.one_of(st.integers(-2, 12), st.integers(-(2**40), 2**40))


@given(size, size, st.sampled_from([*RAW, "", "32FC1"]), size, st.booleans(), st.binary(max_size=300))
@settings(max_examples=300)
def test_any_raw_image(w: int, h: int, encoding: str, step: int, big_endian: bool, data: bytes) -> None:
    tracemalloc.start()
    try:
        image = decode_pixels(RawImage(0, "", w, h, encoding, step, big_endian, memoryview(data)))
        assert image.shape[:2] == (h, w)
        assert image.nbytes <= 3 * len(data)
    except UndecodableError:
        pass
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 50_000


def encode(suffix: str, image: np.ndarray, *parameters: int) -> bytes:
    done, data = cv2.imencode(suffix, image, parameters)
    assert done
    return data.tobytes()


PROGRESSIVE = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)


@cache
def bilevel() -> np.ndarray:
    return (grey() > 99) * np.uint8(255)


MADE: dict[str, Callable[[], tuple[bytes, np.ndarray, float]]] = {  # file, what it shows, largest mean difference
    "jpeg": lambda: (encode(".jpg", picture()), picture(), 4),
    "grey jpeg": lambda: (encode(".jpg", grey()), grey(), 2),
    "progressive jpeg": lambda: (encode(".jpg", picture(), *PROGRESSIVE), picture(), 4),
    "restarting jpeg": lambda: (encode(".jpg", picture(), cv2.IMWRITE_JPEG_RST_INTERVAL, 2), picture(), 4),
    "png": lambda: (encode(".png", picture()), picture(), 0),
    "grey png": lambda: (encode(".png", grey()), grey(), 0),
    "16-bit png": lambda: (encode(".png", DEPTH), DEPTH, 0),
    "png with alpha": lambda: (encode(".png", with_alpha(picture())), picture(), 0),
    "bilevel png": lambda: (encode(".png", bilevel(), cv2.IMWRITE_PNG_BILEVEL, 1), bilevel(), 0),
    "webp": lambda: (encode(".webp", picture(), cv2.IMWRITE_WEBP_QUALITY, 90), picture(), 5),
    "lossless webp": lambda: (encode(".webp", picture(), cv2.IMWRITE_WEBP_QUALITY, 101), picture(), 0),
    "webp with alpha": lambda: (encode(".webp", with_alpha(picture()), cv2.IMWRITE_WEBP_QUALITY, 90), picture(), 5),
}


@cache
def file(name: str) -> tuple[bytes, np.ndarray, float]:
    return MADE[name]()


@pytest.mark.parametrize("name", MADE)
def test_files(name: str) -> None:
    data, meant, tolerance = file(name)
    for buffer in (data, memoryview(data), data + bytes(64)):
        image = decode_encoded(buffer)
        assert image.dtype == meant.dtype
        assert image.shape == meant.shape
        assert np.abs(image.astype(int) - meant).mean() <= tolerance
        assert image.flags.c_contiguous
        assert image.flags.writeable


@pytest.mark.parametrize("name", MADE)
def test_cut_files(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    data = file(name)[0]
    for length in {*range(0, len(data), max(1, len(data) // 200)), len(data) - 1, len(data) - 2}:
        for rest in (b"",) if "webp" in name else (b"", bytes(64)):  # WebP has no mark of its end
            with pytest.raises(UndecodableError) as caught:
                decode_encoded(data[:length] + rest)
            assert caught.value.reason in ("cut or damaged image", "no image file that is known")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", ["jpeg", "grey jpeg", "restarting jpeg"])
def test_cut_jpeg_with_an_end(name: str) -> None:
    """As a driver writes that closes what the camera did not finish."""
    data = file(name)[0]
    start = data.index(b"\xff\xda") + 20
    for share in (0.0, 0.3, 0.6, 0.9):
        with pytest.raises(UndecodableError):
            decode_encoded(data[: start + int(share * (len(data) - start))] + b"\xff\xd9")


def test_images_that_are_grey_at_their_end() -> None:
    for image in (np.full((50, 70), 128, np.uint8), np.full((50, 70, 3), 128, np.uint8)):
        for parameters in ((), PROGRESSIVE):
            np.testing.assert_array_equal(decode_encoded(encode(".jpg", image, *parameters)), image)


def test_images_of_one_colour_are_not_too_short() -> None:
    """The bounds on what formats can compress hold for the emptiest images there are."""
    for shape in ((480, 640), (2160, 3840), (6000, 8000)):
        empty = np.zeros(shape, np.uint8)
        for suffix, parameters in ((".jpg", ()), (".jpg", PROGRESSIVE), (".png", (cv2.IMWRITE_PNG_COMPRESSION, 9))):
            assert decode_encoded(encode(suffix, empty, *parameters)).shape == shape
    for quality in (1, 101):
        assert decode_encoded(encode(".webp", np.zeros((1536, 2048, 3), np.uint8), 64, quality)).shape[0] == 1536


def test_stills_decode_in_threads(capfd) -> None:
    level, (data, *_) = cv2.utils.logging.getLogLevel(), file("jpeg")
    expected = decode_encoded(data)

    def decoded(number: int) -> bool:
        try:
            image = decode_still(EncodedImage(number, "", data if number % 3 else data[:400] + bytes(50))).image
        except UndecodableError:
            return False
        return np.array_equal(image, expected)

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(decoded, range(60))) == [number % 3 != 0 for number in range(60)]
    assert cv2.utils.logging.getLogLevel() == level
    assert capfd.readouterr().err == ""


def png_chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def claiming(name: str, width: int, height: int) -> bytes:
    """A file that claims another size."""
    data = bytearray(file(name)[0])
    if "png" in name:
        data[8:33] = png_chunk(b"IHDR", struct.pack(">II", width, height) + data[24:29])
    elif "jpeg" in name:
        start = max(data.find(b"\xff\xc0"), data.find(b"\xff\xc2"))
        struct.pack_into(">HH", data, start + 5, height, width)
    elif name == "lossless webp":
        struct.pack_into("<I", data, 21, (height - 1) << 14 | (width - 1))
    else:
        struct.pack_into("<HH", data, 26, width, height)
    return bytes(data)


@pytest.mark.parametrize("name", ["jpeg", "progressive jpeg", "png", "16-bit png", "webp", "lossless webp"])
def test_sizes_that_lie(name: str) -> None:
    """They are refused by the header alone: a damaged or too large image, told with its size."""
    for width, height in ((9000, 9000), (16000, 16000), (16383, 1 << 13)):
        with pytest.raises(UndecodableError) as caught:
            decode_encoded(claiming(name, width, height))
        assert caught.value.reason == "image is too large"
    with pytest.raises(UndecodableError, match="too short for 8000x8000"):
        decode_encoded(claiming(name, 8000, 8000))


def test_kinds_that_are_refused() -> None:
    jpeg = file("jpeg")[0]
    animation = cv2.Animation()
    animation.frames, animation.durations = [picture(), picture()[::-1].copy()], np.array([40, 40])
    for suffix in (".png", ".webp", ".gif"):
        with pytest.raises(UndecodableError) as caught:
            decode_encoded(cv2.imencodeanimation(suffix, animation)[1].tobytes())
        assert caught.value.reason == "animated image is not readable"
    with pytest.raises(UndecodableError, match="file has several pages"):
        decode_encoded(cv2.imencodemulti(".tiff", [picture(), picture()])[1].tobytes())
    for data, reason in (
        (jpeg.replace(b"\xff\xc0", b"\xff\xc3", 1), "cut or damaged image"),  # lossless
        (jpeg.replace(b"\xff\xc0", b"\xff\xd9", 1), "cut or damaged image"),
        (b"\xff\xd8" + b"\xff" * 10**6, "cut or damaged image"),
        (encode(".tiff", np.zeros((4, 5), np.float32)), "its pixels are measured values of float32"),
        (b"", "no image file that is known"),
    ):
        with pytest.raises(UndecodableError) as caught:
            decode_encoded(data)
        assert caught.value.reason.startswith(reason)


@pytest.mark.parametrize("name", MADE)
def test_mutated_files(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    """Never more pixels than the bytes can hold, nothing but UndecodableError, and PNG never wrong without an error."""
    data, meant, _ = file(name)
    rng = np.random.default_rng(4)
    for _ in range(120):
        damaged = bytearray(data)
        start = int(rng.integers(len(data) if rng.random() < 0.5 else 60))
        noise = rng.bytes(int(rng.choice([1, 2, 8])))
        damaged[start : start + len(noise)] = noise
        try:
            image = decode_encoded(bytes(damaged))
        except UndecodableError:
            continue
        assert image.shape[0] * image.shape[1] <= 8256 * len(data) + (1 << 22)
        if "png" in name:
            np.testing.assert_array_equal(image, meant)
    capfd.readouterr()  # libjpeg's own words on damage
