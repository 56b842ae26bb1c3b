"""Tracked lines in an MCAP file, for Foxglove and Lichtblick and for reading back."""

from __future__ import annotations

import os
from pathlib import Path

import orjson
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from google.protobuf.message import Message

from airline.errors import ConfigError
from frontend.camera.model import CameraModel
from frontend.protocols import FrameResult
from frontend.tracks import LineTracks
from logs.sinks.foxglove import calibration, jpeg, line_annotations, schema_of
from logs.sinks.mcap_output import McapOutput
from logs.tracks.json import camera_fields, encode_tracks
from logs.tracks.schema import CONVENTIONS, SCHEMA, SCHEMA_NAME

ANNOTATIONS_TOPIC = "/lines/annotations"
TRACKS_TOPIC = "/lines/tracks"
CALIBRATION_TOPIC = "/camera/calibration"
IMAGE_TOPIC = "/camera/image"

_CALIBRATION_EVERY_NS = 1_000_000_000  # 250 bytes: players that seek or stream a part need not look far back


class McapTrackSink:
    """Writes each frame's tracks into an MCAP file that can be played while it grows; a `Sink`.

    | topic | schema | encoding |
    |---|---|---|
    | /lines/annotations | foxglove.ImageAnnotations | protobuf |
    | /lines/tracks | frontend.LineTracks, all fields | json |
    | /camera/calibration | foxglove.CameraCalibration, every second and when the camera changes | protobuf |
    | /camera/image | foxglove.CompressedImage, JPEG, on demand | protobuf |

    Log time, publish time and the messages' own times are the image's stamp, so that players lay lines and image over
    each other. The file's metadata record "airline-frontend" states the conventions.

    Args:
        path: the file.
        with_images: write the images too.
        labels: write the id beside each confirmed line.
        overwrite: replace an existing file.
        jpeg_quality: 1 to 100.

    Raises:
        InputError: the file exists or cannot be written.
        ConfigError: no such JPEG quality.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        with_images: bool = False,
        labels: bool = False,
        overwrite: bool = False,
        jpeg_quality: int = 80,
    ) -> None:
        if not 1 <= jpeg_quality <= 100:
            raise ConfigError(f"JPEG quality is {jpeg_quality}: give 1 to 100")
        self._labels = labels
        self._quality = jpeg_quality
        topics = {"annotations": ANNOTATIONS_TOPIC, "tracks": TRACKS_TOPIC, "calibration": CALIBRATION_TOPIC}
        if with_images:
            topics["image"] = IMAGE_TOPIC
        metadata = {
            **CONVENTIONS,
            **{f"topic of {name}": topic for name, topic in topics.items()},
            "annotations": "shifted by half a pixel: Foxglove's (0, 0) is the corner of the top-left pixel",
        }
        self._output = McapOutput(Path(path), {"airline-frontend": metadata}, overwrite=overwrite)
        schema = orjson.dumps(SCHEMA)
        self._tracks = self._output.channel(TRACKS_TOPIC, "json", SCHEMA_NAME, "jsonschema", schema)
        self._annotations = self._protobuf(ANNOTATIONS_TOPIC, ImageAnnotations)
        self._calibration = self._protobuf(CALIBRATION_TOPIC, CameraCalibration)
        self._image = self._protobuf(IMAGE_TOPIC, CompressedImage) if with_images else None
        self._camera: CameraModel | None = None
        self._calibrated_ns: int | None = None

    def write(self, result: FrameResult) -> None:
        """Add one frame's tracks, and its image where asked for."""
        tracks, stamp_ns = result.tracks, result.tracks.stamp_ns
        self._write_calibration(tracks)
        if self._image is not None:
            self._output.write(self._image, stamp_ns, jpeg(result.frame, self._quality).SerializeToString())
        drawn = line_annotations(tracks, labels=self._labels)
        self._output.write(self._annotations, stamp_ns, drawn.SerializeToString())
        self._output.write(self._tracks, stamp_ns, encode_tracks(tracks))
        self._output.flush_when_due()

    def close(self) -> None:
        """Write the file's index; safe to call twice."""
        self._output.close()

    def _protobuf(self, topic: str, message: type[Message]) -> int:
        return self._output.channel(topic, "protobuf", message.DESCRIPTOR.full_name, "protobuf", schema_of(message))

    def _write_calibration(self, tracks: LineTracks) -> None:
        camera, stamp_ns = tracks.camera, tracks.stamp_ns
        if camera is None:
            self._camera = None
            return
        changed = camera is not self._camera and camera_fields(camera) != camera_fields(self._camera)
        if changed or self._calibrated_ns is None or stamp_ns - self._calibrated_ns >= _CALIBRATION_EVERY_NS:
            self._output.write(self._calibration, stamp_ns, calibration(camera, stamp_ns).SerializeToString())
            self._calibrated_ns = stamp_ns
        self._camera = camera
