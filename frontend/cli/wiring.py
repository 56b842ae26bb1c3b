"""What the settings of a run stand for, source and sinks: the one file of `frontend` that knows `logs` and `viz`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from airline.errors import AirLineError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from frontend.cli.settings import RunConfig
    from frontend.protocols import Sink, Source
    from frontend.tracks import LineTracks


def open_input(spec: str | None, config: RunConfig) -> Source:
    """The frames that the input, the camera and the frame settings stand for."""
    from frontend.camera.undistort import with_camera
    from frontend.protocols import is_live
    from frontend.sources.selection import select_frames

    chosen = config.input
    camera = None
    if chosen.calib is not None:
        from frontend.camera.calibration import read_calibration

        camera = read_calibration(chosen.calib)
    opened = open_source_of(spec, config)
    try:
        selected = select_frames(
            with_camera(opened, camera, undistort=chosen.undistort),
            start_s=chosen.start,
            end_s=chosen.end,
            stride=chosen.stride,
            max_frames=chosen.max_frames,
            resize=chosen.size,
        )
    except AirLineError:
        opened.close()
        raise
    if not chosen.realtime or is_live(selected):
        return selected
    from frontend.sources.realtime import RealtimeSource

    return RealtimeSource(selected, ahead=spec is None)  # the built-in clip takes longer to render than to play


def open_source_of(spec: str | None, config: RunConfig) -> Source:
    """The input as it is: the built-in clip, a log, or whatever `open_source` takes."""
    from frontend.sources import open_source
    from logs.files import is_log

    if spec is None:
        from frontend.sources.scene import SceneSource

        return SceneSource()
    if is_log(spec):
        from logs import open_images

        return open_images(spec, config.input.topic, time_source=config.input.time_source)
    return open_source(spec, topic=config.input.topic, fps=config.input.fps, reconnect_s=config.input.reconnect)


def open_recording(
    save: Path | None, viewer: str | None, name: str, config: RunConfig, video: Path | None = None
) -> Sink:
    """The Rerun recording, into a file, a viewer or both."""
    from viz.rerun_sink import RerunSink

    chosen = config.recording
    return RerunSink(
        save=save,
        connect=viewer,
        name=name,
        image=chosen.image,
        video=video,
        blueprint=chosen.blueprint,
        every=chosen.every,
        descriptor_every=chosen.descriptor_every,
        jpeg_quality=chosen.jpeg_quality,
    )


def open_track_sink(spec: str, *, overwrite: bool = False, with_images: bool = False, labels: bool = False) -> Sink:
    """An output for tracked lines; see `logs.sinks.open`."""
    from logs.sinks.open import open_track_sink

    return open_track_sink(spec, overwrite=overwrite, with_images=with_images, labels=labels)


def read_tracks(path: Path) -> Iterator[LineTracks]:
    """Tracked lines out of a file; see `logs.read_tracks`."""
    from logs import read_tracks

    return read_tracks(path)
