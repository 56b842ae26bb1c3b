"""The flags of the command line."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from airline import __version__
from airline.command import Parser
from frontend.cli.settings import RunConfig

INPUT = (
    "video, image folder or pattern, log, camera (0, /dev/video0), URL, or - for a video on stdin "
    "(default: the built-in clip)"
)
OUT = (
    "write the tracks: FILE.mcap, FILE.parquet, FILE.csv, limap/; for PL-VINS and its kin: plvins.bag (or FILE.bag), "
    "eplf.bag, uvslam.bag, or .mcap; may be given several times"
)
PUBLISH = (
    "send the tracks to other processes: tcp://127.0.0.1:5555 or ipc:///tmp/lines (ZeroMQ), "
    "ws://127.0.0.1:8765 (Foxglove); may be given several times"
)
WEIGHTS = "weights of the edge network (.safetensors)"

FLAGS = {
    "live sources": {
        "--realtime": "input.realtime",
        "--max-latency S": "input.max_latency",
        "--reconnect S": "input.reconnect",
    },
    "recording": {
        "--blueprint": "recording.blueprint",
        "--log-image": "recording.image",
        "--jpeg-quality Q": "recording.jpeg_quality",
        "--log-every N": "recording.every",
        "--log-descriptor-every K": "recording.descriptor_every",
        "--show-lost": "recording.show_lost",
        "--recording-id ID": "recording.recording_id",
        "--application-id ID": "recording.application_id",
        "--layer ENTITY": "recording.layer",
        "--coordinate-frame NAME": "recording.coordinate_frame",
        "--frame-timeline NAME": "recording.frame_timeline",
        "--time-timeline NAME": "recording.time_timeline",
    },
    "frames": {
        "--start S": "input.start",
        "--end S": "input.end",
        "--stride N": "input.stride",
        "--max-frames N": "input.max_frames",
        "--resize WxH": "input.resize",
        "--fps FPS": "input.fps",
        "--no-autorotate": "input.no_autorotate",
    },
    "logs": {"--topic TOPIC": "input.topic", "--time-source": "input.time_source"},
    "camera": {"--calib FILE": "input.calib", "--undistort": "input.undistort"},
    "two cameras": {
        "--stereo": "input.stereo",
        "--right RIGHT": "input.right",
        "--right-topic TOPIC": "input.right_topic",
        "--right-calib FILE": "input.right_calib",
        "--side-by-side": "input.side_by_side",
        "--rectified": "input.rectified",
        "--max-stereo-gap S": "input.max_stereo_gap",
    },
    "detector": {"--preset": "preset", "--runtime": "runtime"},
    "tracker": {"--max-lines N": "tracker.max_lines", "--points": "tracker.points"},
    "settings": {"--serial": "serial"},
}
"""Flags by group: the setting that each stands for, whose field in `settings` says its type and its help."""


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

    _add_flags(parser, "live sources")
    add_settings(parser)
    add = parser.add_argument_group("instead of a run").add_argument
    add("--info", action="store_true", help="print what the input is taken for and exit")
    add("--list-topics", action="store_true", help="print image and calibration topics and exit")
    add("--dump-config", action="store_true", help="print all settings as TOML and exit")
    return parser


def add_settings(parser: argparse.ArgumentParser) -> None:
    """The flags that `settings_of` reads, for every command that runs the frontend."""
    for title in ("recording", "frames", "logs", "camera", "two cameras", "detector", "tracker", "settings"):
        _add_flags(parser, title)


def _add_flags(parser: argparse.ArgumentParser, title: str) -> None:
    add = parser.add_argument_group(title).add_argument
    if title == "detector":
        add("--weights", dest="detector.edges.weights", metavar="FILE", help=WEIGHTS)
    elif title == "settings":
        add("--config", type=Path, metavar="FILE.toml", help="settings; flags override them")
    for flag, place in FLAGS[title].items():
        name, _, metavar = flag.partition(" ")
        owner: Any = RunConfig()
        *tables, field = place.split(".")
        for table in tables:
            owner = getattr(owner, table)
        default, hint = getattr(owner, field), get_type_hints(type(owner), include_extras=True)[field]
        kind, meta = get_args(hint if get_origin(hint) is Annotated else get_args(hint)[0])  # the latter where optional
        how: dict[str, Any] = {"choices": get_args(kind)} if get_origin(kind) is Literal else {"type": kind}
        if kind is bool:
            how = {"action": "store_const", "const": True}  # and None where it is not given
        elif metavar:
            how["metavar"] = metavar
        shown = f" ({default:g})" if kind in (int, float) and default is not None else ""
        add(name, dest=place, help=meta.description + shown, **how)


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
