"""Measure the line tracker against known identities and known poses: `python -m frontend.evaluate`.

Without arguments the clips are the rendered ones, which are built in. Photographs, labelled frames and clips with poses
come from folders.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping
from contextlib import closing
from itertools import islice
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from airline.command import Parser, exit_code, number, write_json
from airline.errors import InputError
from frontend.cli.terminal import progress

if TYPE_CHECKING:
    from airline.detector import AirLine
    from airline.lines import LineSet
    from frontend.evaluation.posed import Posed, PosedClip
    from frontend.evaluation.truth import Clip, Record, Tracked, Tracker
    from frontend.frame import Frame
    from frontend.tracks import LineTracks

    Answer = tuple[Tracked | LineTracks, float]  # of a tracker, and how long it took, ms

WORST = 10  # tracks in a picture


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(
        prog="python -m frontend.evaluate",
        description="Measure the line tracker against known identities, beside nearest neighbour and optical flow.",
    )
    add = parser.add_argument
    folders: dict[str, Any] = {"type": Path, "metavar": "DIR"}
    add("--sequence", nargs="+", metavar="NAME", help="only these clips, by the names that the tables show")
    add("--photos", **folders, help="also photographs of a folder, moved and degraded")
    add("--icl", **folders, help="also frames with labelled lines and associations")
    add("--posed", nargs="+", default=[], **folders, help="also clips with poses, of KITTI, ICL-NUIM, TUM")
    match = "instead, pairs of images: rendered, or labelled frames as for --icl, or planes, N.png and H_1_N"
    add("--match", nargs="*", **folders, help=match)
    stereo = "instead, partners in pairs: rendered, or of stereo cameras that have poses, as of --posed, or rest"
    add("--stereo", nargs="*", **folders, help=stereo)
    add("--limit", type=number(int, 2), metavar="N", help="use only the first N frames of each clip")
    add("--worst", **folders, help="draw the ten tracks least like a line in space, where poses are known")
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
    from airline.detector import AirLine
    from frontend.evaluation import report
    from frontend.evaluation.accuracy import accuracy, jitter
    from frontend.evaluation.coverage import coverage
    from frontend.evaluation.metrics import identity_scores
    from frontend.evaluation.rendered import SceneClip

    if options.match is not None:
        return _match(options)
    if options.stereo is not None:
        return _stereo(options)
    clips, posed_clips = _chosen(options)
    detect = AirLine()
    sequences: dict[str, Any] = {}
    accurate: dict[str, Any] = {}
    posed: dict[str, Any] = {}
    runs: dict[str, list[Answer]]
    for clip in clips:
        records = measure(clip, detect, options.limit)
        sequences[clip.name] = {
            name: {**identity_scores(run), **coverage(run), **jitter(run)} for name, run in records.items()
        }
        accurate[clip.name] = accuracy(records["ours"])
        if isinstance(clip, SceneClip):
            runs = {name: [(record.tracked, record.ms) for record in run] for name, run in records.items()}
            posed[clip.name] = in_space(clip, runs)
            _draw_worst(options, clip, (frame for frame, _ in clip), runs)
    for folder in posed_clips:
        trackers, runs = Trackers(detect), defaultdict(list)
        with progress(folder.name, min(len(folder), options.limit or len(folder))) as advance:
            for frame in islice(folder, options.limit):
                for name, answer in trackers(frame)[1].items():
                    runs[name].append(answer)
                advance()
        posed[folder.name] = in_space(folder, runs)
        _draw_worst(options, folder, folder, runs)
    figures = {"sequences": sequences, "accuracy": accurate, "posed": posed}
    report.show(figures, report.LEGEND)
    write_json(options.json, figures)


def _match(options: argparse.Namespace) -> None:
    from frontend.evaluation import report
    from frontend.evaluation.matches import match_figures

    figures: dict[str, Any] = {"matches": {}}
    for folder in options.match or [None]:
        figures["matches"] |= match_figures(folder)
    report.show(figures, report.MATCH_LEGEND)
    write_json(options.json, figures)


def _stereo(options: argparse.Namespace) -> None:
    from airline.detector import AirLine
    from frontend.evaluation import report, stereo
    from frontend.evaluation.posed import PosedClip
    from frontend.sources import open_stereo

    detect = AirLine()
    figures: dict[str, dict[str, Any]] = {"partners": {}, "first_pairs": {}, "at_rest": {}}
    clips = stereo.rendered_pairs()
    for name in [] if options.stereo else _named(options, list(clips)):
        truths: list[stereo.PairTruth] = []
        with progress(name, min(len(clips[name]), options.limit or len(clips[name]))) as advance:
            runs = stereo.follow(stereo.frames_of(clips[name], options.limit, truths), detect, advance)
        figures["partners"][name] = {kind: stereo.partner_scores(run, truths) for kind, run in runs.items()}
    for folder in options.stereo:
        posed = PosedClip(folder) if (folder / "poses.txt").is_file() else None
        with closing(open_stereo(folder)) as source, progress(source.name, source.frame_count) as advance:
            runs = stereo.follow(islice(source, options.limit), detect, advance)
        figures["first_pairs" if posed else "at_rest"][source.name] = {
            kind: stereo.first_pair_scores(run, posed) if posed else stereo.rest_scores(run)
            for kind, run in runs.items()
        }
    report.show(figures, report.STEREO_LEGEND)
    write_json(options.json, figures)


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
    posed = [PosedClip(folder) for folder in options.posed]
    names = [clip.name for clip in clips] + [clip.name for clip in posed]
    wanted = _named(options, names)
    for name in wanted:
        if names.count(name) > 1:
            raise InputError(f"two sequences are called '{name}': rename a folder")
    return [clip for clip in clips if clip.name in wanted], [clip for clip in posed if clip.name in wanted]


def _named(options: argparse.Namespace, names: list[str]) -> list[str]:
    """Those of the names that the arguments ask for."""
    for name in options.sequence or []:
        if name not in names:
            raise InputError(f"no sequence '{name}': there are {', '.join(names)}")
    return options.sequence or names


class Trackers:
    """All that are compared, on the same lines."""

    def __init__(self, detect: AirLine) -> None:
        from frontend.evaluation.baselines import FlowTracker, NearestTracker
        from frontend.tracker import LineTracker

        self._detect = detect
        self._all: dict[str, Tracker] = {"ours": LineTracker(), "nearest": NearestTracker(), "flow": FlowTracker()}

    def __call__(self, frame: Frame) -> tuple[LineSet, dict[str, Answer]]:
        """The lines of the next frame, and what every tracker makes of them."""
        trace = self._detect.trace(frame.image)
        answers = {}
        for name, tracker in self._all.items():
            started = time.perf_counter()
            tracked = tracker.update(frame, trace.lines, trace.edges)
            answers[name] = tracked, 1e3 * (time.perf_counter() - started)
        return trace.lines, answers


def measure(clip: Clip, detect: AirLine, limit: int | None) -> dict[str, list[Record]]:
    """Every tracker's run over the first `limit` frames of a clip with known identities, beside the truth.

    Raises:
        InputError: a frame cannot be read.
    """
    from frontend.evaluation.truth import Record, owners

    trackers, records = Trackers(detect), defaultdict[str, list[Record]](list)
    with progress(clip.name, min(len(clip), limit or len(clip))) as advance:
        for frame, truth in islice(clip, limit):
            lines, answers = trackers(frame)
            height, width = frame.image.shape[:2]
            of = owners(lines.segments, truth)
            for name, (tracked, ms) in answers.items():
                records[name].append(Record(tracked, of, truth, (width, height), ms))
            advance()
    return records


def in_space(clip: Posed, runs: Mapping[str, list[Answer]]) -> dict[str, dict[str, Any]]:
    """Consistency with one line in space of what each tracker observed, and of what ours fused and calls stable."""
    from frontend.evaluation.consistency import consistency
    from frontend.evaluation.observations import collect

    figures = {}
    for name, run in runs.items():
        ms, every = round(median(ms for _, ms in run), 4), collect([tracked for tracked, _ in run])
        kinds = {name: (every, every.observed_px)}
        if name == "ours":
            stable = every.take(every.stable)
            kinds["fused"] = every, every.segments_px
            kinds |= {"stable": (stable, stable.observed_px), "stable, fused": (stable, stable.segments_px)}
        for kind, (rows, segments) in kinds.items():
            figures[kind] = {**consistency(rows, segments, clip, len(run)), "ms": ms}
    return figures


def _draw_worst(
    options: argparse.Namespace, clip: Posed, frames: Iterable[Frame], runs: Mapping[str, list[Answer]]
) -> None:
    from frontend.evaluation.observations import collect
    from frontend.evaluation.strips import draw_strips, fitted, write_strips

    if options.worst is not None:
        worst = fitted(collect([tracked for tracked, _ in runs["ours"]]), clip)[:WORST]
        if worst:
            write_strips(options.worst / f"{clip.name}.png", draw_strips(islice(frames, options.limit), worst))


if __name__ == "__main__":
    sys.exit(main())
