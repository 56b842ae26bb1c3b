"""The camera of an image topic, as the log's own calibration messages have it.

Fields mean what ROS's sensor_msgs/CameraInfo documents; those of foxglove.CameraCalibration are the same.
"""

from __future__ import annotations

import logging
from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from itertools import islice, takewhile

from airline.errors import AirLineError, ConfigError, InputError
from frontend.camera.calibration import fit_camera, is_rectified
from frontend.camera.model import LARGEST, MAX_SIDE, CameraModel, lens
from frontend.camera.rig import rig_of_projection
from frontend.sources.reading import UndecodableError
from logs.files import LogFile
from logs.messages.readers import is_calibration_type, read_message
from logs.messages.types import CameraInfo
from logs.topics import printable

log = logging.getLogger(__name__)

_TRIED = 50  # messages of a calibration topic
_TRANSPORTS = frozenset({"compressed", "compressedDepth", "theora", "ffmpeg", "h264", "h265", "zstd", "draco"})


def camera_from_log(file: LogFile, image_topic: str, size: tuple[int, int]) -> CameraModel | None:
    """The camera of a topic's images of a size (width, height), px, by the log's calibration messages.

    None where the log has none for the topic, or one that cannot be used, with a warning.
    """
    topics = [name for name, topic in file.topics.items() if is_calibration_type(topic.type.schema_name)]
    topic = info_topic_for(image_topic, topics)
    info = _first_info(file, topic) if topic is not None else None
    try:
        return None if info is None else camera_of(info, size, is_rectified(image_topic))
    except AirLineError as error:
        log.warning("%s: the calibration on %s cannot be used: %s", file.name, printable(topic or ""), error)
        return None


def camera_of(info: CameraInfo, image_size: tuple[int, int], rectified: bool) -> CameraModel:
    """The camera that took the images a calibration message describes.

    Raw images are described by K and the distortion, rectified ones by P alone. Both refer to the full sensor: a region
    of interest moves the principal point, then binning scales the camera. A binned pixel is the mean of its block, so
    the principal point also moves from the centre of its first pixel to the block's; ROS's image_geometry leaves that
    out. A calibration for another `image_size` (width, height), px, with the same aspect is scaled.

    Raises:
        InputError: the camera is uncalibrated (ROS sends zeros then), its model is not supported, a number makes no
            sense, or the images have another aspect.
    """
    if not all(abs(number) <= LARGEST for number in (*info.d, *info.k, *info.r, *info.p)):  # NaN fails, too
        raise InputError("the calibration holds numbers that make no sense")
    fx, fy, cx, cy = _pinhole(info, rectified)
    width, height = info.width or image_size[0], info.height or image_size[1]
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise InputError(f"the calibration is for images of {width}x{height} px, which makes no sense")
    try:
        distortion = lens("none", ()) if rectified else lens(info.distortion_model, info.d)
        rig = rig_of_projection(info.p, () if rectified else info.r)
        camera = CameraModel(width, height, fx, fy, cx, cy, *distortion, rig_from_camera=rig)
    except ConfigError as error:
        raise InputError(str(error)) from None
    return fit_camera(_as_sent(camera, info), *image_size)


def info_topic_for(image_topic: str, calibration_topics: Collection[str]) -> str | None:
    """The calibration topic that belongs to an image topic; None where there is none, or it would be a guess.

    It is the one in the same namespace (`/cam/camera_info` for `/cam/image_raw/compressed`, `/cam/calibration` for
    `/cam/image`), or else in the nearest enclosing one except the root. The only calibration topic of a log is also
    taken from the root or from below the images' namespace. Of several in one namespace the name decides.
    """
    image = _parts(image_topic)
    if len(image) > 1 and image[-1] in _TRANSPORTS:
        image = image[:-1]
    spaces = {topic: _parts(topic)[:-1] for topic in calibration_topics if _parts(topic)}
    if len(spaces) == 1:
        ((topic, space),) = spaces.items()
        fits = image[: len(space)] == space or space[: len(image) - 1] == image[:-1]
        return topic if fits else None
    depths = {topic: len(space) for topic, space in spaces.items() if image[: len(space)] == space}
    depth = max(depths.values(), default=0)
    if not depths or (depth == 0 and len(image) > 1):
        return None
    nearest = [topic for topic in depths if depths[topic] == depth]
    return nearest[0] if len(nearest) == 1 else _by_name("".join(image[depth : depth + 1]), nearest)


def _first_info(file: LogFile, topic: str) -> CameraInfo | None:
    """The first readable message of a calibration topic."""
    for message in islice(file.messages(topic), _TRIED):
        with suppress(UndecodableError):
            record = read_message(message)
            if isinstance(record, CameraInfo):
                return record
    return None


def _pinhole(info: CameraInfo, rectified: bool) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of the full sensor."""
    name, matrix, columns = "K", info.k, 3
    if rectified and (any(info.p) or any(info.d)):  # a lens without distortion may come without P
        name, matrix, columns = "P", info.p, 4
    if len(matrix) != 3 * columns:
        raise InputError(f"the calibration has {len(matrix)} numbers where {name} has {3 * columns}")
    fx, skew, cx = matrix[:3]
    slant, fy, cy = matrix[columns : columns + 3]
    if not (fx and fy):
        raise InputError(f"the camera is uncalibrated: the focal length in {name} is zero")
    if skew or slant:
        raise InputError(f"the calibration's {name} has skew, which is not supported")
    return fx, fy, cx, cy


def _as_sent(camera: CameraModel, info: CameraInfo) -> CameraModel:
    """The camera of the region of interest, binned, in place of the full sensor's."""
    x, y, width, height = info.roi
    if any(info.roi):
        width, height = width or camera.width - x, height or camera.height - y
        if min(x, y) < 0 or min(width, height) < 1 or x + width > camera.width or y + height > camera.height:
            raise InputError("the calibration's region of interest lies outside of the sensor")
        camera = replace(camera, width=width, height=height, cx=camera.cx - x, cy=camera.cy - y)
    across, down = (max(1, binning) for binning in info.binning)
    if across == down == 1:
        return camera
    columns, rows = camera.width // across, camera.height // down
    if min(columns, rows) < 1:
        raise InputError("the calibration's binning leaves no pixel")
    return replace(camera, width=columns * across, height=rows * down).scaled(columns, rows)


def _by_name(image: str, topics: Collection[str]) -> str | None:
    """The topic of a namespace that shares most with the image's name: its first words, else "rect" or its absence."""

    def likeness(topic: str) -> tuple[int, bool, bool]:
        leaf = _parts(topic)[-1]
        words = zip(image.split("_"), leaf.split("_"), strict=False)
        shared = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], words))
        return shared, is_rectified(leaf) == is_rectified(image), leaf == "camera_info"

    best, second = sorted(topics, key=likeness, reverse=True)[:2]
    named = likeness(best)[0] > 0 or _parts(best)[-1].startswith("camera_info")
    return best if named and likeness(best) > likeness(second) else None


def _parts(topic: str) -> list[str]:
    return [part for part in topic.split("/") if part]
