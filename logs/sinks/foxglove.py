"""What Foxglove and Lichtblick show: messages of Foxglove's schemas, in protobuf.

Foxglove draws annotations with (0, 0) at the corner of the top-left pixel, half a pixel from our origin; calibrations
follow OpenCV and ROS, whose origin is ours.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from airline.image import to_uint8
from frontend.camera.model import CameraModel
from frontend.colours import track_colours
from frontend.frame import Frame
from frontend.tracks import LineTracks

FRAME_ID = "camera"
CORNER = 0.5

_SECOND_NS = 1_000_000_000
_THICKNESS = 2.0  # px
_FAINT = 0.4  # opacity of tentative tracks
_FONT_SIZE = 10.0
_MODELS = {"none": "plumb_bob", "equidistant": "kannala_brandt"}


def schema_of(message: type[Message]) -> bytes:
    """The serialised FileDescriptorSet of a message's file and of all that it imports, imports first."""
    files = FileDescriptorSet()
    seen: set[str] = set()

    def add(file: Any) -> None:  # a FileDescriptor, pure Python's or the C library's
        if file.name not in seen:
            seen.add(file.name)
            for imported in file.dependencies:
                add(imported)
            file.CopyToProto(files.file.add())

    add(message.DESCRIPTOR.file)
    return files.SerializeToString()


def line_annotations(tracks: LineTracks, *, labels: bool) -> ImageAnnotations:
    """The fused lines in the colours of their ids, tentative ones paler and half transparent.

    Args:
        tracks: of one frame.
        labels: write the id beside every confirmed line.
    """
    stamp = timestamp(tracks.stamp_ns)
    message = ImageAnnotations(timestamp=stamp)
    lines = message.points.add(type=PointsAnnotation.LINE_LIST, thickness=_THICKNESS, timestamp=stamp)
    confirmed = tracks.confirmed
    points = tracks.segments_px.astype(np.float64) + CORNER
    colours = np.ones((len(tracks), 4))
    colours[:, :3] = track_colours(tracks.ids, confirmed) / 255
    colours[~confirmed, 3] = _FAINT
    for x, y in points.reshape(-1, 2).tolist():
        lines.points.add(x=x, y=y)
    for r, g, b, a in colours.tolist():
        lines.outline_colors.add(r=r, g=g, b=b, a=a)
    if labels:
        for k in np.flatnonzero(confirmed):
            text = message.texts.add(timestamp=stamp, text=str(tracks.ids[k]), font_size=_FONT_SIZE)
            text.position.x, text.position.y = points[k].mean(0).tolist()
            text.text_color.MergeFrom(lines.outline_colors[k])
            text.background_color.a = 0.5
    return message


def calibration(camera: CameraModel, stamp_ns: int) -> CameraCalibration:
    """The camera; a camera without distortion is a plumb_bob of zeros."""
    coefficients = [float(value) for value in camera.coefficients]
    model = _MODELS.get(camera.distortion) or ("plumb_bob" if len(coefficients) <= 5 else "rational_polynomial")
    if model == "plumb_bob":
        coefficients += [0.0] * (5 - len(coefficients))
    matrix = camera.matrix
    return CameraCalibration(
        timestamp=timestamp(stamp_ns),
        frame_id=FRAME_ID,
        width=camera.width,
        height=camera.height,
        distortion_model=model,
        D=coefficients,
        K=matrix.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.hstack([matrix, np.zeros((3, 1))]).ravel().tolist(),
    )


def jpeg(frame: Frame, quality: int) -> CompressedImage:
    """The image, 16 bits reduced to 8."""
    _, encoded = cv2.imencode(".jpg", to_uint8(frame.image), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return CompressedImage(
        timestamp=timestamp(frame.stamp_ns), frame_id=FRAME_ID, format="jpeg", data=encoded.tobytes()
    )


def timestamp(stamp_ns: int) -> Timestamp:
    """Protobuf's time."""
    seconds, nanos = divmod(int(stamp_ns), _SECOND_NS)
    return Timestamp(seconds=seconds, nanos=nanos)
