"""The flags of the command line."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from airline import __version__
from airline.command import Parser
from airline.config import PRESETS, RUNTIMES


def build_parser() -> argparse.ArgumentParser:
    """All flags; those without a default leave the setting as the preset or the --config file has it."""
    parser = Parser(
        prog="python -m frontend.run",
        description="Detect and track line segments in a stream and record everything for the Rerun viewer.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "input",
        nargs="?",
        help="video file, image folder or glob, camera index, stream URL or log (default: the built-in clip)",
    )
    parser.add_argument("--version", action="version", version=f"airline-frontend {__version__}")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="say more; twice for debugging")
    output = parser.add_argument_group("output")
    output.add_argument("--save", type=Path, metavar="FILE.rrd", help="record into this file, and open no window")
    viewer = output.add_mutually_exclusive_group()
    viewer.add_argument("--headless", action="store_true", help="open no viewer even where there is a display")
    viewer.add_argument("--spawn", action="store_true", help="open a viewer window, also with --save")
    viewer.add_argument("--connect", metavar="HOST:PORT", help="send to a running viewer, also with --save")
    viewer.add_argument("--serve", action="store_true", help="show the run in this machine's browser, until Ctrl-C")
    output.add_argument("--summary", type=Path, metavar="FILE.json", help="write the final figures as JSON")
    output.add_argument(
        "--out",
        action="append",
        default=[],
        metavar="TRACKS",
        help="write the tracks: FILE.mcap, FILE.parquet, FILE.csv, limap/ or plvins.mcap; may be given several times",
    )
    output.add_argument(
        "--publish",
        action="append",
        default=[],
        metavar="ADDR",
        help="send the tracks to other processes: tcp://127.0.0.1:5555 or ipc:///tmp/lines (ZeroMQ), "
        "ws://127.0.0.1:8765 (Foxglove); may be given several times",
    )
    output.add_argument("--overwrite", action="store_true", help="replace what --out names if it exists")
    output.add_argument("--with-images", action="store_true", help="put the images into --out FILE.mcap")
    output.add_argument("--labels", action="store_true", help="write the ids beside the lines, in Foxglove")
    live = parser.add_argument_group("live sources")
    live.add_argument(
        "--realtime", action="store_const", const=True, help="play a recording at its own pace, as a camera would"
    )
    live.add_argument(
        "--max-latency", type=float, metavar="S", help="drop a live source's frames that have waited longer (0.2)"
    )
    live.add_argument("--reconnect", type=float, metavar="S", help="try a stream that drops again for S seconds (60)")
    add_settings(parser)
    instead = parser.add_argument_group("instead of a run")
    instead.add_argument("--list-topics", action="store_true", help="print image and calibration topics and exit")
    instead.add_argument("--dump-config", action="store_true", help="print all settings as TOML and exit")
    return parser


def add_settings(parser: argparse.ArgumentParser) -> None:
    """The flags that `settings_of` reads, for every command that runs the frontend over recordings."""
    recording = parser.add_argument_group("recording")
    recording.add_argument("--blueprint", choices=["minimal", "full"], help="how much the viewer shows")
    recording.add_argument(
        "--log-image",
        choices=["jpeg", "raw", "video", "none"],
        help="how images are recorded; video: the input file once, and no stages of the detector",
    )
    recording.add_argument("--jpeg-quality", type=int, metavar="Q", help="of all pictures, 1 to 100")
    recording.add_argument("--log-every", type=int, metavar="N", help="record every N-th frame")
    recording.add_argument(
        "--log-descriptor-every", type=int, metavar="K", help="record the descriptors every K frames, 0 never"
    )
    frames = parser.add_argument_group("frames")
    frames.add_argument("--start", type=float, metavar="S", help="skip the first S seconds")
    frames.add_argument("--end", type=float, metavar="S", help="stop S seconds after the first frame")
    frames.add_argument("--stride", type=int, metavar="N", help="use every N-th frame")
    frames.add_argument("--max-frames", type=int, metavar="N", help="stop after N frames")
    frames.add_argument("--resize", metavar="WxH", help="resize frames, e.g. 640x480, or 640 to keep the aspect")
    frames.add_argument("--fps", type=float, help="frame rate of image folders without timestamps")
    logs = parser.add_argument_group("logs")
    logs.add_argument("--topic", help="image topic")
    logs.add_argument("--time-source", choices=["header", "publish", "log"], help="where times come from")
    camera = parser.add_argument_group("camera")
    camera.add_argument(
        "--calib", metavar="FILE", help="calibration: EuRoC, Kalibr or ROS YAML, or JSON (default: the log's)"
    )
    camera.add_argument("--undistort", action="store_const", const=True, help="remove lens distortion before detection")
    model = parser.add_argument_group("detector")
    model.add_argument("--preset", choices=PRESETS, help="settings to start from")
    model.add_argument("--weights", metavar="FILE", help="weights of the edge network (.safetensors)")
    model.add_argument("--runtime", choices=RUNTIMES, help="what the edge network runs in")
    settings = parser.add_argument_group("settings")
    settings.add_argument("--config", type=Path, metavar="FILE.toml", help="settings; flags override them")
    settings.add_argument(
        "--serial", action="store_const", const=True, help="do one thing after the other in one thread, for debugging"
    )


def settings_of(options: argparse.Namespace) -> dict[str, Any]:
    """The flags that were given, in the settings' own structure."""
    frames = ("start", "end", "stride", "max_frames", "resize", "fps", "realtime", "max_latency", "reconnect")
    names = (*frames, "topic", "time_source", "calib", "undistort")
    given = {name: value for name in names if (value := getattr(options, name, None)) is not None}
    flags: dict[str, Any] = {"input": given} if given else {}
    recorded = {
        "image": options.log_image,
        "jpeg_quality": options.jpeg_quality,
        "every": options.log_every,
        "descriptor_every": options.log_descriptor_every,
        "blueprint": options.blueprint,
    }
    if any(value is not None for value in recorded.values()):
        flags["recording"] = {name: value for name, value in recorded.items() if value is not None}
    for name in ("preset", "runtime", "serial"):
        if getattr(options, name) is not None:
            flags[name] = getattr(options, name)
    if options.weights is not None:
        flags["detector"] = {"edges": {"weights": options.weights}}
    return flags
