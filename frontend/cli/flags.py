"""The flags of the command line."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from airline import __version__
from airline.command import Parser
from airline.config import PRESETS, RUNTIMES

INPUT = "video file, image folder or glob, camera index, stream URL or log (default: the built-in clip)"
OUT = "write the tracks: FILE.mcap, FILE.parquet, FILE.csv, limap/ or plvins.mcap; may be given several times"
PUBLISH = (
    "send the tracks to other processes: tcp://127.0.0.1:5555 or ipc:///tmp/lines (ZeroMQ), "
    "ws://127.0.0.1:8765 (Foxglove); may be given several times"
)
LOG_IMAGE = "how images are recorded; video: the input file once, and no stages of the detector"
ON: Any = {"action": "store_const", "const": True}  # and None where it is not given
CALIB = "calibration: EuRoC, Kalibr or ROS YAML, or JSON (default: the log's)"


def build_parser() -> argparse.ArgumentParser:
    """All flags; those without a default leave the setting as the preset or the --config file has it."""
    parser = Parser(
        prog="python -m frontend.run",
        description="Detect and track line segments in a stream and record everything for the Rerun viewer.",
        allow_abbrev=False,
    )
    parser.add_argument("input", nargs="?", help=INPUT)
    parser.add_argument("--version", action="version", version=f"airline-frontend {__version__}")
    parser.add_argument("-v", "--verbose", action="count", default=0, help="say more; twice for debugging")

    output = parser.add_argument_group("output")
    add = output.add_argument
    add("--save", type=Path, metavar="FILE.rrd", help="record into this file, and open no window")
    viewer = output.add_mutually_exclusive_group().add_argument
    viewer("--headless", action="store_true", help="open no viewer even where there is a display")
    viewer("--spawn", action="store_true", help="open a viewer window, also with --save")
    viewer("--connect", metavar="HOST:PORT", help="send to a running viewer, also with --save")
    viewer("--serve", action="store_true", help="show the run in this machine's browser, until Ctrl-C")
    add("--summary", type=Path, metavar="FILE.json", help="write the final figures as JSON")
    add("--out", action="append", default=[], metavar="TRACKS", help=OUT)
    add("--publish", action="append", default=[], metavar="ADDR", help=PUBLISH)
    add("--overwrite", action="store_true", help="replace what --out names if it exists")
    add("--with-images", action="store_true", help="put the images into --out FILE.mcap")
    add("--labels", action="store_true", help="write the ids beside the lines, in Foxglove")

    add = parser.add_argument_group("live sources").add_argument
    add("--realtime", dest="input.realtime", **ON, help="play a recording at its own pace, as a camera would")
    late = "drop a live source's frames that have waited longer (0.2)"
    add("--max-latency", dest="input.max_latency", type=float, metavar="S", help=late)
    again = "try a stream that drops again for S seconds (60)"
    add("--reconnect", dest="input.reconnect", type=float, metavar="S", help=again)

    add_settings(parser)
    add = parser.add_argument_group("instead of a run").add_argument
    add("--list-topics", action="store_true", help="print image and calibration topics and exit")
    add("--dump-config", action="store_true", help="print all settings as TOML and exit")
    return parser


def add_settings(parser: argparse.ArgumentParser) -> None:
    """The flags that `settings_of` reads, for every command that runs the frontend."""
    add = parser.add_argument_group("recording").add_argument
    add("--blueprint", dest="recording.blueprint", choices=["minimal", "full"], help="how much the viewer shows")
    add("--log-image", dest="recording.image", choices=["jpeg", "raw", "video", "none"], help=LOG_IMAGE)
    add("--jpeg-quality", dest="recording.jpeg_quality", type=int, metavar="Q", help="of all pictures, 1 to 100")
    add("--log-every", dest="recording.every", type=int, metavar="N", help="record every N-th frame")
    seldom = "record the descriptors every K frames, 0 never"
    add("--log-descriptor-every", dest="recording.descriptor_every", type=int, metavar="K", help=seldom)

    add = parser.add_argument_group("frames").add_argument
    add("--start", dest="input.start", type=float, metavar="S", help="skip the first S seconds")
    add("--end", dest="input.end", type=float, metavar="S", help="stop S seconds after the first frame")
    add("--stride", dest="input.stride", type=int, metavar="N", help="use every N-th frame")
    add("--max-frames", dest="input.max_frames", type=int, metavar="N", help="stop after N frames")
    add("--resize", dest="input.resize", metavar="WxH", help="resize frames, e.g. 640x480, or 640 to keep the aspect")
    add("--fps", dest="input.fps", type=float, metavar="FPS", help="frame rate of image folders without timestamps")

    add = parser.add_argument_group("logs").add_argument
    add("--topic", dest="input.topic", metavar="TOPIC", help="image topic")
    add("--time-source", dest="input.time_source", choices=["header", "publish", "log"], help="where times come from")

    add = parser.add_argument_group("camera").add_argument
    add("--calib", dest="input.calib", metavar="FILE", help=CALIB)
    add("--undistort", dest="input.undistort", **ON, help="remove lens distortion before detection")

    add = parser.add_argument_group("detector").add_argument
    add("--preset", choices=PRESETS, help="settings to start from")
    add("--weights", dest="detector.edges.weights", metavar="FILE", help="weights of the edge network (.safetensors)")
    add("--runtime", choices=RUNTIMES, help="what the edge network runs in")

    add = parser.add_argument_group("settings").add_argument
    add("--config", type=Path, metavar="FILE.toml", help="settings; flags override them")
    add("--serial", **ON, help="do one thing after the other in one thread, for debugging")


def settings_of(options: argparse.Namespace) -> dict[str, Any]:
    """The flags that were given, in the settings' own structure: `add_settings` names them by their place there."""
    flags: dict[str, Any] = {}
    for path, value in vars(options).items():
        if value is not None and ("." in path or path in ("preset", "runtime", "serial")):
            *tables, name = path.split(".")
            table = flags
            for key in tables:
                table = table.setdefault(key, {})
            table[name] = value
    return flags
