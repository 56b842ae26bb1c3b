"""Pictures that carry their number through any codec, and streams and logs of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from tests.helpers.camera_logs import Channel, Logged, write_log
from tests.helpers.camera_messages import cdr, image_fields

SIZE = 256, 128
EPOCH_NS = 1_700_000_000 * 10**9 + 123_456_789
STEP_NS = 33_333_333
_BOX = 32  # px; each tells one bit


def numbered(number: int) -> np.ndarray:
    """A textured BGR picture that moves with its number and tells it in eight boxes, its colours those of one place."""
    texture = np.random.default_rng(0).integers(60, 200, (32, 64, 3), np.uint8)
    image = np.roll(cv2.resize(texture, SIZE, interpolation=cv2.INTER_CUBIC), 3 * number, axis=1)
    for bit in range(8):
        image[_BOX : 2 * _BOX, bit * _BOX : (bit + 1) * _BOX] = 255 * (number >> bit & 1)
    image[96:, :64] = (40, 80, 220)
    return np.ascontiguousarray(image)


def number_in(image: np.ndarray) -> int:
    """The number, which is -1 where the picture is not whole: a box is neither black nor white."""
    boxes = [image[_BOX + 8 : 2 * _BOX - 8, k * _BOX + 8 : (k + 1) * _BOX - 8].mean() for k in range(8)]
    return sum(1 << k for k, mean in enumerate(boxes) if mean > 127) if all(b < 50 or b > 205 for b in boxes) else -1


def difference(image: np.ndarray, number: int) -> float:
    """How far a colour picture is from what was drawn, as a mean."""
    return float(np.abs(image.astype(int) - numbered(number)).mean())


def encode(codec: str, count: int, **options: str) -> list[tuple[int, bytes]]:
    """Packets of a video of so many pictures in the order of decoding, each with its place in the order of display."""
    encoder: Any = av.CodecContext.create(codec, "w")
    encoder.width, encoder.height = SIZE
    encoder.pix_fmt, encoder.framerate, encoder.time_base = "yuv420p", Fraction(30), Fraction(1, 30)
    encoder.options = options
    packets = []
    for number in [*range(count), None]:
        frame = None
        if number is not None:
            frame = av.VideoFrame.from_ndarray(numbered(number), format="bgr24")
            frame.pts = number
        packets += encoder.encode(frame)
    return [(packet.pts, bytes(packet)) for packet in packets]


def x264(count: int, parameters: str = "") -> list[tuple[int, bytes]]:
    """H.264 with a key frame every 12 pictures."""
    parameters = f"keyint=12:min-keyint=12:scenecut=0:crf=8:{parameters}".rstrip(":")
    return encode("libx264", count, preset="veryfast", threads="1", **{"x264-params": parameters})


def x265(count: int, parameters: str = "") -> list[tuple[int, bytes]]:
    """H.265 with a key frame every 12 pictures."""
    common = "keyint=12:min-keyint=12:scenecut=0:crf=8:repeat-headers=1:log-level=none"
    return encode("libx265", count, preset="veryfast", **{"x265-params": f"{common}:{parameters}".rstrip(":")})


def stamp(number: int) -> int:
    return EPOCH_NS + number * STEP_NS


def compressed(data: bytes, stamp_ns: int, text: str) -> bytes:
    """A ROS 2 CompressedImage."""
    return cdr("CompressedImage", stamp_ns=stamp_ns, format=text, data=np.frombuffer(data, np.uint8))


def raw(image: np.ndarray, stamp_ns: int, encoding: str) -> bytes:
    """A ROS 2 Image."""
    height, width = image.shape[:2]
    fields = image_fields(image.tobytes(), width, height, encoding, image[0].nbytes)
    return cdr("Image", stamp_ns=stamp_ns, **fields)


def logged(messages: Iterable[bytes], times: Sequence[int] | None = None, kind: str = "CompressedImage") -> Channel:
    """A topic whose messages were logged at these times, else 5 ms after `stamp`."""
    data = list(messages)
    log_ns = [stamp(k) + 5_000_000 for k in range(len(data))] if times is None else times
    return Channel(f"sensor_msgs/msg/{kind}", "cdr", list(map(Logged, log_ns, data)))


def video_log(path: Path, packets: Sequence[tuple[int, bytes]], name: str, rising: bool) -> Path:
    """A log of a video, logged in file order; stamps rise in file order, or are presentation stamps."""
    stamps = [stamp(place if rising else shown) for place, (shown, _) in enumerate(packets)]
    messages = (compressed(data, at, name) for at, (_, data) in zip(stamps, packets, strict=True))
    return write_log(path, {"/camera": logged(messages)})
