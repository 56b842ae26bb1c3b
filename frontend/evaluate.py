"""Measure the line tracker against known identities: `python -m frontend.evaluate`.

Without arguments the clips are the rendered ones, which are built in. Photographs, labelled frames and clips with poses
come from folders.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from airline.command import Parser, exit_code, number, write_json
from airline.errors import InputError
from frontend.cli.terminal import progress

if TYPE_CHECKING:
    from rich.table import Table

    from airline.detector import AirLine
    from airline.lines import LineSet
    from frontend.evaluation.metrics import Figures
    from frontend.evaluation.posed import PosedClip
    from frontend.evaluation.truth import Clip, Tracked, Tracker
    from frontend.frame import Frame
    from frontend.tracks import LineTracks

LEGEND = """\
All trackers get the same lines in the same run. A line counts where it is
known which true line it belongs to.
P, R: precision and recall of links, %. A link is a track seen in two
  consecutive frames; it is right when both lines belong to the same true
  line. wrong: how many links are not.
IDF1: one track for each true line and one true line for each track, %.
switch: changes of a true line's track per 100 frames; frag: those of them
  after frames in which the true line was not tracked.
length, med: frames in which a track was seen, mean and median. pure: mean
  frames of a track on the true line that it was on most. of: mean frames in
  which a true line was detected. >=3, >=5, >=10: tracks seen so often, %.
across, along: the true line, about the true motion; rms.
share: tracks of which all end points stay within 2 px of the line in space
  that they agree on, %; length: mean frames of those. parallax: median, deg.
ms: median time of a tracker's update."""

Column = tuple[str, int, str]  # key, factor, format
IDENTITIES: dict[str, Column] = {
    "P": ("link_precision", 100, ".1f"),
    "R": ("link_recall", 100, ".1f"),
    "wrong": ("wrong_links", 1, "d"),
    "IDF1": ("idf1", 100, ".1f"),
    "switch": ("switches_per_100", 1, ".0f"),
    "frag": ("fragments_per_100", 1, ".0f"),
    "ms": ("ms", 1, ".1f"),
}
LENGTHS: dict[str, Column] = {
    "tracks": ("tracks", 1, "d"),
    "length": ("track_length_mean", 1, ".1f"),
    "med": ("track_length_median", 1, ".0f"),
    "pure": ("pure_length_mean", 1, ".1f"),
    "of": ("visible_length_mean", 1, ".1f"),
    ">=3": ("alive_3", 100, ".0f"),
    ">=5": ("alive_5", 100, ".0f"),
    ">=10": ("alive_10", 100, ".0f"),
}
END_POINTS: dict[str, Column] = {"across": ("jitter_across_px", 1, ".2f"), "along": ("jitter_along_px", 1, ".1f")}
POSED: dict[str, Column] = {
    "tracks": ("tracks_5", 1, "d"),
    "consistent": ("consistent_tracks", 1, "d"),
    "share": ("consistent_share", 100, ".1f"),
    "length": ("consistent_length_mean", 1, ".1f"),
    "parallax": ("parallax_deg", 1, ".2f"),
    "ms": ("ms", 1, ".1f"),
}


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(
        prog="python -m frontend.evaluate",
        description="Measure the line tracker against known identities, beside nearest neighbour and optical flow.",
    )
    parser.add_argument(
        "--sequence", nargs="+", metavar="NAME", help="only these clips, by the names that the table shows"
    )
    parser.add_argument("--photos", type=Path, metavar="DIR", help="also photographs of a folder, moved and degraded")
    parser.add_argument("--icl", type=Path, metavar="DIR", help="also frames with labelled lines and associations")
    parser.add_argument("--posed", type=Path, metavar="DIR", help="also a clip with poses, as KITTI has them")
    parser.add_argument("--limit", type=number(int, 2), metavar="N", help="use only the first N frames of each clip")
    parser.add_json()
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    return exit_code(run, build_parser().parse_args(arguments))


def run(options: argparse.Namespace) -> None:
    """Evaluate, print the tables and write the JSON.

    Raises:
        AirLineError: an argument or file cannot be used.
    """
    from rich.console import Console

    from airline.detector import AirLine

    clips, posed_clips = _chosen(options)
    detect = AirLine()
    sequences = {clip.name: measure(clip, detect, options.limit) for clip in clips}
    posed = {clip.name: measure_posed(clip, detect, options.limit) for clip in posed_clips}
    console = Console()
    if sequences:
        console.print(_table("Identities", sequences, IDENTITIES))
        console.print(_table("Tracks", sequences, LENGTHS))
        console.print(_table("Jitter of the end points, px", sequences, END_POINTS))
    if posed:
        title = "Tracks seen in 5 frames and more, and those that are one line in space"
        console.print(_table(title, posed, POSED))
    console.print(LEGEND)
    write_json(options.json, {"sequences": sequences, "posed": posed})


def _chosen(options: argparse.Namespace) -> tuple[list[Clip], list[PosedClip]]:
    """Clips with known identities and clips with known poses that the arguments name."""
    from frontend.evaluation.icl import LabelledClip
    from frontend.evaluation.moved import moved_photos
    from frontend.evaluation.posed import PosedClip
    from frontend.evaluation.rendered import rendered_clips

    clips = rendered_clips()
    if options.photos is not None:
        clips += moved_photos(options.photos)
    if options.icl is not None:
        clips.append(LabelledClip(options.icl))
    posed = [PosedClip(options.posed)] if options.posed is not None else []
    names = [clip.name for clip in clips] + [clip.name for clip in posed]
    wanted = options.sequence or names
    for name in wanted:
        if name not in names:
            raise InputError(f"no sequence '{name}': there are {', '.join(names)}")
    return [clip for clip in clips if clip.name in wanted], [clip for clip in posed if clip.name in wanted]


def measure(clip: Clip, detect: AirLine, limit: int | None) -> dict[str, Figures]:
    """Figures of every tracker on the first `limit` frames of a clip with known identities; all get the same lines.

    Raises:
        InputError: a frame cannot be read.
    """
    from frontend.evaluation.metrics import identity_scores
    from frontend.evaluation.truth import Record, owners

    trackers = _trackers()
    records: dict[str, list[Record]] = {name: [] for name in trackers}
    with progress(clip.name, min(len(clip), limit or len(clip))) as advance:
        for frame, truth in islice(clip, limit):
            lines = detect(frame.image)
            line_owners = owners(lines.segments, truth)
            height, width = frame.image.shape[:2]
            for name, tracker in trackers.items():
                tracked, ms = _timed(tracker, frame, lines)
                records[name].append(Record(tracked, line_owners, truth, (width, height), ms))
            advance()
    return {name: identity_scores(run) for name, run in records.items()}


def measure_posed(clip: PosedClip, detect: AirLine, limit: int | None) -> dict[str, Figures]:
    """The same on a clip with known poses. What is triangulated are the detections, not what a tracker fuses."""
    from frontend.evaluation.posed import Observation, consistency

    trackers = _trackers()
    tracks: dict[str, dict[int, list[Observation]]] = {name: {} for name in trackers}
    times: dict[str, list[float]] = {name: [] for name in trackers}
    with progress(clip.name, min(len(clip), limit or len(clip))) as advance:
        for frame in islice(clip, limit):
            lines = detect(frame.image)
            for name, tracker in trackers.items():
                tracked, ms = _timed(tracker, frame, lines)
                times[name].append(ms)
                for track, row in zip(tracked.ids.tolist(), tracked.line_indices, strict=True):
                    seen = Observation(lines.segments[row], clip.poses[frame.index])
                    tracks[name].setdefault(track, []).append(seen)
            advance()
    return {
        name: {**consistency(list(found.values()), clip.K), "ms": round(median(times[name]), 4)}
        for name, found in tracks.items()
    }


def _trackers() -> dict[str, Tracker]:
    from frontend.evaluation.baselines import FlowTracker, NearestTracker
    from frontend.tracker import LineTracker

    return {"ours": LineTracker(), "nearest": NearestTracker(), "flow": FlowTracker()}


def _timed(tracker: Tracker, frame: Frame, lines: LineSet) -> tuple[Tracked | LineTracks, float]:
    """A tracker's answer, and the milliseconds it took."""
    started = time.perf_counter()
    tracked = tracker.update(frame, lines)
    return tracked, 1e3 * (time.perf_counter() - started)


def _table(title: str, clips: Mapping[str, Mapping[str, Figures]], columns: Mapping[str, Column]) -> Table:
    """A row per clip and tracker."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column(no_wrap=True, min_width=max(map(len, clips)))
    table.add_column(no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right")
    for clip, trackers in clips.items():
        for k, (tracker, figures) in enumerate(trackers.items()):
            values = ((figures[key], factor, form) for key, factor, form in columns.values())
            texts = ("-" if value is None else format(value * factor, form) for value, factor, form in values)
            table.add_row("" if k else clip, tracker, *texts)
        table.add_section()
    return table


if __name__ == "__main__":
    sys.exit(main())
