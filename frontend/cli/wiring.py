"""What flags and settings stand for: source, sinks, viewers. The one file of `frontend` that knows `logs` and `viz`."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airline.errors import ConfigError, InputError
from frontend.cli.settings import NO_CALIBRATION

if TYPE_CHECKING:
    import argparse

    from frontend.camera.calibration import Calibration
    from frontend.cli.settings import InputConfig, RunConfig
    from frontend.matching import LineMatches
    from frontend.protocols import Sink, Source
    from frontend.sources.reading import Image
    from frontend.tracks import LineTracks
    from logs.sinks.foxglove import FoxgloveServer
    from logs.sinks.zeromq import ZmqPublisher
    from viz.video import VideoPackets
    from viz.viewer import WebViewer

PROBED = 128  # packets of a video in which B-frames are looked for

log = logging.getLogger(__name__)


def open_input(spec: str | None, config: RunConfig) -> Source:
    """The frames that an input stands for, as the settings want them; in series nothing is dropped of a live source.

    Args:
        spec: a log, or whatever `frontend.open_source` takes; None for the built-in clip.
        config: the settings.
    """
    from frontend.sources import kinds
    from frontend.sources.pace import FreshFrames, RealtimeSource
    from frontend.sources.wrapped import SelectedFrames

    chosen = config.input
    spec = None if spec is None else kinds.local_name(spec)
    source: Source
    if chosen.pairs:
        source = _open_pairs(spec, chosen)
    else:
        calibration = None
        if chosen.calib_file is not None:
            from frontend.camera.calibration import read_calibration

            calibration = read_calibration(chosen.calib_file, spec)
        source = _open_one(spec, chosen.topic, chosen, calibration)
    source = SelectedFrames(
        source,
        start_s=chosen.start,
        end_s=chosen.end,
        stride=chosen.stride,
        max_frames=chosen.max_frames,
        resize=chosen.size,
    )
    if chosen.realtime and not source.live:
        source = RealtimeSource(source)
    if not source.live or config.serial:
        return source
    return FreshFrames(source, chosen.max_latency, prepares=True)


def _open_one(spec: str | None, topic: str | None, chosen: InputConfig, calibration: Calibration | None) -> Source:
    """The frames of one camera."""
    from frontend.sources import open_source
    from frontend.sources.wrapped import CalibratedFrames, UncalibratedFrames
    from logs.files import is_log

    source: Source
    if spec is None and topic is not None:
        raise ConfigError("a topic is for logs: name the log, too")
    if spec is None:
        from frontend.sources.scene import BuiltInClip

        source = BuiltInClip()
    elif is_log(spec):
        from logs import open_images

        source = open_images(spec, topic, time_source=chosen.time_source, autorotate=not chosen.no_autorotate)
    elif topic is not None:
        raise ConfigError(f"a topic is for logs, and '{spec}' is not one: leave the topic out")
    else:
        source = open_source(
            spec,
            fps=chosen.fps,
            reconnect_s=chosen.reconnect,
            calibrated=chosen.calib is None and not chosen.side_by_side,
            autorotate=not chosen.no_autorotate,
        )
    if chosen.calib == NO_CALIBRATION:
        source = UncalibratedFrames(source)
    undistort = chosen.undistort and not chosen.pairs  # rectified images have no lens
    return CalibratedFrames(source, calibration, undistort=undistort) if calibration or undistort else source


def _open_pairs(spec: str | None, chosen: InputConfig) -> Source:
    """The frames of two cameras."""
    from frontend.camera.calibration import read_pair
    from frontend.sources.kinds import local_name
    from frontend.sources.pairs import find_pair
    from frontend.sources.stereo import SideBySide, StereoSource
    from frontend.sources.wrapped import UncalibratedFrames
    from logs.files import is_log

    if spec is None:
        others = chosen.side_by_side, chosen.right, chosen.calib_file, chosen.topic
        if not chosen.stereo or any(others):
            raise ConfigError("the built-in clip brings its right camera with its calibration: give --stereo alone")
        from frontend.sources.scene import BuiltInClip

        clip = BuiltInClip(stereo=True)
        return UncalibratedFrames(clip) if chosen.calib == NO_CALIBRATION else clip
    left, right, topics = spec, chosen.right and local_name(chosen.right), (chosen.topic, chosen.right_topic)
    if right is None and (chosen.side_by_side or is_log(spec)):
        right = spec
        if not chosen.side_by_side and chosen.right_topic is None:
            from logs.files import open_log
            from logs.topics import stereo_topics

            with closing(open_log(spec)) as file:
                topics = stereo_topics(file, chosen.topic)
    elif right is None:
        left, right = find_pair(spec)
    if not chosen.side_by_side and (os.path.realpath(left), topics[0]) == (os.path.realpath(right), topics[1]):
        raise ConfigError("the right camera's images are the left one's: name its own with --right, or --right-topic")
    calibrations: tuple[Calibration, Calibration] | tuple[None, None] = None, None
    if chosen.calib_file is not None:
        calibrations = read_pair(chosen.calib_file, (topics[0] or left, topics[1] or right), chosen.right_calib)
    if chosen.side_by_side:
        return SideBySide(_open_one(spec, chosen.topic, chosen, None), *calibrations, rectified=chosen.rectified)
    first = _open_one(left, topics[0], chosen, calibrations[0])
    try:
        second = _open_one(right, topics[1], chosen, calibrations[1])
    except BaseException:
        first.close()
        raise
    name = Path(spec).resolve().name if Path(left).is_relative_to(spec) else None
    return StereoSource(first, second, rectified=chosen.rectified, max_gap_s=chosen.max_stereo_gap, name=name)


def list_topics(spec: str | None) -> str:
    """The cameras of a log, as a table; raises InputError where there is none."""
    from frontend.sources.kinds import local_name
    from logs.files import open_log
    from logs.topics import as_text, camera_topics, choose_topic

    if spec is None:
        raise InputError("--list-topics needs a log: name an .mcap file, a .bag file or a bag folder")
    with closing(open_log(local_name(spec))) as file:
        rows = camera_topics(file)
        if not rows:
            choose_topic(file.topics, None)  # says what the log holds instead
        return as_text(rows)


def track_files(specs: list[str], *, overwrite: bool, points: bool) -> list[list[Path]]:
    """The files of each output for tracked lines, its own first; raises AirLineError for one that cannot be made."""
    from logs.sinks.open import check, files_of

    for spec in specs:
        check(spec, overwrite=overwrite, points=points)
    return [files_of(spec) for spec in specs]


def check_points(kind: str, points: bool) -> None:
    """Refuse a kind of output that takes points beside the lines, if there are none; raises ConfigError."""
    from logs.sinks.clouds import SYSTEMS, check_points

    if kind in SYSTEMS:
        check_points(kind, points)


def can_be_replayed(spec: str) -> bool:
    """Whether `viz.replay` reads what is written into an output."""
    from logs.sinks.open import kind_and_path

    return kind_and_path(spec)[0] in ("mcap", "parquet")


def guess_of(spec: str) -> str | None:
    """What is said of an output whose kind its name only hints at; see `logs.sinks.open`."""
    from logs.sinks.open import guess_of

    return guess_of(spec)


def open_track_sink(spec: str, **options: Any) -> Sink:
    """An output for tracked lines; see `logs.sinks.open`."""
    from logs.sinks.open import open_track_sink

    return open_track_sink(spec, **options)


def read_tracks(path: Path) -> Iterator[LineTracks]:
    """Tracked lines out of a file; see `logs.read_tracks`."""
    from logs import read_tracks

    return read_tracks(path)


def open_publisher(address: str, name: str, *, labels: bool, stride: int) -> ZmqPublisher | FoxgloveServer:
    """A sink that sends tracked lines to other processes; see `logs.sinks.open`."""
    from logs.sinks.open import open_publisher

    return open_publisher(address, name, labels=labels, stride=stride)


def write_pairs(path: Path, images: tuple[Image, Image], matches: LineMatches) -> None:
    """Write two images beside each other with their lines; InputError where that cannot be."""
    from viz.overlay import draw_pairs, write_picture

    write_picture(path, draw_pairs(images, matches))


def video_to_log(spec: str | None, config: RunConfig) -> Path | VideoPackets | None:
    """The input's file, or a log's packets, if they stand for the frames in the recording."""
    from frontend.sources import kinds
    from frontend.sources.image_names import is_pattern
    from logs.files import is_log

    if config.recording.image != "video" or config.recording.layer is not None:
        return None
    if config.input.pairs:
        raise ConfigError("--log-image video is for one camera: record the images of a pair with --log-image jpeg")
    if config.input.resize is not None or config.input.undistort:
        raise ConfigError("--log-image video shows frames as they are in the file: leave --resize and --undistort out")
    if spec is None:
        from frontend.sources.scene import CLIP

        return CLIP
    text = kinds.local_name(spec)
    if is_log(text):
        return _packets_of(text, config)
    kind = kinds.kind_of(text)
    others = kind in ("folder", "camera", "device", "pipe", "log", "image")
    if others or (kind == "missing" and (kinds.is_url(text) or is_pattern(text) or text.isdigit())):
        shown = kinds.without_password(spec)
        raise ConfigError(f"--log-image video needs a video file as its input, not {shown}: use --log-image jpeg")
    return Path(text)


def _packets_of(log: str, config: RunConfig) -> VideoPackets:
    """The packets of a log's video, as far as Rerun can play them."""
    from itertools import chain, islice

    from logs import open_images
    from logs.images.video import in_order
    from logs.messages.types import ends_the_past
    from viz.video import VideoPackets

    source = open_images(log, config.input.topic, time_source=config.input.time_source)
    source.seek(config.input.start or 0.0)
    packets = source.packets()
    first = list(islice(packets, PROBED))
    why = None
    if not first or (first[0][2].format == "h264" and not ends_the_past(first[0][2])):
        why = "it holds no video that begins with a whole key frame"
    elif not in_order(packet for *_, packet in first):
        why = "its video has B-frames, and Rerun shows packets in the order in which they come"
    if why is not None:
        source.close()
        raise ConfigError(f"--log-image video cannot take the packets of {log}: {why}; use --log-image jpeg")

    def found() -> Generator[tuple[int, int, bytes]]:
        with closing(source):
            for number, stamp_ns, packet in chain(first, packets):
                yield number, stamp_ns, bytes(packet.data)

    return VideoPackets(first[0][2].format, found())


def open_recording(
    save: Path | None,
    viewer: str | None,
    name: str,
    config: RunConfig,
    video: Path | VideoPackets | None = None,
    properties: Mapping[str, object] | None = None,
) -> Sink:
    """The Rerun recording, into a file, a viewer or both; frames are JPEGs unless `video` is the file of them."""
    from msgspec.structs import asdict

    from viz.rerun_sink import RerunSink

    settings = asdict(config.recording)
    if settings["image"] == "video" and video is None:
        settings["image"] = "jpeg"
    return RerunSink(save=save, connect=viewer, name=name, video=video, properties=properties, **settings)


def has_display() -> bool:
    """Whether a viewer window could open here."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def where_to_record(options: argparse.Namespace, name: str, server: WebViewer | None) -> tuple[Path | None, str | None]:
    """The file to save and the address of a viewer: the one that was asked for, or a window where one can open.

    Without either the recording goes to a file named after the input, unless --out or --publish says where results go.
    """
    elsewhere = options.out or options.publish
    if options.connect is not None or server is not None:
        return options.save, options.connect if server is None else server.stream
    if options.spawn or (options.save is None and not options.headless and not options.serve and has_display()):
        from viz.viewer import open_viewer

        viewer = open_viewer()
        if viewer is not None:
            return options.save, viewer
        saved = options.save is not None or elsewhere
        log.warning("no viewer window could be opened%s", "" if saved else f": saving {name}.rrd instead")
    if options.save is not None:
        return options.save, None
    return (None if elsewhere else Path(f"{name}.rrd")), None


@contextmanager
def web_viewer() -> Iterator[WebViewer | None]:
    """A viewer for browsers, while the block runs; None, and a warning, where it does not start."""
    from viz.viewer import serve

    viewer = serve()
    if viewer is None:
        log.warning("no web viewer could be started: going on without it")
        yield None
        return
    print(f"watch at {viewer.url}", f"or with: rerun {viewer.stream}", sep="\n", flush=True)
    try:
        yield viewer
    finally:
        viewer.close()


def wait_for_interrupt(viewer: WebViewer) -> None:
    """Keep the web viewer up until Ctrl-C, or until it ends by itself."""
    try:
        print(f"serving at {viewer.url} until Ctrl-C", flush=True)
        viewer.process.wait()
        log.warning("the web viewer has ended")
    except KeyboardInterrupt:
        pass
