"""Everything about every frame, in a Rerun recording, a live viewer, or both."""

from __future__ import annotations

import logging
import socket
from pathlib import Path
from urllib.parse import urlsplit

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from airline.errors import ConfigError, InputError
from airline.image import to_uint8
from airline.trace import Trace
from frontend.camera import CameraModel
from frontend.frame import Frame
from frontend.protocols import FrameResult
from frontend.tracks import LineTracks
from viz.blueprint import layout
from viz.colours import QUIET, track_colours
from viz.pictures import coarse_descriptors, edge_image, orientation_image
from viz.viewer import PORT

FLUSH_S = 10  # how long a slow viewer may take to receive the rest of a run
YEAR_2000_NS = 946_684_800_000_000_000
CORNER = np.float32(0.5)  # Rerun puts (0, 0) at the corner of the top-left pixel, we put it at its centre

log = logging.getLogger(__name__)


class RerunSink:
    """Logs each frame's image, edges, orientations, segments, tracks and figures; a `Sink`.

    Timelines are `frame` and `sensor_time`. A viewer that is absent or dies costs one warning, never the run.

    Args:
        application_id: the viewer keeps its layout per application.
        save: .rrd file to write; an existing one is replaced.
        connect: address of a running viewer, `HOST:PORT` or `rerun+http://HOST:PORT/proxy`.
        name: shown as the recording's name in the viewer.
        descriptor_every: log the float descriptors, at a quarter of the resolution, every so many frames; 0 is never.
        jpeg_quality: of all pictures, 1 to 100.

    Raises:
        InputError: the file cannot be written.
        ConfigError: nowhere to log to, or an address that is none.
    """

    def __init__(
        self,
        application_id: str = "airline-frontend",
        *,
        save: Path | None = None,
        connect: str | None = None,
        name: str | None = None,
        descriptor_every: int = 30,
        jpeg_quality: int = 80,
    ) -> None:
        if save is None and connect is None:
            raise ConfigError("the Rerun sink has nowhere to log to: give it a file to save or a viewer to connect to")
        self._descriptor_every = descriptor_every
        self._jpeg_quality = jpeg_quality
        self._frames = 0
        self._closed = False
        self._has_camera = False
        self._epoch: bool | None = None

        self._stream = rr.RecordingStream(application_id)
        file = None if save is None else _file_sink(save)
        viewer = None if connect is None else _viewer_at(connect)
        sinks = [sink for sink in (file, viewer) if sink is not None]
        if not sinks:  # a stream without any sink would keep the whole run in memory
            self._closed = True
            return
        self._stream.set_sinks(*sinks)
        self._stream.send_blueprint(layout())
        self._stream.send_recording_name(name or application_id)
        self._stream.set_time("frame", sequence=0)

    def write(self, result: FrameResult) -> None:
        """Log one frame."""
        if self._closed:
            return
        self._set_time(result.frame)
        if result.frame.camera is not None and not self._has_camera:
            self._has_camera = True
            self._stream.log("/camera", _pinhole(result.frame.camera), static=True)
        self._log_pictures(result)
        if self._descriptor_every and self._frames % self._descriptor_every == 0:
            tensor = rr.Tensor(coarse_descriptors(result.trace), dim_names=("y", "x", "channel"))
            self._stream.log("/camera/descriptor", tensor)
        self._stream.log("/camera/segments", _segment_strips(result.trace))
        self._stream.log("/camera/tracks", *_track_strips(result.tracks))
        self._log_figures(result)
        if result.tracks.reset is not None:
            self.log(f"all tracks ended: {result.tracks.reset}", "WARN")
        self._frames += 1

    def log(self, text: str, level: str = "INFO") -> None:
        """Add a line to the log at the time of the latest frame; levels: CRITICAL, ERROR, WARN, INFO, DEBUG, TRACE."""
        if not self._closed:
            self._stream.log("/log", rr.TextLog(text, level=level))

    def close(self) -> None:
        """Finish the file and let the viewer go; safe to call twice."""
        if self._closed:
            return
        self._closed = True
        try:
            self._stream.flush(timeout_sec=FLUSH_S)
        except RuntimeError as reason:
            log.warning("the Rerun viewer did not receive everything: %s", reason)
        self._stream.disconnect()

    def _set_time(self, frame: Frame) -> None:
        self._stream.set_time("frame", sequence=frame.index)
        if self._epoch is None:  # a timeline cannot change its type within a recording
            self._epoch = frame.stamp_ns >= YEAR_2000_NS
        if self._epoch:
            self._stream.set_time("sensor_time", timestamp=np.datetime64(frame.stamp_ns, "ns"))
        else:
            self._stream.set_time("sensor_time", duration=np.timedelta64(frame.stamp_ns, "ns"))

    def _log_pictures(self, result: FrameResult) -> None:
        orientation = cv2.cvtColor(orientation_image(result.trace), cv2.COLOR_RGB2BGR)
        self._log_jpeg("image", to_uint8(result.frame.image))
        self._log_jpeg("edges", edge_image(result.trace))
        self._log_jpeg("orientation", np.asarray(orientation, np.uint8), cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)

    def _log_jpeg(
        self, name: str, picture: NDArray[np.uint8], chroma: int = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
    ) -> None:
        """Log a grey or BGR picture. Thin coloured lines need full chroma; OpenCV encodes faster than `rr.Image`."""
        options = [cv2.IMWRITE_JPEG_QUALITY, self._jpeg_quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, chroma]
        _, encoded = cv2.imencode(".jpg", picture, options)
        self._stream.log(f"/camera/{name}", rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg"))

    def _log_figures(self, result: FrameResult) -> None:
        confirmed = result.tracks.confirmed
        ages = result.tracks.ages[confirmed]
        figures = {
            "counts/lines": len(result.trace.lines),
            "counts/tracks": len(result.tracks),
            "counts/confirmed": int(confirmed.sum()),
            "track_length": float(np.median(ages)) if len(ages) else 0.0,
            **{f"time_ms/{stage}": ms for stage, ms in result.stage_ms.items()},
        }
        for path, value in figures.items():
            self._stream.log(f"/stats/{path}", rr.Scalars(float(value)))


def _pinhole(camera: CameraModel) -> rr.Pinhole:
    """Only the intrinsics: Rerun has no lens distortion."""
    return rr.Pinhole(
        focal_length=(camera.fx, camera.fy),
        principal_point=(camera.cx + 0.5, camera.cy + 0.5),
        width=camera.width,
        height=camera.height,
    )


def _segment_strips(trace: Trace) -> rr.LineStrips2D:
    return rr.LineStrips2D(trace.lines.segments + CORNER, colors=QUIET, radii=rr.Radius.ui_points(0.75))


def _track_strips(tracks: LineTracks) -> tuple[rr.LineStrips2D, rr.AnyValues]:
    radii = rr.Radius.ui_points(np.where(tracks.confirmed, 1.5, 0.75))
    colours = track_colours(tracks.ids, tracks.confirmed)
    strips = rr.LineStrips2D(tracks.segments_px + CORNER, colors=colours, radii=radii)
    return strips, rr.AnyValues(track_id=tracks.ids)


def _file_sink(path: Path) -> rr.FileSink:
    try:
        path.open("wb").close()
    except OSError as reason:
        raise InputError(
            f"cannot write the recording {path} ({reason.strerror}): choose a file in a folder you may write to"
        ) from reason
    return rr.FileSink(path)


def _viewer_at(address: str) -> rr.GrpcSink | None:
    """The viewer at HOST:PORT or a URL, if it answers."""
    url = address if "://" in address else f"rerun+http://{address}/proxy"
    try:
        sink = rr.GrpcSink(url)
        host, port = urlsplit(url).hostname, urlsplit(url).port
    except (RuntimeError, ValueError):
        host = port = None
    if host is None or port is None:
        raise ConfigError(f"'{address}' is no viewer address: write HOST:PORT, such as 127.0.0.1:{PORT}")
    try:  # connecting to nobody would block every flush for seconds
        socket.create_connection((host, port), timeout=2).close()
    except OSError as reason:
        log.warning("no Rerun viewer answers at %s (%s): going on without it", address, reason)
        return None
    return sink
