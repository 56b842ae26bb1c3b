"""Everything about every frame, in a Rerun recording, a live viewer, or both."""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from airline.errors import AirLineError, ConfigError
from airline.image import to_uint8
from frontend.frame import Frame
from frontend.protocols import FrameResult
from viz.blueprint import Kind, layout
from viz.destination import Destination, open_stream
from viz.figures import TIMELINES, Clock, FigureLog, track_figures
from viz.lines import RIGHT, STEREO, Size, Space, TrackLog, picture_size, pinhole
from viz.rerun_private import jpeg, send_blueprint
from viz.stages import log_colours, log_descriptors, log_stages
from viz.video import VideoPackets, VideoReferences

WAITING = 4  # frames that may wait to be logged
PROPERTY = "airline"  # under which the facts of a run are found in a catalog
PACKAGES = ("airline", "frontend", "logs", "viz")
LEVELS = {logging.WARNING: "WARN", logging.ERROR: "ERROR", logging.CRITICAL: "CRITICAL"}

ImageMode = Literal["jpeg", "raw", "video", "none"]


class RerunSink:
    """Logs each frame's image, detector stages, tracks and figures; a `Sink`.

    Timelines are `frame` and `sensor_time`. Pictures are made in a thread, beside the next frame; what goes wrong there
    is raised by a later `write` or by `close`. A viewer that is absent, slow or dies costs one warning, never the run.
    Of a stereo pair also the right image, the lines' partners there, and with its calibration the lines in space.

    Args:
        application_id: the viewer keeps its layout per application.
        recording_id: files and streams with the same two ids are one recording; a new one by default.
        save: .rrd file to write; an existing one is replaced.
        connect: address of a running viewer, `HOST:PORT` or `rerun+http://HOST:PORT/proxy`.
        name: shown as the recording's name in the viewer.
        image: how the camera's image is logged; "video" logs the input file once, and no stages, tails or right image.
        video: that file, or the packets of a log's video.
        blueprint: how the viewer lays it out.
        every: log every so many frames; resets and warnings are always logged.
        descriptor_every: log the float descriptors every so many frames; 0 is never.
        jpeg_quality: of all pictures, 1 to 100.
        show_lost: draw lost lines for as long as they are looked for, not only in their first frames.
        layer: the entity of somebody's recording below which `tracks`, `tails` and `points` go, and nothing else of the
            above: no image, figures, log, poses, name or layout, nothing of a right image, and no tracks beyond those
            shown but for the blueprint "full".
        coordinate_frame: of the image that a layer lies on, where Rerun knows it by a name, as it does for logs.
        frame_timeline, time_timeline: names of the two timelines.
        properties: what is known of the run, by name, as the property "airline" of the recording.

    Raises:
        InputError: the file cannot be written.
        ConfigError: nowhere to log to, an address that is none, or a video that Rerun cannot play.
    """

    def __init__(
        self,
        application_id: str = "airline-frontend",
        *,
        save: str | os.PathLike[str] | None = None,
        connect: str | None = None,
        name: str | None = None,
        image: ImageMode = "jpeg",
        video: Path | VideoPackets | None = None,
        blueprint: Kind = "default",
        every: int = 1,
        descriptor_every: int = 30,
        jpeg_quality: int = 80,
        show_lost: bool = False,
        recording_id: str | None = None,
        layer: str | None = None,
        coordinate_frame: str | None = None,
        frame_timeline: str = TIMELINES[0],
        time_timeline: str = TIMELINES[1],
        properties: Mapping[str, Any] | None = None,
    ) -> None:
        if save is None and connect is None:
            raise ConfigError("the Rerun sink has nowhere to log to: give it a file to save or a viewer to connect to")
        if image == "video" and video is None and layer is None:
            raise ConfigError("to log the input as a video, name its file: use another kind of image otherwise")
        self._layer = layer is not None
        self._image: ImageMode = "none" if self._layer else image
        self._video: VideoReferences | VideoPackets | None = None
        if self._image == "video":
            self._video = video if isinstance(video, VideoPackets) else VideoReferences(Path(video or ""))
        self._stages = self._video is None and not self._layer
        self._blueprint = blueprint
        self._every = every
        self._descriptor_every = descriptor_every if self._stages else 0
        self._jpeg_quality = jpeg_quality
        self._frames = 0
        self._closed = False
        self._has_camera = False
        self._now: Frame | None = None
        self._worker = ThreadPoolExecutor(1, "rerun-sink")
        self._pending: deque[Future[None]] = deque()
        self._size: Size | None = None
        self._space: Space | None = None
        self._right = False
        self._baseline_m = 0.0

        self._stream = open_stream(application_id, recording_id, live=connect is not None, layer=self._layer)
        self._clock = Clock(self._stream, (frame_timeline, time_timeline))
        root = "/camera" if layer is None else f"/{layer.strip('/')}"
        self._tracks = TrackLog(
            self._stream,
            root,
            show_lost=show_lost,
            tails=self._stages or self._layer,
            rest=not self._layer or blueprint == "full",
            partners=not self._layer,
        )
        self._figures = FigureLog(self._stream)
        self._warnings = WarningLog(self.log)
        try:
            self._destination = Destination(self._stream, None if save is None else Path(save), connect)
        except AirLineError:
            self._warnings.close()
            raise
        if not self._destination.alive:
            self.close()
            return
        if properties:
            self._stream.send_property(PROPERTY, rr.AnyValues(**properties))
        if coordinate_frame is not None:
            for name in ("tracks", "tracks/rest", "tracks/lost", "tails", "points"):
                self._stream.log(f"{root}/{name}", rr.CoordinateFrame(coordinate_frame), static=True)
        if not self._layer:
            self._stream.send_recording_name(name or application_id)
        if self._stages:
            log_colours(self._stream)
        if self._video is not None:
            self._video.start(self._stream)

    def write(self, result: FrameResult) -> None:
        """Log one frame; waits when the thread is several frames behind.

        Raises:
            InputError: the file cannot be written any more.
            ConfigError: the frame cannot be shown by the video.
        """
        if self._closed:
            return
        self._destination.check()
        self._now = result.frame
        if self._size is None:
            self._size = picture_size(result.tracks, result.frame.image)
            self._right, camera = result.frame.right is not None, result.frame.camera
            if self._right and not self._layer and camera is not None and camera.baseline_m:
                if self._space is None:
                    self._space, self._baseline_m = Space(self._stream), camera.baseline_m
                self._set_time()
                self._space.move(STEREO)
            self._send_layout()
        if result.tracks.reset is not None:
            self.log(f"all tracks ended: {result.tracks.reset}", "WARN")
        if self._frames % self._every == 0:
            descriptor = self._descriptor_every > 0 and self._frames % self._descriptor_every == 0
            self._pending.append(self._worker.submit(self._log_frame, result, descriptor))
        self._frames += 1
        while len(self._pending) > WAITING or (self._pending and self._pending[0].done()):
            self._pending.popleft().result()

    def log(self, text: str, level: str = "INFO") -> None:
        """Add a line to the log at the time of the latest frame; levels: CRITICAL, ERROR, WARN, INFO, DEBUG, TRACE."""
        if not self._closed and not self._layer:
            self._set_time()
            self._stream.log("/log", rr.TextLog(text, level=level))

    def log_pose(self, world_T_camera: NDArray[np.floating]) -> None:
        """Log where the camera is, at the time of the latest frame.

        Args:
            world_T_camera: (4, 4) rigid motion from the camera's frame (x right, y down, z forward) to the world's,
                which is shown with y down, in the unit of the lines in space.

        Raises:
            InputError: it is no rigid motion.
        """
        if not self._closed and not self._layer:
            self._in_space().log_pose(world_T_camera)

    def log_lines_3d(self, segments: NDArray[np.floating], ids: NDArray[np.int64]) -> None:
        """Log (N, 2, 3) end points in the world's frame, in the colours of the (N,) int64 ids of their tracks.

        Raises:
            InputError: the two do not fit together.
        """
        if not self._closed and not self._layer:
            self._in_space().log_lines(segments, ids)

    def close(self) -> None:
        """Finish the file and let the viewer go; safe to call twice.

        Raises:
            InputError: the file is incomplete.
        """
        if self._closed:
            return
        self._closed = True
        try:
            for waiting in self._pending:
                waiting.result()
        finally:
            self._worker.shutdown(cancel_futures=True)
            if isinstance(self._video, VideoPackets):
                self._video.close()
            self._warnings.close()
            self._destination.close()

    def _set_time(self) -> None:
        if self._now is None:
            self._clock.begin()
        else:
            self._clock.set(self._now.index, self._now.stamp_ns)

    def _log_frame(self, result: FrameResult, descriptor: bool) -> None:
        """In the worker's thread, which has a time of its own."""
        frame, trace = result.frame, result.trace
        if self._video is not None:
            self._video.log(self._stream, self._clock, frame)
        self._clock.set(frame.index, frame.stamp_ns)
        if self._layer:
            self._tracks.write(result.tracks, picture_size(result.tracks, frame.image))
            return
        if frame.camera is not None and not self._has_camera:
            self._has_camera = True
            self._stream.log("/camera", pinhole(frame.camera), static=True)
        for root, image in (("/camera", frame.image), (RIGHT, frame.right)):
            if image is not None and self._image == "jpeg":
                self._stream.log(f"{root}/image", jpeg(to_uint8(image), self._jpeg_quality))
            elif image is not None and self._image == "raw":
                self._stream.log(f"{root}/image", rr.Image(image, "L" if image.ndim == 2 else "BGR"))
        if self._stages:
            log_stages(self._stream, result, self._jpeg_quality)
        if descriptor:
            log_descriptors(self._stream, trace)
        self._tracks.write(result.tracks, picture_size(result.tracks, frame.image))
        figures = track_figures(result.tracks)
        figures["counts"]["lines"] = len(trace.lines)
        self._figures.write({**figures, "time_ms": result.stage_ms})

    def _in_space(self) -> Space:
        if self._space is None or self._baseline_m:
            self._space, self._baseline_m = self._space or Space(self._stream), 0.0
            self._send_layout()  # anew, with a view of all the space
        self._set_time()
        return self._space

    def _send_layout(self) -> None:
        if self._layer:
            return
        has = {"space": self._space is not None, "image": self._image != "none", "stages": self._stages}
        shown = layout(self._blueprint, self._size, right=self._right, baseline_m=self._baseline_m, **has)
        send_blueprint(self._stream, shown)


class WarningLog(logging.Handler):
    """Hands every warning of our packages' loggers to `write`, from where it is raised until it is closed."""

    def __init__(self, write: Callable[[str, str], None]) -> None:
        super().__init__(logging.WARNING)
        self._write = write
        for package in PACKAGES:
            logging.getLogger(package).addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Pass a record on as its text and Rerun's name of its level."""
        if not logging.getLogger().handlers and logging.lastResort is not None:
            logging.lastResort.handle(record)  # Python's own way to stderr, which having a handler here would close
        self._write(record.getMessage(), LEVELS.get(record.levelno, "WARN"))

    def close(self) -> None:
        """Take no more; safe to call twice."""
        for package in PACKAGES:
            logging.getLogger(package).removeHandler(self)
        super().close()
