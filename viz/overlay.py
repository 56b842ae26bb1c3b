"""Lines drawn into images with OpenCV, without any viewer, and what is drawn written into files."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError
from airline.image import to_gray, to_uint8
from frontend.colours import track_colours

if TYPE_CHECKING:
    from frontend.matching import LineMatches
    from frontend.sources.reading import Image
    from viz.recording import RecordedFrame

SHIFT = 4  # fractional bits of OpenCV's sub-pixel coordinates
FAR = 1e6  # px; what lies farther out is no line in the picture
FILM_QUALITY = "20"  # H.264's constant rate factor: thin coloured lines stay clear
JPEG_QUALITY = 85
ALONE = 150  # grey of lines without a partner
GUTTER = 8  # px beside each of two images

Picture = NDArray[np.uint8]


def draw_lines(
    canvas: Picture, lines: Iterable[NDArray[np.float32]], colours: NDArray[np.uint8], widths: NDArray[np.int_] | int
) -> None:
    """Draw N polylines (P, 2) into a BGR picture, thin ones first, with (N, 3) RGB and (N,) widths, px, or one."""
    points = list(lines)
    widths = np.broadcast_to(widths, len(points))
    for k in np.argsort(widths, kind="stable").tolist():
        if (np.abs(points[k]) < FAR).all():  # which NaN is not
            fixed = np.rint(points[k] * (1 << SHIFT)).astype(np.int32)
            cv2.polylines(canvas, [fixed], False, colours[k, ::-1].tolist(), int(widths[k]), cv2.LINE_AA, SHIFT)


def draw_frame(frame: RecordedFrame) -> Picture:
    """A recorded frame's image with its lines, BGR, in the colours of the recording; two of them stand side by side."""
    panels = []
    for image, layers in zip(frame.images, frame.panels, strict=True):
        canvas = image.copy()
        for strips in layers:
            draw_lines(canvas, strips.points, strips.colours, strips.widths)
        panels.append(canvas)
    return np.hstack(panels)


def draw_pairs(images: tuple[Image, Image], matches: LineMatches) -> Picture:
    """Two images beside each other, BGR and dark, with their lines: pairs in one colour, others thin and grey."""
    panels = [cv2.cvtColor(to_uint8(to_gray(image)) // 2, cv2.COLOR_GRAY2BGR) for image in images]
    for canvas, lines, rows in zip(panels, (matches.first, matches.second), matches.pairs.T, strict=True):
        alone = np.delete(lines.segments, rows, axis=0)
        draw_lines(canvas, alone, np.full((len(alone), 3), ALONE, np.uint8), 1)
        draw_lines(canvas, lines.segments[rows], track_colours(np.arange(len(rows))), 2)
    height = max(len(canvas) for canvas in panels)
    return np.hstack([np.pad(canvas, ((0, height - len(canvas)), (0, GUTTER), (0, 0))) for canvas in panels])


def write_picture(path: Path, picture: Picture) -> None:
    """Write a .png or .jpg file; InputError where that cannot be."""
    quality = [] if path.suffix.lower() == ".png" else [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    try:
        written = cv2.imwrite(str(path), picture, quality)
    except cv2.error:  # an ending that OpenCV does not know
        written = False
    if not written:
        raise InputError(f"cannot write {path}: give a .png or .jpg file in a folder you may write to")


def write_film(path: Path, pictures: Iterable[Picture], fps: float) -> int:
    """Write a film, H.264 or MPEG-4 where FFmpeg came without x264, over what is there; returns how many frames it has.

    Args:
        path: the file.
        pictures: (H, W, 3) uint8 BGR, all of one size; an odd last row or column is doubled, as video needs even sizes.
        fps: frames per second.

    Raises:
        InputError: the file cannot be written.
    """
    import av  # FFmpeg takes time to import

    has_x264 = "libx264" in av.codecs_available
    codec, options = ("libx264", {"crf": FILM_QUALITY}) if has_x264 else ("mpeg4", {"q": "3"})
    count = 0
    try:
        with av.open(str(path), "w") as file:
            stream = file.add_stream(codec, rate=Fraction(fps).limit_denominator(1001), options=options)
            assert isinstance(stream, av.VideoStream)
            stream.pix_fmt = "yuv420p"
            for picture in pictures:
                even = np.pad(picture, ((0, picture.shape[0] % 2), (0, picture.shape[1] % 2), (0, 0)), mode="edge")
                if not count:
                    stream.height, stream.width = even.shape[:2]
                file.mux(stream.encode(av.VideoFrame.from_ndarray(even, format="bgr24")))
                count += 1
            file.mux(stream.encode())
    except OSError as reason:
        raise InputError(f"cannot write the film {path} ({reason.strerror}): choose another file") from reason
    return count
