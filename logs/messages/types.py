"""What a message of a log says, whatever format it was written in."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from frontend.sources.reading import Bytes

_MOST_SEI = 32  # messages or units looked through in a packet


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
    """An image file: JPEG, PNG or WebP, told by its bytes.

    Attributes:
        stamp_ns, frame_id: as of `RawImage`.
        data: the file.
        encoding: ROS name of what its pixels are, where the file cannot say it: a Bayer mosaic, or depth.
    """

    stamp_ns: int
    frame_id: str
    data: Bytes
    encoding: str = ""


@dataclass(frozen=True, slots=True)
class VideoPacket:
    """One encoded frame of a video stream; `format` is "h264" or "h265" (in Annex B form), "vp9" or "av1"."""

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


BAYER = tuple(f"bayer_{order}{bits}" for order in ("rggb", "bggr", "gbrg", "grbg") for bits in (8, 16))
"""ROS names of mosaics, by their top-left four pixels in reading order."""

VIDEO_FORMATS = {"h264": "h264|avc", "h265": "h265|hevc", "vp9": "vp9|vp09", "av1": "av1|av01"}
"""Video that can be decoded, and patterns of its names."""

Record = RawImage | EncodedImage | VideoPacket | CameraInfo


UNKNOWN_FILE = "unknown image file"


def container(data: Bytes) -> str:
    """The kind of an image file, by its first bytes, for people."""
    head = bytes(data[:12])
    if head.startswith(b"\xff\xd8\xff"):
        return "JPEG"
    if head.startswith(b"\x89PNG"):
        return "PNG"
    return "WebP" if head[:4] == b"RIFF" and head[8:] == b"WEBP" else UNKNOWN_FILE


def stamp_ns(seconds: int, nanoseconds: int) -> int:
    """The time in ns; 0, which means that there is none, where it does not fit into 64 bits."""
    stamp = seconds * 10**9 + nanoseconds
    return stamp if abs(stamp) < 2**63 else 0


def video_format(declared: str) -> str | None:
    """One of `VIDEO_FORMATS` if the text names it, as in "h264", "video/hevc" or "H.265"."""
    name = declared.lower().replace(".", "")
    return next((kind for kind, names in VIDEO_FORMATS.items() if re.search(names, name)), None)


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

    H.264: IDR (5), sequence parameter set (7) or a recovery point, of which streams with intra refresh have no more.
    H.265: random access pictures (16 to 21), video or sequence parameter set (32, 33). ITU-T H.264 and H.265, table 7-1
    of each and Annex B. VP9: a key frame. AV1: a sequence header.
    """
    if packet.format == "vp9":
        return _is_vp9_key(packet.data)
    if packet.format == "av1":
        return _has_av1_sequence(packet.data)
    h264 = packet.format == "h264"
    for kind, place in units(packet):
        if kind in ((5, 7) if h264 else (*range(16, 22), 32, 33)) or (h264 and _is_recovery_point(packet.data, place)):
            return True
        if 1 <= kind < 5 if h264 else kind < 16:
            return False
    return False


def ends_the_past(packet: VideoPacket) -> bool:
    """Whether every picture before this packet is shown before it, and none behind it is predicted from one of those.

    H.264: IDR (5). H.265: IDR and broken links (16 to 20). Only with the picture's first slice.
    """
    h264 = packet.format == "h264"
    if packet.format not in ("h264", "h265"):
        return False
    for kind, place in units(packet):
        if kind == 5 if h264 else 16 <= kind <= 20:
            first = place + (1 if h264 else 2)
            return first < len(packet.data) and bool(packet.data[first] & 0x80)
        if 1 <= kind < 5 if h264 else kind < 16 or kind == 21:
            return False
    return False


def has_lengths(packet: VideoPacket) -> bool:
    """Whether an H.264 or H.265 packet has lengths in place of start codes (AVCC, HVCC)."""
    place = 0
    for _ in range(_MOST_SEI):
        if packet.format not in ("h264", "h265") or place + 4 >= len(packet.data):
            return False
        place += 4 + int.from_bytes(packet.data[place : place + 4], "big")
        if place == len(packet.data):
            return True
    return False


def has_picture(packet: VideoPacket) -> bool:
    """Whether there is more than parameter sets and the like in a packet."""
    if packet.format not in ("h264", "h265"):
        return True
    return any(1 <= kind <= 5 if packet.format == "h264" else kind < 32 for kind, _ in units(packet))


def has_only_parameters(packet: VideoPacket) -> bool:
    """Whether there are parameter sets in an H.264 or H.265 packet, and no picture."""
    sets = (7, 8) if packet.format == "h264" else (32, 33, 34)
    return not has_picture(packet) and any(kind in sets for kind, _ in units(packet))


def is_leading(packet: VideoPacket) -> bool:
    """Whether an H.265 packet's picture is predicted from ones before the key frame in front of it (8, 9)."""
    return packet.format == "h265" and next((kind for kind, _ in units(packet) if kind < 32), None) in (8, 9)


def is_b_picture(packet: VideoPacket) -> bool:
    """Whether an H.264 packet's first slice is of type B (1 or 6), behind the number 0 of its first block."""
    if packet.format != "h264":
        return False
    first = next((place for kind, place in units(packet) if 1 <= kind <= 5), len(packet.data)) + 1
    return first < len(packet.data) and (packet.data[first] >> 4 == 0b1010 or packet.data[first] >> 2 == 0b100111)


def units(packet: VideoPacket) -> Iterator[tuple[int, int]]:
    """Kind and place of the NAL units of an H.264 or H.265 packet."""
    for unit in re.finditer(b"\0\0\1(?=(.))", packet.data, re.DOTALL):
        yield (unit[1][0] & 31 if packet.format == "h264" else unit[1][0] >> 1 & 63), unit.end()


def _is_recovery_point(data: Bytes, place: int) -> bool:
    """Whether an H.264 unit is supplemental information (6) with a recovery point (6) in it."""
    if data[place] & 31 != 6:
        return False
    place += 1
    for _ in range(_MOST_SEI):
        numbers = []  # payload's type and size
        for _ in range(2):
            begin = place
            while place < len(data) and data[place] == 255:
                place += 1
            if place >= len(data):
                return False
            numbers.append(255 * (place - begin) + data[place])
            place += 1
        if numbers[0] == 6:
            return True
        place += numbers[1]
        if place >= len(data) or data[place] == 0x80:
            return False
    return False


def _is_vp9_key(data: Bytes) -> bool:
    if not data or data[0] >> 6 != 2:
        return False
    shift = 2 if data[0] >> 4 & 3 == 3 else 3  # the highest profile has one bit more
    return data[0] >> shift & 1 == 0 and data[0] >> (shift - 1) & 1 == 0


def _has_av1_sequence(data: Bytes) -> bool:
    """Whether a temporal unit has a sequence header (1) among its first units (AV1, 5.3 to 5.5)."""
    place = 0
    for _ in range(_MOST_SEI):
        if place >= len(data):
            return False
        head = data[place]
        if head >> 3 & 15 == 1:
            return True
        if not head & 2:  # it reaches to the end
            return False
        place += 2 if head & 4 else 1
        size = 0
        for k in range(8):
            if place >= len(data):
                return False
            size |= (data[place] & 127) << 7 * k
            place += 1
            if not data[place - 1] & 128:
                break
        place += size
    return False
