"""Tracks without a run: what a file with tracks holds, as a recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import cv2
import numpy as np
import rerun as rr

from frontend.tracks import LineTracks
from viz.space import pinhole
from viz.track_lines import Tails, log_tracks

YEAR_2000_NS = 946_684_800_000_000_000
DARK = 30  # grey level of the background where there are no images
SERIES = {"tracks": (255, 196, 64), "confirmed": (120, 220, 120), "lost": (150, 150, 150)}
MARGIN = 1.02  # how much larger than the lines of the first frame the background is, where the camera is unknown


class TrackRecorder:
    """Logs frames of tracks, with their images where these are known.

    Below the prefix: `/camera` (the pinhole, once), `/camera/image`, `/camera/tracks` with what is below it,
    `/camera/tails`, `/stats/counts/*`, `/stats/track_length` and `/log`. Timelines are `frame` and `sensor_time`.

    Args:
        stream: where to log to.
        prefix: of all entity paths.
    """

    def __init__(self, stream: rr.RecordingStream, prefix: str = "") -> None:
        self._stream = stream
        self._prefix = prefix
        self._tails = Tails()
        self._clock = Clock(stream)
        self._started = False
        self._has_camera = False

    def write(self, tracks: LineTracks, image: bytes | None = None) -> None:
        """Log one frame.

        Args:
            tracks: of the frame.
            image: an encoded JPEG or PNG.
        """
        self._clock.set(tracks.frame_index, tracks.stamp_ns)
        if not self._started:
            self._started = True
            for name, colour in SERIES.items():
                look = rr.SeriesLines(names=name, colors=colour, widths=1.5)
                self._stream.log(f"{self._prefix}/stats/counts/{name}", look, static=True)
            if image is None:
                self._stream.log(f"{self._prefix}/camera/image", dark(*size_of(tracks)), static=True)
        if tracks.camera is not None and not self._has_camera:
            self._has_camera = True
            self._stream.log(f"{self._prefix}/camera", pinhole(tracks.camera), static=True)
        if image is not None:
            self._stream.log(f"{self._prefix}/camera/image", encoded_image(image))
        log_tracks(self._stream, tracks, self._tails, root=f"{self._prefix}/camera")
        confirmed = tracks.confirmed
        ages = tracks.ages[confirmed]
        figures = {
            "counts/tracks": len(tracks),
            "counts/confirmed": int(confirmed.sum()),
            "counts/lost": len(tracks.lost_ids),
            "track_length": float(np.median(ages)) if len(ages) else 0.0,
        }
        for path, value in figures.items():
            self._stream.log(f"{self._prefix}/stats/{path}", rr.Scalars(float(value)))
        if tracks.reset is not None:
            self._stream.log(f"{self._prefix}/log", rr.TextLog(f"all tracks ended: {tracks.reset}", level="WARN"))


class Clock:
    """Sets the timelines `frame` and `sensor_time`: a date where stamps are since 1970, else a duration."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._dated: bool | None = None  # a timeline cannot change its type within a recording

    def set(self, frame: int, stamp_ns: int) -> None:
        """What is logged from now on belongs to this frame."""
        if self._dated is None:
            self._dated = stamp_ns >= YEAR_2000_NS
        self._stream.set_time("frame", sequence=frame)
        if self._dated:
            self._stream.set_time("sensor_time", timestamp=np.datetime64(stamp_ns, "ns"))
        else:
            self._stream.set_time("sensor_time", duration=np.timedelta64(stamp_ns, "ns"))


def paired(
    tracks: Iterable[LineTracks], images: Iterator[tuple[int, bytes]]
) -> Iterator[tuple[LineTracks, bytes | None]]:
    """Each frame with its image: that of the same stamp. Both are in time order."""
    image = next(images, None)
    for frame in tracks:
        while image is not None and image[0] < frame.stamp_ns:
            image = next(images, None)
        yield frame, image[1] if image is not None and image[0] == frame.stamp_ns else None


def size_of(tracks: LineTracks) -> tuple[int, int]:
    """Width and height of the image, px: the camera's, or else large enough for the lines."""
    if tracks.camera is not None:
        return tracks.camera.width, tracks.camera.height
    points = tracks.segments_px.reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return 640, 480
    width, height = np.clip(np.ceil(points.max(axis=0) * MARGIN), 16, 16384).astype(int).tolist()
    return width, height


def encoded_image(data: bytes) -> rr.EncodedImage:
    """A JPEG or PNG file."""
    return rr.EncodedImage(contents=data, media_type="image/jpeg" if data.startswith(b"\xff\xd8") else "image/png")


def dark(width: int, height: int) -> rr.EncodedImage:
    """A plain background for lines without an image."""
    _, encoded = cv2.imencode(".png", np.full((height, width), DARK, np.uint8))
    return rr.EncodedImage(contents=encoded.tobytes(), media_type="image/png")
