"""Two runs on the same input side by side: `python -m viz.compare A B [--save compare.rrd | --connect HOST:PORT]`.

A and B are files with tracks, of `frontend.run INPUT --out a.mcap --with-images` and, with other settings, `--out
b.parquet`. Frames are matched by their stamps, lines by where they lie; a line of B has the colour of its match in A.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from airline.command import Parser, exit_code
from airline.errors import InputError
from airline.evaluation.metrics import MAX_ANGLE, MAX_DISTANCE, MIN_OVERLAP, measure_pairs
from frontend.colours import track_colours
from frontend.tracking.assignment import assign
from frontend.tracks import LineTracks
from viz.blueprint import side_by_side
from viz.figures import Clock, FigureLog, median
from viz.lines import BOLD_RADIUS, THIN_RADIUS, log_lines, picture_scale, picture_size
from viz.replay import ByStamp, images_of, log_image, recording

SIDES = {"a": (255, 150, 40), "b": (60, 170, 255)}  # and the colours of their curves, RGB
MATCHING = (120, 220, 120)
UNMATCHED = np.array([[190, 190, 190]], np.uint8)

Segments = NDArray[np.float32]
Ids = NDArray[np.int64]


def match_lines(first: Segments, second: Segments) -> tuple[Ids, Ids, NDArray[np.float64]]:
    """One-to-one pairs of lines (N, 2, 2) and (M, 2, 2), px, that lie over each other.

    Bounds are those of `measure_pairs`; the pairing has the most overlap in total, nearer pairs counting more.

    Returns:
        (K,) rows of the first, ascending, (K,) rows of the second, and (K,) distances, px.
    """
    if not len(first) or not len(second):
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
    with np.errstate(divide="ignore", invalid="ignore"):  # lines without length, and NaN, match nothing
        distance, overlap, cosine = measure_pairs(first.astype(np.float64), second.astype(np.float64))
        possible = (distance <= MAX_DISTANCE) & (overlap >= MIN_OVERLAP) & (cosine >= np.cos(MAX_ANGLE))
        votes = np.where(possible, overlap * (1 - 0.9 * distance / MAX_DISTANCE), 0)
    chosen = assign(votes.astype(np.float32), 1e-6)
    rows = np.flatnonzero(chosen >= 0)
    columns = chosen[rows].astype(np.int64)
    return rows, columns, distance[rows, columns]


class Comparison:
    """Logs the frames of two runs, and counts.

    `/camera/image`, and for `/a` and `/b` each: `tracks`, coloured by the tracks of A, and `unmatched`, grey. Figures
    are below `/stats`. Timelines are `frame` and `sensor_time`, those of A.
    """

    def __init__(self, stream: rr.RecordingStream, names: tuple[str, str]) -> None:
        self._stream = stream
        self._names = names
        self._clock = Clock(stream)
        colours = {**dict(zip(names, SIDES.values(), strict=True)), "matching": MATCHING}
        self._figures = FigureLog(stream, colours)
        self._frames = self._matched = 0
        self._lengths: dict[str, Counter[int]] = {name: Counter() for name in names}  # frames of each track
        self._scale = 0.0

    def write(self, a: LineTracks, b: LineTracks) -> None:
        """Log the tracks of one image in both runs."""
        self._clock.set(a.frame_index, a.stamp_ns)
        rows, columns, distances = match_lines(a.segments_px, b.segments_px)
        self._scale = self._scale or picture_scale(picture_size(a))
        figures: dict[str, dict[str, float]] = {"lines": {}, "matched_share": {}, "track_length": {}}
        for name, side, tracks, own in zip(self._names, SIDES, (a, b), (rows, columns), strict=True):
            self._log_side(f"/{side}", tracks, own, a.ids[rows])
            self._lengths[name].update(tracks.ids.tolist())
            figures["lines"][name] = len(tracks)
            figures["matched_share"][name] = 100 * len(rows) / len(tracks) if len(tracks) else 0.0
            figures["track_length"][name] = median(tracks.ages[tracks.confirmed])
        figures["lines"]["matching"] = len(rows)
        figures["distance"] = {"median": float(np.median(distances)) if len(distances) else np.nan}
        self._figures.write(figures)
        self._frames += 1
        self._matched += len(rows)

    def summary(self) -> str:
        """The figures of both runs, a line each."""
        said = [f"{self._frames} frames that both have, {self._matched} pairs of matching lines"]
        for name in self._names:
            lengths = list(self._lengths[name].values())
            lines = sum(lengths)
            share = 100 * self._matched / max(lines, 1)
            tracks = f"{len(lengths)} tracks of {median(lengths):.0f} frames (median)"
            said.append(f"{name}: {lines} lines, {share:.1f} % of them matched, in {tracks}")
        return "\n".join(said)

    def _log_side(self, root: str, tracks: LineTracks, rows: Ids, colour_ids: Ids) -> None:
        order = np.argsort(rows)  # ids stay ascending
        rows, colour_ids = rows[order], colour_ids[order]
        radii = self._scale * np.where(tracks.confirmed, BOLD_RADIUS, THIN_RADIUS)
        colours = track_colours(colour_ids)
        log_lines(self._stream, f"{root}/tracks", tracks.segments_px[rows], colours, radii[rows], tracks.ids[rows])
        rest = np.delete(np.arange(len(tracks)), rows)
        segments, ids = tracks.segments_px[rest], tracks.ids[rest]
        log_lines(self._stream, f"{root}/unmatched", segments, UNMATCHED, radii[rest], ids)


def common_frames(a: Path, b: Path) -> Iterator[tuple[LineTracks, LineTracks]]:
    """The tracks of both files with the same stamps."""
    from logs import read_tracks

    others = ByStamp(read_tracks(b))
    for first in read_tracks(a):
        second = others.at(first.stamp_ns)
        if second is not None:
            yield first, second


def compare(a: Path, b: Path, save: Path | None, connect: str | None) -> str:
    """Record two runs; returns their figures. Raises AirLineError where a file cannot be read or written."""
    frames = common_frames(a, b)
    first = next(frames, None)
    if first is None:
        raise InputError(f"{a} and {b} have no frame in common: give two runs on the same input")
    names = f"A: {a.name}", f"B: {b.name}"
    images = ByStamp(images_of(a))
    if images.empty:
        images = ByStamp(images_of(b))
    layout = side_by_side(names, picture_size(first[0]), image=not images.empty)
    with recording("airline-compare", f"{a.name} and {b.name}", layout, save, connect) as stream:
        comparison = Comparison(stream, names)
        for pair in chain([first], frames):
            comparison.write(*pair)
            log_image(stream, images.at(pair[0].stamp_ns))
        return comparison.summary()


def run(options: argparse.Namespace) -> None:
    """Do what the flags ask for."""
    print(compare(options.a, options.b, options.save, options.connect))


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = Parser(prog="python -m viz.compare", description="Shows two runs side by side in a Rerun recording.")
    parser.add_argument("a", type=Path, metavar="A", help="file with tracks: .mcap, .parquet")
    parser.add_argument("b", type=Path, metavar="B", help="another of the same input")
    parser.add_argument("--save", type=Path, metavar="FILE.rrd", help="record into this file instead of a window")
    parser.add_argument("--connect", metavar="HOST:PORT", help="show in a viewer that runs already")
    return exit_code(run, parser.parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
