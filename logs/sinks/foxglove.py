"""Tracked lines for Foxglove and Lichtblick, in an MCAP file, which can be read back too, and served live.

Foxglove draws annotations with (0, 0) at the corner of the top-left pixel, half a pixel from our origin; calibrations
follow OpenCV and ROS, whose origin is ours.
"""

from __future__ import annotations

import os
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import orjson
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from airline.errors import ConfigError, InputError, from_extra
from airline.image import to_uint8
from frontend.camera.model import CameraModel
from frontend.colours import track_colours
from frontend.protocols import FrameResult
from frontend.space import checked_lines, checked_pose
from frontend.tracks import LineTracks
from logs.sinks.open import Address, cannot_publish
from logs.sinks.output import McapOutput
from logs.tracks.json import CONVENTIONS, SCHEMA, SCHEMA_NAME, SECOND_NS, Camera, encode_tracks

ANNOTATIONS_TOPIC = "/lines/annotations"
RIGHT_ANNOTATIONS_TOPIC = "/lines/right/annotations"
DEPTH_TOPIC = "/lines/depth"
TRACKS_TOPIC = "/lines/tracks"
CALIBRATION_TOPIC = "/camera/calibration"
IMAGE_TOPIC = "/camera/image"
RIGHT_CALIBRATION_TOPIC = "/camera/right/calibration"
RIGHT_IMAGE_TOPIC = "/camera/right/image"
SPACE_TOPIC = "/lines/space"
TF_TOPIC = "/tf"
JPEG_QUALITY = 80
MESSAGES_WAITING = 64  # per viewer, about half a second of a camera; the server drops the oldest

_CLOSE_S = 1.0
_CORNER = 0.5
_FRAME_ID = "camera"
_RIGHT_ID = "camera_right"
_WORLD_ID = "world"
_THICKNESS = 2.0  # px
_FAINT = 0.4  # opacity of tentative tracks
_FONT_SIZE = 10.0
_MODELS = {"none": "plumb_bob", "equidistant": "kannala_brandt"}


class Topic(NamedTuple):
    """How the messages of a topic are encoded, and what says so."""

    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


def _protobuf(message: type[Message]) -> Topic:
    """The schema is the FileDescriptorSet of the message's file and of all that it imports, imports first."""
    files = FileDescriptorSet()
    seen: set[str] = set()

    def add(file: Any) -> None:  # a FileDescriptor, pure Python's or the C library's
        if file.name not in seen:
            seen.add(file.name)
            for imported in file.dependencies:
                add(imported)
            file.CopyToProto(files.file.add())

    add(message.DESCRIPTOR.file)
    return Topic("protobuf", message.DESCRIPTOR.full_name, "protobuf", files.SerializeToString())


TOPICS = {
    CALIBRATION_TOPIC: _protobuf(CameraCalibration),
    IMAGE_TOPIC: _protobuf(CompressedImage),
    ANNOTATIONS_TOPIC: _protobuf(ImageAnnotations),
    TRACKS_TOPIC: Topic("json", SCHEMA_NAME, "jsonschema", orjson.dumps(SCHEMA)),
}

RIGHT_TOPICS = {  # come with the first right image
    RIGHT_CALIBRATION_TOPIC: TOPICS[CALIBRATION_TOPIC],
    RIGHT_IMAGE_TOPIC: TOPICS[IMAGE_TOPIC],
    RIGHT_ANNOTATIONS_TOPIC: TOPICS[ANNOTATIONS_TOPIC],
    DEPTH_TOPIC: _protobuf(SceneUpdate),
}
SPACE_TOPICS = {SPACE_TOPIC: _protobuf(SceneUpdate), TF_TOPIC: _protobuf(FrameTransform)}


def message_for(topic: str, result: FrameResult, *, labels: bool, jpeg_quality: int = JPEG_QUALITY) -> bytes | None:
    """What a frame says on one of the `TOPICS` or `RIGHT_TOPICS`; None for what it has not."""
    if topic == TRACKS_TOPIC:
        return encode_tracks(result.tracks)
    message = _message_for(topic, result, labels, jpeg_quality)
    return None if message is None else message.SerializeToString()


def _has_right(result: FrameResult) -> bool:
    return result.frame.right is not None or len(result.tracks.right_hits) > 0


def _message_for(topic: str, result: FrameResult, labels: bool, jpeg_quality: int) -> Message | None:
    tracks, frame, camera = result.tracks, result.frame, result.tracks.camera
    if topic in RIGHT_TOPICS and not _has_right(result):
        return None
    if topic == ANNOTATIONS_TOPIC:
        return _annotations(tracks, labels)
    if topic == IMAGE_TOPIC:
        return _jpeg(frame.image, tracks.stamp_ns, _FRAME_ID, jpeg_quality)
    if topic == CALIBRATION_TOPIC:
        return None if camera is None else _calibration(camera, tracks.stamp_ns)
    if topic == RIGHT_IMAGE_TOPIC:
        return None if frame.right is None else _jpeg(frame.right, tracks.stamp_ns, _RIGHT_ID, jpeg_quality)
    if topic == RIGHT_CALIBRATION_TOPIC:
        return None if camera is None or not camera.baseline_m else _right_calibration(camera, tracks.stamp_ns)
    if topic == RIGHT_ANNOTATIONS_TOPIC:
        partners = tracks.take(np.flatnonzero(tracks.right_hits))
        return _annotations(replace(partners, segments_px=partners.right_px, point_ids=tracks.point_ids[:0]), labels)
    if tracks.segments_m is None:
        return None
    known = np.isfinite(tracks.segments_m).all((1, 2))
    return _lines_in_space(tracks.segments_m[known], tracks.ids[known], tracks.stamp_ns, _FRAME_ID)


def _annotations(tracks: LineTracks, labels: bool) -> ImageAnnotations:
    """The fused lines in the colours of their ids, tentative ones half transparent; and points, where there are any."""
    stamp = _timestamp(tracks.stamp_ns)
    message = ImageAnnotations(timestamp=stamp)
    lines = message.points.add(type=PointsAnnotation.LINE_LIST, thickness=_THICKNESS, timestamp=stamp)
    confirmed = tracks.confirmed
    points = tracks.segments_px.astype(np.float64) + _CORNER
    colours = np.ones((len(tracks), 4))
    colours[:, :3] = track_colours(tracks.ids) / 255
    colours[~confirmed, 3] = _FAINT
    for x, y in points.reshape(-1, 2).tolist():
        lines.points.add(x=x, y=y)
    for r, g, b, a in colours.tolist():
        lines.outline_colors.add(r=r, g=g, b=b, a=a)
    for k in np.flatnonzero(confirmed) if labels else ():
        text = message.texts.add(timestamp=stamp, text=str(tracks.ids[k]), font_size=_FONT_SIZE)
        text.position.x, text.position.y = points[k].mean(0).tolist()
        text.text_color.MergeFrom(lines.outline_colors[k])
        text.background_color.a = 0.5
    if len(tracks.point_ids):
        dots = message.points.add(type=PointsAnnotation.POINTS, thickness=_THICKNESS, timestamp=stamp)
        for x, y in (tracks.points_px.astype(np.float64) + _CORNER).tolist():
            dots.points.add(x=x, y=y)
        for r, g, b in (track_colours(tracks.point_ids) / 255).tolist():
            dots.outline_colors.add(r=r, g=g, b=b, a=1.0)
    return message


def _calibration(camera: CameraModel, stamp_ns: int) -> CameraCalibration:
    """The camera; one without distortion is a plumb_bob of zeros."""
    coefficients = [float(value) for value in camera.coefficients]
    model = _MODELS.get(camera.distortion) or ("plumb_bob" if len(coefficients) <= 5 else "rational_polynomial")
    if model == "plumb_bob":
        coefficients += [0.0] * (5 - len(coefficients))
    matrix = camera.matrix
    return CameraCalibration(
        timestamp=_timestamp(stamp_ns),
        frame_id=_FRAME_ID,
        width=camera.width,
        height=camera.height,
        distortion_model=model,
        D=coefficients,
        K=matrix.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.hstack([matrix, np.zeros((3, 1))]).ravel().tolist(),
    )


def _right_calibration(camera: CameraModel, stamp_ns: int) -> CameraCalibration:
    """The second camera of a rectified pair, P[3] = -fx baseline, as ROS has it."""
    message = _calibration(replace(camera, cx=camera.cx - camera.disparity_offset), stamp_ns)
    message.frame_id, message.P[3] = _RIGHT_ID, -camera.fx * camera.baseline_m
    return message


def _jpeg(image: NDArray[np.uint8] | NDArray[np.uint16], stamp_ns: int, frame_id: str, quality: int) -> CompressedImage:
    _, encoded = cv2.imencode(".jpg", to_uint8(image), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return CompressedImage(timestamp=_timestamp(stamp_ns), frame_id=frame_id, format="jpeg", data=encoded.tobytes())


def _timestamp(stamp_ns: int) -> Timestamp:
    seconds, nanos = divmod(int(stamp_ns), SECOND_NS)
    return Timestamp(seconds=seconds, nanos=nanos)


def _lines_in_space(
    segments: NDArray[np.floating], ids: NDArray[np.int64], stamp_ns: int, frame_id: str = _WORLD_ID
) -> SceneUpdate:
    """All lines as one entity, which stands for those of the update before."""
    update = SceneUpdate()
    entity = update.entities.add(id="lines", frame_id=frame_id, timestamp=_timestamp(stamp_ns))
    lines = entity.lines.add(type=LinePrimitive.LINE_LIST, thickness=_THICKNESS, scale_invariant=True)
    lines.pose.orientation.w = 1.0
    for x, y, z in checked_lines(segments, ids).reshape(-1, 3).tolist():
        lines.points.add(x=x, y=y, z=z)
    for r, g, b in (track_colours(ids).repeat(2, axis=0) / 255).tolist():
        lines.colors.add(r=r, g=g, b=b, a=1.0)
    return update


def _transform(world_T_camera: NDArray[np.floating], stamp_ns: int) -> FrameTransform:
    pose = checked_pose(world_T_camera)
    turn = cv2.Rodrigues(pose[:3, :3])[0].ravel()
    angle = float(np.linalg.norm(turn))
    x, y, z = turn * (np.sin(angle / 2) / angle if angle else 0.5)
    stamp = _timestamp(stamp_ns)
    message = FrameTransform(timestamp=stamp, parent_frame_id=_WORLD_ID, child_frame_id=_FRAME_ID)
    message.translation.x, message.translation.y, message.translation.z = pose[:3, 3].tolist()
    message.rotation.x, message.rotation.y, message.rotation.z, message.rotation.w = x, y, z, np.cos(angle / 2)
    return message


class McapTrackSink:
    """Writes each frame's tracks into an MCAP file that can be played while it grows; a `Sink`.

    | topic | schema | encoding |
    |---|---|---|
    | /lines/annotations | foxglove.ImageAnnotations | protobuf |
    | /lines/tracks | frontend.LineTracks, all fields | json |
    | /camera/calibration | foxglove.CameraCalibration, every second and when the camera changes | protobuf |
    | /camera/image | foxglove.CompressedImage, JPEG, on demand | protobuf |
    | /lines/right/annotations, /camera/right/... | the same of a right image: partners, calibration, image | protobuf |
    | /lines/depth | foxglove.SceneUpdate, lines in metres, in the frame "camera" | protobuf |
    | /lines/space | foxglove.SceneUpdate, by `log_lines_3d` | protobuf |
    | /tf | foxglove.FrameTransform, by `log_pose` | protobuf |

    All times of messages are the image's stamp, so that players lay lines and image over each other. The file's
    metadata record "airline-frontend" states the conventions.

    Args:
        path, overwrite: see `OutputFile`.
        with_images: write the images too.
        labels: write the id beside each confirmed line.
        jpeg_quality: 1 to 100, else a ConfigError.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        with_images: bool = False,
        labels: bool = False,
        overwrite: bool = False,
        jpeg_quality: int = JPEG_QUALITY,
    ) -> None:
        if not 1 <= jpeg_quality <= 100:
            raise ConfigError(f"JPEG quality is {jpeg_quality}: give 1 to 100")
        self._labels = labels
        self._quality = jpeg_quality
        topics = [topic for topic in TOPICS if with_images or topic != IMAGE_TOPIC]
        metadata = {
            **CONVENTIONS,
            **{f"topic of {topic.rpartition('/')[2]}": topic for topic in topics},
            "annotations": "shifted by half a pixel: Foxglove's (0, 0) is the corner of the top-left pixel",
        }
        self._output = McapOutput(Path(path), overwrite, metadata)
        self._topics = [*topics, *(topic for topic in RIGHT_TOPICS if with_images or topic != RIGHT_IMAGE_TOPIC)]
        self._channels = {topic: self._output.channel(topic, *TOPICS[topic]) for topic in topics}
        self._camera: CameraModel | None = None
        self._calibrated_ns: int | None = None
        self._now_ns: int | None = None

    def write(self, result: FrameResult) -> None:
        """Add one frame's tracks, and its image where asked for."""
        calibrate = self._calibration_is_due(result.tracks)
        self._now_ns = result.tracks.stamp_ns
        for topic in self._topics:
            if topic in (CALIBRATION_TOPIC, RIGHT_CALIBRATION_TOPIC) and not calibrate:
                continue
            data = message_for(topic, result, labels=self._labels, jpeg_quality=self._quality)
            if data is not None:
                self._output.write(self._channel(topic), result.tracks.stamp_ns, data)
        self._output.flush_when_due()

    def log_pose(self, world_T_camera: NDArray[np.floating]) -> None:
        """Write where the camera is, at the time of the latest frame: see `RerunSink.log_pose`."""
        self._write_space(TF_TOPIC, _transform(world_T_camera, self._now()))

    def log_lines_3d(self, segments: NDArray[np.floating], ids: NDArray[np.int64]) -> None:
        """Write lines in space in place of those before, with that time: see `RerunSink.log_lines_3d`."""
        self._write_space(SPACE_TOPIC, _lines_in_space(segments, ids, self._now()))

    def _now(self) -> int:
        if self._now_ns is None:
            raise InputError("what is in space has the time of a frame: write one first")
        return self._now_ns

    def _write_space(self, topic: str, message: Message) -> None:
        self._output.write(self._channel(topic), self._now(), message.SerializeToString())

    def _channel(self, topic: str) -> int:
        if topic not in self._channels:
            self._channels[topic] = self._output.channel(topic, *(RIGHT_TOPICS | SPACE_TOPICS)[topic])
        return self._channels[topic]

    def close(self) -> None:
        """Write the file's index; safe to call twice."""
        self._output.close()

    def _calibration_is_due(self, tracks: LineTracks) -> bool:
        """When the camera changes, and every second, so that players that seek need not look far back."""
        camera, before, self._camera = tracks.camera, self._camera, tracks.camera
        changed = camera is not before and Camera.of(camera) != Camera.of(before)
        due = changed or self._calibrated_ns is None or tracks.stamp_ns - self._calibrated_ns >= SECOND_NS
        if due and camera is not None:
            self._calibrated_ns = tracks.stamp_ns
        return due


class FoxgloveServer:
    """Serves each frame's tracks and image to viewers; a `Sink`.

    The topics and schemas are those of `McapTrackSink`, images included, but that the calibration comes with every
    frame: a viewer may come at any time. What no viewer looks at is not made. Nothing ever waits for a viewer.

    Arguments and errors are those of `open_publisher`; `address` is then where it can be reached, with the port found.
    """

    def __init__(self, address: Address, name: str, *, labels: bool = False) -> None:
        with from_extra("foxglove"):
            from foxglove import Channel, Context, Schema, start_server

        self._labels = labels
        self._closed = False
        context = self._context = Context()  # its channels end with it
        host = "0.0.0.0" if address.host == "*" else address.host
        try:
            self._server = start_server(
                name=name, host=host, port=address.port, context=context, message_backlog_size=MESSAGES_WAITING
            )
        except RuntimeError as error:  # FoxgloveError: Failed to bind port: Address already in use (os error 98)
            reason = str(error).rpartition(": ")[2].partition(" (os error")[0]
            raise cannot_publish(address, reason) from None
        self.address = str(Address("ws", address.host, self._server.port))

        def channel(name: str, topic: Topic) -> Any:
            schema = Schema(name=topic.schema_name, encoding=topic.schema_encoding, data=topic.schema)
            return Channel(name, schema=schema, message_encoding=topic.encoding, context=context)

        self._channel = channel
        self._channels = {name: channel(name, topic) for name, topic in TOPICS.items()}

    def write(self, result: FrameResult) -> None:
        """Send one frame's tracks and image."""
        stamp_ns = max(0, result.tracks.stamp_ns)  # viewers have no time before the epoch
        if _has_right(result) and len(self._channels) == len(TOPICS):
            self._channels |= {name: self._channel(name, topic) for name, topic in RIGHT_TOPICS.items()}
        for topic, channel in self._channels.items():
            if channel.has_sinks() and (data := message_for(topic, result, labels=self._labels)) is not None:
                channel.log(data, log_time=stamp_ns)

    def close(self) -> None:
        """Disconnect everybody; safe to call twice."""
        if not self._closed:
            self._closed = True
            stop = threading.Thread(target=self._server.stop, daemon=True)  # it waits for ever for a stuck viewer
            stop.start()
            stop.join(_CLOSE_S)
