"""The camera of an image topic, as the log itself knows it."""

from __future__ import annotations

import logging
from itertools import islice

from airline.errors import AirLineError
from frontend.camera.model import CameraModel
from logs.calibration import camera_of, info_topic_for, is_rectified
from logs.files.types import LogFile
from logs.messages.registry import is_calibration_type, reader_for
from logs.messages.types import CameraInfo, UndecodableError
from logs.topics import printable

log = logging.getLogger(__name__)

_TRIED = 50  # messages of the calibration topic


def camera_from_log(file: LogFile, image_topic: str, size: tuple[int, int]) -> CameraModel | None:
    """The camera that a log's calibration messages give for the images of a topic.

    Args:
        file: the log.
        image_topic: name of the topic.
        size: width and height of its images, px.

    Returns:
        None where the log has no calibration for the topic, or one that cannot be used, with a warning.
    """
    kinds = {name: topic.type for name, topic in file.topics.items() if is_calibration_type(topic.type.schema_name)}
    topic = info_topic_for(image_topic, list(kinds)) if kinds else None
    info = first_info(file, topic) if topic is not None else None
    if info is None:
        return None
    try:
        camera = camera_of(info, size, is_rectified(image_topic))
    except AirLineError as error:
        log.warning("%s: the calibration on %s cannot be used: %s", file.name, printable(topic or ""), error)
        return None
    return camera


def first_info(file: LogFile, topic: str) -> CameraInfo | None:
    """The first readable message of a calibration topic."""
    for message in islice(file.messages(topic), _TRIED):
        read = reader_for(message.type.schema_name, message.type.encoding)
        try:
            record = read(message.data) if read else None
        except UndecodableError as error:
            log.debug("%s: a message on %s: %s", file.name, topic, error)
            continue
        if isinstance(record, CameraInfo):
            return record
    return None
