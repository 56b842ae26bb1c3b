"""Tracked lines live in Foxglove and Lichtblick, over Foxglove's WebSocket protocol."""

from __future__ import annotations

import threading

import orjson
from foxglove import Channel, Context, Schema, start_server
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from google.protobuf.message import Message

from frontend.protocols import FrameResult
from logs.live.address import Address, cannot_publish
from logs.sinks.foxglove import calibration, jpeg, line_annotations, schema_of
from logs.sinks.mcap_tracks import ANNOTATIONS_TOPIC, CALIBRATION_TOPIC, IMAGE_TOPIC, TRACKS_TOPIC
from logs.tracks.json import encode_tracks
from logs.tracks.schema import SCHEMA, SCHEMA_NAME

MESSAGES_WAITING = 64  # per viewer, about half a second of a camera; the server drops the oldest
_JPEG_QUALITY = 80
_CLOSE_S = 1.0


class FoxgloveServer:
    """Serves each frame's tracks and image to viewers; a `Sink`.

    The topics and schemas are those of `McapTrackSink`, images included, but that the calibration comes with every
    frame: a viewer may come at any time. What no viewer looks at is not made. Nothing ever waits for a viewer.

    Args:
        address: of scheme "ws".
        name: of the input.
        labels: write the id beside each confirmed line.

    Attributes:
        address: where it can be reached, with the port that was found.

    Raises:
        InputError: the address is taken, or cannot be had.
    """

    def __init__(self, address: Address, name: str, *, labels: bool = False) -> None:
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

        def protobuf(topic: str, message: type[Message]) -> Channel:
            schema = Schema(name=message.DESCRIPTOR.full_name, encoding="protobuf", data=schema_of(message))
            return Channel(topic, schema=schema, message_encoding="protobuf", context=context)

        schema = Schema(name=SCHEMA_NAME, encoding="jsonschema", data=orjson.dumps(SCHEMA))
        self._tracks = Channel(TRACKS_TOPIC, schema=schema, message_encoding="json", context=context)
        self._annotations = protobuf(ANNOTATIONS_TOPIC, ImageAnnotations)
        self._calibration = protobuf(CALIBRATION_TOPIC, CameraCalibration)
        self._image = protobuf(IMAGE_TOPIC, CompressedImage)

    def write(self, result: FrameResult) -> None:
        """Send one frame's tracks and image."""
        tracks, camera = result.tracks, result.tracks.camera
        stamp_ns = max(0, tracks.stamp_ns)  # viewers have no time before the epoch
        if camera is not None and self._calibration.has_sinks():
            self._calibration.log(calibration(camera, stamp_ns).SerializeToString(), log_time=stamp_ns)
        if self._image.has_sinks():
            self._image.log(jpeg(result.frame, _JPEG_QUALITY).SerializeToString(), log_time=stamp_ns)
        if self._annotations.has_sinks():
            drawn = line_annotations(tracks, labels=self._labels)
            self._annotations.log(drawn.SerializeToString(), log_time=stamp_ns)
        if self._tracks.has_sinks():
            self._tracks.log(encode_tracks(tracks), log_time=stamp_ns)

    def close(self) -> None:
        """Disconnect everybody; safe to call twice."""
        if not self._closed:
            self._closed = True
            stop = threading.Thread(target=self._server.stop, daemon=True)  # it waits for ever for a stuck viewer
            stop.start()
            stop.join(_CLOSE_S)
