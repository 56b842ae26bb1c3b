"""What a message of a log says, whatever format it was written in."""

from __future__ import annotations

import re
from dataclasses import dataclass

from frontend.sources.reading import Bytes


@dataclass(frozen=True, slots=True)
class RawImage:
    """Uncompressed pixels.

    Attributes:
        stamp_ns: the message's own stamp, ns, as it is: it may be zero or nonsense.
        frame_id: name of the camera's coordinate frame.
        width, height: px, as claimed.
        encoding: ROS name such as "bgr8" or "bayer_rggb8".
        step: bytes from one row to the next.
        big_endian: byte order of 16-bit pixels.
        data: the pixels, a view into the message where possible.
    """

    stamp_ns: int
    frame_id: str
    width: int
    height: int
    encoding: str
    step: int
    big_endian: bool
    data: Bytes


@dataclass(frozen=True, slots=True)
class EncodedImage:
    """An image file: JPEG, PNG or WebP, told by its bytes."""

    stamp_ns: int
    frame_id: str
    data: Bytes


@dataclass(frozen=True, slots=True)
class VideoPacket:
    """One encoded frame of a video stream in Annex B form; `format` is "h264" or "h265"."""

    stamp_ns: int
    frame_id: str
    format: str
    data: Bytes


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """A camera calibration as messages carry it (sensor_msgs/CameraInfo, foxglove.CameraCalibration).

    Attributes:
        width, height: px, of the images the calibration was made with.
        distortion_model: name such as "plumb_bob"; may be empty.
        d: distortion coefficients.
        k: row-major 3x3 intrinsics.
        r: row-major 3x3 rectification.
        p: row-major 3x4 projection of the rectified image.
        binning: (x, y) pixels merged into one after calibration; 0 means 1.
        roi: (x_offset, y_offset, width, height) px of the part that was sent, before binning; zeros mean everything.
    """

    stamp_ns: int
    frame_id: str
    width: int
    height: int
    distortion_model: str
    d: tuple[float, ...]
    k: tuple[float, ...]
    r: tuple[float, ...]
    p: tuple[float, ...]
    binning: tuple[int, int] = (1, 1)
    roi: tuple[int, int, int, int] = (0, 0, 0, 0)


Record = RawImage | EncodedImage | VideoPacket | CameraInfo


def stamp_ns(seconds: int, nanoseconds: int) -> int:
    """The time in ns; 0, which means that there is none, where it does not fit into 64 bits."""
    stamp = seconds * 10**9 + nanoseconds
    return stamp if abs(stamp) < 2**63 else 0


def video_format(declared: str) -> str | None:
    """ "h264" or "h265" if the text names one of them, as in "h264", "video/hevc" or "H.265"."""
    name = declared.lower().replace(".", "")
    if re.search(r"h264|avc", name):
        return "h264"
    return "h265" if re.search(r"h265|hevc", name) else None


def sniffed_video_format(data: Bytes) -> str | None:
    """ "h264" or "h265" if the bytes begin with a start code, told apart by the first unit's header."""
    head = bytes(data[:6])
    start = head.find(b"\x00\x00\x01")
    if start not in (0, 1) or head[:start].strip(b"\x00") or len(head) < start + 5:
        return None
    first, second = head[start + 3], head[start + 4]
    # In H.265 with one spatial layer the first header byte is even, and the second is 1 to 7 (the temporal layer). In
    # H.264, even first bytes begin SEI (6), whose second byte is small as well, and PPS, whose second byte is large.
    return "h265" if first & 0x81 == 0 and first != 6 and 1 <= second <= 7 else "h264"


def is_key_frame(packet: VideoPacket) -> bool:
    """Whether decoding can begin with this packet: before its first picture, it has a key picture or parameter sets.

    H.264: IDR (5) or sequence parameter set (7). H.265: random access pictures (16 to 21), video or sequence parameter
    set (32, 33). ITU-T H.264 and H.265, table 7-1 of each and Annex B.
    """
    h264 = packet.format == "h264"
    for unit in re.finditer(b"\0\0\1(?=(.))", packet.data, re.DOTALL):
        kind = unit[1][0] & 31 if h264 else unit[1][0] >> 1 & 63
        if kind in ((5, 7) if h264 else (*range(16, 22), 32, 33)):
            return True
        if 1 <= kind < 5 if h264 else kind < 16:
            return False
    return False
