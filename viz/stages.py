"""The stages of the detector in a Rerun recording: edges, orientations, regions and segments."""

from __future__ import annotations

import cv2
import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from airline.trace import Trace
from frontend.colours import track_colours
from frontend.protocols import FrameResult
from viz.colours import QUIET
from viz.pictures import coarse_descriptors, edge_image, orientation_image, region_image
from viz.strips import packed, strips_2d

STEP = 2  # stages are logged at half the resolution: their views are small, and their pictures most of a recording
CLASSES = 6765  # colours of ids come round: saturation (it is a multiple of 15) and hue (and a Fibonacci number)


def log_jpeg(
    stream: rr.RecordingStream,
    entity: str,
    picture: NDArray[np.uint8],
    quality: int,
    chroma: int = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
) -> None:
    """Log a grey or BGR picture. Thin coloured lines need full chroma; OpenCV encodes faster than `rr.Image`."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, chroma]
    _, encoded = cv2.imencode(".jpg", picture, options)
    stream.log(entity, rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg"))


def log_region_colours(stream: rr.RecordingStream) -> None:
    """Log, once, the colours of `/camera/regions`: those of the tracks that the lines belong to."""
    kind = rr.components.AnnotationContextBatch._ARROW_DATATYPE
    colours = [0x000000FF, *packed(track_colours(np.arange(CLASSES))).tolist()]
    classes = [
        {
            "class_id": k,
            "class_description": {
                "info": {"id": k, "label": None, "color": colour},
                "keypoint_annotations": [],
                "keypoint_connections": [],
            },
        }
        for k, colour in enumerate(colours)
    ]
    context = rr.components.AnnotationContextBatch(pa.array([classes], type=kind))
    stream.log("/camera/regions", [context.described(rr.AnnotationContext.descriptor_context())], static=True)


def region_classes(result: FrameResult) -> NDArray[np.uint16]:
    """(N,) uint16 class of each line's region: 1 + id of its track modulo CLASSES, 0 for a line without a track."""
    classes = np.zeros(len(result.trace.lines), np.uint16)
    classes[result.tracks.line_indices] = 1 + result.tracks.ids % CLASSES
    return classes


def log_stages(stream: rr.RecordingStream, result: FrameResult, quality: int) -> None:
    """Log edges, orientations and regions, at half the resolution, and the segments."""
    trace = result.trace
    log_jpeg(stream, "/camera/edges", edge_image(trace, STEP), quality)
    orientation = np.ascontiguousarray(orientation_image(trace, STEP)[:, :, ::-1])
    log_jpeg(stream, "/camera/orientation", orientation, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
    stream.log("/camera/regions", rr.SegmentationImage(region_image(trace, region_classes(result), STEP)))
    log_segments(stream, trace)


def log_segments(stream: rr.RecordingStream, trace: Trace) -> None:
    """Log the detected segments."""
    radius = rr.Radius.ui_points(0.75)
    stream.log("/camera/segments", rr.LineStrips2D(strips_2d(trace.lines.segments), colors=QUIET, radii=radius))


def log_descriptors(stream: rr.RecordingStream, trace: Trace) -> None:
    """Log the orientation descriptors as numbers, at a quarter of the resolution."""
    stream.log("/camera/descriptor", rr.Tensor(coarse_descriptors(trace), dim_names=("y", "x", "channel")))
