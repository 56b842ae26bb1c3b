"""Video files for tests."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import av
import cv2
import numpy as np


def write_video(path: Path, images: Iterable[np.ndarray], codec: str = "MJPG", fps: int = 30) -> Path:
    """A video of BGR images of one size."""
    first, *rest = images
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), fps, first.shape[1::-1])
    assert writer.isOpened()
    for image in (first, *rest):
        writer.write(image)
    writer.release()
    return path


def drawn(number: int) -> np.ndarray:
    """A textured picture, so that every frame has its share of bytes, with a bar that tells its number."""
    texture = np.random.default_rng(0).integers(0, 200, (24, 32, 3), np.uint8)
    image = cv2.resize(texture, (256, 120), interpolation=cv2.INTER_CUBIC)
    cv2.rectangle(image, (0, 50), (4 * number, 70), (255, 255, 255), -1)
    return image


def number_in(image: np.ndarray) -> int:
    """The number that `drawn` drew."""
    return round(np.count_nonzero(image[60].min(axis=-1) > 215) / 4)


def encode(
    path: Path,
    codec: str = "libx264",
    count: int = 40,
    *,
    pixels: str = "yuv420p",
    times_ms: list[int] | None = None,
    rotation: tuple[int, bool, bool] | None = None,
    container: dict[str, str] | None = None,
    **options: str,
) -> Path:
    """A video of the pictures `drawn`, 25 frames/s unless they have times.

    Args:
        rotation: degrees counterclockwise, mirrored left to right, upside down.
        container: FFmpeg's options of the container.
        options: FFmpeg's options of the codec.
    """
    if codec == "libx265":
        options = {"x265-params": "log-level=none:keyint=40", **options}
    with av.open(str(path), "w", options=container or {}) as file:
        stream: Any = file.add_stream(codec, rate=25, options=options)
        stream.height, stream.width = drawn(0).shape[:2]
        stream.pix_fmt = pixels
        unit = Fraction(1, 25 if times_ms is None else 1000)
        stream.codec_context.time_base = unit
        if rotation is not None:
            stream.set_display_rotation(rotation[0], hflip=rotation[1], vflip=rotation[2])
        for number in range(count):
            frame = av.VideoFrame.from_ndarray(drawn(number), format="bgr24").reformat(format=pixels)
            frame.pts, frame.time_base = number if times_ms is None else times_ms[number], unit
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    return path


def trim(source: Path, path: Path, begin_ms: int, **options: str) -> Path:
    """What is from a time on, without encoding it again, as `ffmpeg -ss ... -c copy` does."""
    with av.open(str(source)) as file, av.open(str(path), "w", options=options) as target:
        read = file.streams.video[0]
        written: Any = target.add_stream_from_template(read)
        begin = round(begin_ms / 1000 / read.time_base)
        for packet in file.demux(read):
            if packet.dts is not None:
                packet.pts, packet.dts, packet.stream = packet.pts - begin, packet.dts - begin, written
                target.mux(packet)
    return path


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The URL of a folder's files."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            """Keep the test's output clean."""

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder))) as server:
        thread = Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()
