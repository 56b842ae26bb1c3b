"""Pictures as Rerun stores them, built without a copy: its own conversion takes longer than some take to make."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

Batch = rr.DescribedComponentBatch


def jpeg(picture: NDArray[np.uint8], quality: int) -> list[Batch]:
    """What to log for a grey or BGR picture, as a JPEG file of this quality."""
    _, encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return [_blob(encoded, rr.components.BlobBatch, rr.EncodedImage.descriptor_blob()), _media_type()]


def segmentation(classes: NDArray[np.uint8] | NDArray[np.uint16]) -> list[Batch]:
    """What to log for an (H, W) picture of classes."""
    buffer = _blob(classes, rr.components.ImageBufferBatch, rr.SegmentationImage.descriptor_buffer())
    return [buffer, _format(*classes.shape, classes.dtype.str)]


def _blob(
    data: NDArray[np.generic],
    kind: type[rr.components.BlobBatch | rr.components.ImageBufferBatch],
    descriptor: rr.ComponentDescriptor,
) -> Batch:
    values = pa.Array.from_buffers(pa.uint8(), data.nbytes, [None, pa.py_buffer(np.ascontiguousarray(data))])
    offsets = pa.array([0, data.nbytes], pa.int32())
    return kind(pa.ListArray.from_arrays(offsets, values, type=kind._ARROW_DATATYPE)).described(descriptor)


@cache
def _media_type() -> Batch:
    return rr.components.MediaTypeBatch("image/jpeg").described(rr.EncodedImage.descriptor_media_type())


@cache
def _format(height: int, width: int, dtype: str) -> Batch:
    kind = rr.ChannelDatatype.from_np_dtype(np.dtype(dtype))
    pixels = rr.components.ImageFormat(width=width, height=height, channel_datatype=kind)
    return rr.components.ImageFormatBatch(pixels).described(rr.SegmentationImage.descriptor_format())
