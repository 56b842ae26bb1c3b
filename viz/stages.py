"""The stages of the detector in a Rerun recording: edges, orientations, regions and segments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from airline.trace import Trace
from frontend.colours import CYCLE, track_colours
from frontend.protocols import FrameResult
from viz.blobs import jpeg, segmentation
from viz.colours import ANGLES, QUIET, STRENGTHS, orientation_palette
from viz.pictures import coarse_descriptors, edge_image, orientation_classes, region_image
from viz.strips import packed, strips_2d

# In a corner of every picture of regions: the viewer maps 16-bit classes to colours by the largest of the first one.
LARGEST = CYCLE + 1
STEP = 2  # stages are logged at half the resolution: their views are small, and their pictures most of a recording


def log_colours(stream: rr.RecordingStream) -> None:
    """Log, once, what the numbers in `/camera/orientation` and `/camera/regions` stand for.

    Orientations say angle and edge probability when the mouse is over them; regions have the colours of the tracks that
    the lines belong to.
    """
    angle, strength = np.divmod(np.arange(ANGLES * STRENGTHS), STRENGTHS)
    names = [f"{180 * a // ANGLES}°, {100 * s // STRENGTHS} % and more" for a, s in zip(angle, strength, strict=True)]
    _log_classes(stream, "/camera/orientation", orientation_palette()[1:], names)
    regions = np.concatenate([track_colours(np.arange(CYCLE)), np.zeros((1, 3), np.uint8)])
    _log_classes(stream, "/camera/regions", regions, [None] * len(regions))


def _log_classes(
    stream: rr.RecordingStream, entity: str, colours: NDArray[np.uint8], names: Sequence[str | None]
) -> None:
    kind = rr.components.AnnotationContextBatch._ARROW_DATATYPE
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
    context = rr.components.AnnotationContextBatch(pa.array([classes], type=kind))
    stream.log(entity, [context.described(rr.AnnotationContext.descriptor_context())], static=True)


def region_classes(result: FrameResult) -> NDArray[np.uint16]:
    """(N,) uint16 class of each line's region: 1 + id of its track modulo CYCLE, 0 for a line without a track."""
    classes = np.zeros(len(result.trace.lines), np.uint16)
    classes[result.tracks.line_indices] = 1 + result.tracks.ids % CYCLE
    return classes


def log_stages(stream: rr.RecordingStream, result: FrameResult, quality: int) -> None:
    """Log edges, orientations and regions, at half the resolution, and the segments."""
    trace = result.trace
    stream.log("/camera/edges", jpeg(edge_image(trace, STEP), quality))
    stream.log("/camera/orientation", segmentation(orientation_classes(trace, STEP)))
    regions = region_image(trace, region_classes(result), STEP)
    regions[0, 0] = LARGEST
    stream.log("/camera/regions", segmentation(regions))
    log_segments(stream, trace)


def log_segments(stream: rr.RecordingStream, trace: Trace) -> None:
    """Log the detected segments."""
    radius = rr.Radius.ui_points(0.75)
    stream.log("/camera/segments", rr.LineStrips2D(strips_2d(trace.lines.segments), colors=QUIET, radii=radius))


def log_descriptors(stream: rr.RecordingStream, trace: Trace) -> None:
    """Log the orientation descriptors as numbers, at a quarter of the resolution."""
    stream.log("/camera/descriptor", rr.Tensor(coarse_descriptors(trace), dim_names=("y", "x", "channel")))
