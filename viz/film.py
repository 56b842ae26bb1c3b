"""Pictures into a video file."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError

QUALITY = 20  # H.264's constant rate factor: thin coloured lines stay clear


def write_film(path: Path, pictures: Iterable[NDArray[np.uint8]], fps: float) -> int:
    """Write an .mp4: H.264, or MPEG-4 where FFmpeg came without x264.

    Args:
        path: the file, which is replaced.
        pictures: (H, W, 3) uint8 BGR, all of one size; an odd last row or column is doubled, as video needs even sizes.
        fps: frames per second.

    Returns:
        How many frames it has.

    Raises:
        InputError: the file cannot be written.
    """
    import av

    codec, options = ("libx264", {"crf": str(QUALITY)}) if "libx264" in av.codecs_available else ("mpeg4", {"q": "3"})
    rate = Fraction(fps).limit_denominator(1001)
    count = 0
    try:
        with av.open(str(path), "w", format="mp4") as file:
            stream = file.add_stream(codec, rate=rate, options=options)
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
