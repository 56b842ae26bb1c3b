"""All that is taken from behind Rerun's public interface, in one file: look here first after an update of Rerun.

Columns are built from arrays without a copy, as Rerun's own conversion of lists and pictures costs milliseconds per
frame. And streams end: Rerun keeps every one that was ever opened, each with its threads and memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings
from numpy.typing import NDArray

CORNER = np.float32(0.5)  # Rerun puts (0, 0) at the corner of the top-left pixel, we put it at its centre

Batches = list[rr.DescribedComponentBatch]


def drop_closed_streams() -> None:
    """Let go of the streams that nobody holds any more."""
    rerun_bindings.flush_and_cleanup_orphaned_recordings()


def send_blueprint(stream: rr.RecordingStream, blueprint: rrb.Blueprint) -> None:
    """What `RecordingStream.send_blueprint` does, but the stream of the blueprint itself ends."""
    name = rr.get_application_id(stream) or ""
    native = rerun_bindings.new_blueprint(
        application_id=name, make_default=False, make_thread_default=False, default_enabled=True
    )
    own = rr.RecordingStream._from_native(native)
    own.set_time("blueprint", sequence=0)
    blueprint._log_to_stream(own)
    rerun_bindings.send_blueprint(own.memory_recording().storage, True, True, recording=stream.to_native())
    own.disconnect()


def strips_2d(points: NDArray[np.float32], lengths: NDArray[np.int_] | None = None) -> pa.ListArray:
    """Strips for `rr.LineStrips2D`, moved to Rerun's convention of pixels.

    Args:
        points: (N, 2, 2) float32 segments, px; or, with lengths, (sum of lengths, 2) points of all strips in a row.
        lengths: (N,) how many points each strip has.
    """
    offsets = np.arange(len(points) + 1) * 2 if lengths is None else np.concatenate([[0], np.cumsum(lengths)])
    return _strips(points + CORNER, offsets, rr.components.LineStrip2DBatch._ARROW_DATATYPE)


def strips_3d(segments: NDArray[np.float32]) -> pa.ListArray:
    """Strips for `rr.LineStrips3D` of (N, 2, 3) float32 segments."""
    return _strips(segments, np.arange(len(segments) + 1) * 2, rr.components.LineStrip3DBatch._ARROW_DATATYPE)


def _strips(points: NDArray[np.float32], offsets: NDArray[np.int_], kind: pa.DataType) -> pa.ListArray:
    values = pa.array(np.ascontiguousarray(points, np.float32).ravel())
    inner = pa.FixedSizeListArray.from_arrays(values, type=kind.value_type)
    return pa.ListArray.from_arrays(pa.array(offsets.astype(np.int32)), inner, type=kind)


def packed(rgb: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """(N,) uint32 colours as Rerun stores them, 0xRRGGBBAA, of (N, 3) uint8 RGB."""
    r, g, b = rgb.T.astype(np.uint32)
    colours: NDArray[np.uint32] = r << 24 | g << 16 | b << 8 | np.uint32(255)
    return colours


def jpeg(picture: NDArray[np.uint8], quality: int) -> Batches:
    """What to log for a grey or BGR picture, as a JPEG file of this quality."""
    _, encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return [_blob(encoded, rr.components.BlobBatch, rr.EncodedImage.descriptor_blob()), _media_type()]


def segmentation(classes: NDArray[np.uint8] | NDArray[np.uint16]) -> Batches:
    """What to log for an (H, W) picture of classes."""
    buffer = _blob(classes, rr.components.ImageBufferBatch, rr.SegmentationImage.descriptor_buffer())
    return [buffer, _format(*classes.shape, classes.dtype.str)]


def class_names(colours: NDArray[np.uint8], names: Sequence[str | None]) -> Batches:
    """What to log for the meaning of the classes 1 to N: (N, 3) uint8 RGB and names; class 0 is black."""
    numbers = [0x000000FF, *packed(colours).tolist()]
    classes = [
        {
            "class_id": k,
            "class_description": {
                "info": {"id": k, "label": name, "color": colour},
                "keypoint_annotations": [],
                "keypoint_connections": [],
            },
        }
        for k, (colour, name) in enumerate(zip(numbers, [None, *names], strict=True))
    ]
    batch = rr.components.AnnotationContextBatch
    context = batch(pa.array([classes], type=batch._ARROW_DATATYPE))
    return [context.described(rr.AnnotationContext.descriptor_context())]


def _blob(
    data: NDArray[np.generic],
    kind: type[rr.components.BlobBatch | rr.components.ImageBufferBatch],
    descriptor: rr.ComponentDescriptor,
) -> rr.DescribedComponentBatch:
    values = pa.Array.from_buffers(pa.uint8(), data.nbytes, [None, pa.py_buffer(np.ascontiguousarray(data))])
    offsets = pa.array([0, data.nbytes], pa.int32())
    return kind(pa.ListArray.from_arrays(offsets, values, type=kind._ARROW_DATATYPE)).described(descriptor)


@cache
def _media_type() -> rr.DescribedComponentBatch:
    return rr.components.MediaTypeBatch("image/jpeg").described(rr.EncodedImage.descriptor_media_type())


@cache
def _format(height: int, width: int, dtype: str) -> rr.DescribedComponentBatch:
    kind = rr.ChannelDatatype.from_np_dtype(np.dtype(dtype))
    pixels = rr.components.ImageFormat(width=width, height=height, channel_datatype=kind)
    return rr.components.ImageFormatBatch(pixels).described(rr.SegmentationImage.descriptor_format())
