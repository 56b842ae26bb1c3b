"""What a message of a log says, whatever format it was written in."""

from __future__ import annotations

from dataclasses import dataclass

from airline.errors import InputError

Bytes = bytes | memoryview


class UndecodableError(InputError):
    """A message that cannot be used.

    Attributes:
        reason: what is wrong, the same words for every message with the same fault, so that they can be counted.
    """

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason


@dataclass(frozen=True, slots=True)
class RawImage:
    """Uncompressed pixels.

    Attributes:
        stamp_ns: the message's own stamp, ns, as it is: it may be zero or nonsense.
        frame_id: name of the camera's coordinate frame.
        width: px, as claimed.
        height: the same.
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
        width: px, of the images the calibration was made with.
        height: the same.
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
