"""The evaluation's figures as tables for a terminal of 100 columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from frontend.evaluation.consistency import FRAMES, LENGTHS
from frontend.evaluation.stereo import DISTANCES

if TYPE_CHECKING:
    from rich.table import Table

LEGEND = """\
All trackers get the same lines in the same run. A line counts where it is
known which true line it belongs to.
P, R: precision and recall of links, %. A link is a track seen in two
  consecutive frames; it is right when both lines belong to the same true
  line. wrong: how many links are not.
IDF1: one track for each true line and one true line for each track, %.
switch: changes of a true line's track per 100 frames; frag: those of them
  after frames in which the true line was not tracked.
length, med: frames in which a track was seen, mean and median. of: mean frames
  in which a true line was detected. >=3, >=5, >=10: tracks seen so often, %.
visible: mean frames in which 15 px of a true line or more could be seen, of
  lines seen so in 5 frames and detected in one; covered: those of them in
  which the track that was on it most was on it; share: both as sums, %; all:
  the same with lines that were never detected. 80 %: lines covered for 80 %
  of their life. <3: tracks seen in less than 3 frames, and such that were
  handed out as confirmed, %.
jitter: end points against the true line, about the true motion; rms.
Lines against the truth: of tracks seen in 4 frames and more. observed:
  detected and measured. across: end points from the true infinite line, px,
  rms and what 68 % are below; along: from the true ends, rms.
  offset, angle: error over the standard deviation that the tracker gives,
  what 68 % are below and the rms with errors cut at 3: 1 where covariances
  are honest.
One line in space: of tracks seen in 5 frames and more those are good of which
  all end points stay within 2 px of the line in space that fits them. share:
  %; a frame: observations of good tracks over the clip's frames; rms: their
  end points from that line, px; length: their mean frames. fused: the same of
  the tracker's fused lines; stable: of the observations that it calls so.
  Below: share of good tracks, and of how many, by the mean length of what was
  observed and by frames.
ms: median time of a tracker's update."""

MATCH_LEGEND = """\
P, R, F: precision, recall and their harmonic mean, %. Of labelled frames, some
frames apart: a pair is right when both lines belong to the same true line;
those without a true line count for nothing; R is of the true lines that were
detected in both. Of views of a plane: when the first line, moved as the plane
is, lies on the second one, to so many px in the mean of the four distances of
an end from the other line, 10 degrees, and half of their lengths; R is of the
pairs that could be made so. votes: frontend.match; nearest: nearest neighbour
where the line was; moved: where votes' homography has it."""

STEREO_LEGEND = """\
ours: partners of the tracks. plain: LSD in both images, tracks by optical flow,
and of the lines with the same rows, direction and grey levels the one with the
least disparity. P: precision of partners whose true lines are known in both
images, %; wrong: how many are not right; unknown: how many others there are.
R: of lines that can be seen in both images those with the right partner, %.
depth: partners that tell how far away both ends are, flat: such along the
rows, %. rms, median: of the disparity's errors at the ends, px. chi2: mean of
their squares over what the variances say, 1 where these are honest.
By distance: median error over it, % (ends). Lines from a first pair: of tracks
seen in 5 frames and more those whose first pair tells their line in space;
always, usually: it is within 2 px of what was seen in all later frames, in the
median one. At rest: tracks of upright lines in half of the pairs and more, the
median length and distance of the median one, and the spread over the pairs
(1.48 times the median deviation). ms: median time of matching."""

Row = Mapping[str, Any]  # a tracker's figures
Columns = Mapping[str, str | Callable[[Row], str]]  # by their headings: a figure's key, with % for shares


def _text(row: Row, column: str | Callable[[Row], str]) -> str:
    if not isinstance(column, str):
        return column(row)
    value = row[column.removesuffix(" %")]
    if value is None or isinstance(value, int):
        return "-" if value is None else str(value)
    return f"{100 * value:.1f}" if column.endswith("%") else f"{value:.2f}"


def _group(kind: str, name: str, what: str = "share", count: str = "tracks") -> Callable[[Row], str]:
    """A share, and of how many, among those of one kind."""
    return lambda row: f"{_text(row[kind][name], f'{what} %')} ({row[kind][name][count]})"


IDENTITIES: Columns = {
    **{"P": "link_precision %", "R": "link_recall %", "wrong": "wrong_links", "IDF1": "idf1 %"},
    **{"switch": "switches_per_100", "frag": "fragments_per_100", "ms": "ms"},
}
LIVES: Columns = {
    **{"tracks": "tracks", "length": "track_length_mean", "med": "track_length_median", "of": "visible_length_mean"},
    **{">=3": "alive_3 %", ">=5": "alive_5 %", ">=10": "alive_10 %"},
}
COVERAGE: Columns = {
    **{"lines": "lines", "visible": "visible_mean", "covered": "covered_mean", "share": "coverage %"},
    **{"all": "coverage_of_all %", "80 %": "covered_most %", "<3": "under_3 %", "confirmed": "confirmed_under_3 %"},
}
JITTER: Columns = {"across": "jitter_across_px", "along": "jitter_along_px"}
ACCURACY: Columns = {
    **{"lines": "lines", "across": "across_px", "68 %": "across_68_px", "along": "along_px"},
    **{"offset": "offset_68", "rms": "offset_rms", "angle": "angle_68", "rms ": "angle_rms"},
}
MATCHES: Columns = {
    **{"first": "lines", "pairs": "pairs", "P": "precision %", "R": "recall %", "F": "f %"},
    **{"P 3px": "precision_3px %", "R 3px": "recall_3px %", "F 3px": "f_3px %"},
    **{"P 5px": "precision_5px %", "R 5px": "recall_5px %", "F 5px": "f_5px %", "ms": "ms"},
}
CONSISTENT: Columns = {
    **{"tracks": "tracks", "good": "consistent", "share": "share %", "a frame": "observations_per_frame"},
    **{"rms": "rms_across_px", "length": "length_mean", "ms": "ms"},
}
PARTNERS: Columns = {
    **{"pairs": "partners", "P": "precision %", "wrong": "wrong", "unknown": "unknown", "R": "recall %", "ms": "ms"},
}
DISPARITIES: Columns = {
    **{"depth": "depth_known %", "flat": "along_rows %"},
    **{"rms": "disparity_rms_px", "median": "disparity_median_px", "chi2": "chi2"},
}
FIRST_PAIRS: Columns = {
    **{"tracks": "tracks", "of": "of", "always": "always", "share": "always_share %"},
    **{"usually": "usually", "share ": "usually_share %", "ms": "ms"},
}
AT_REST: Columns = {
    **{"tracks": "tracks", "length, m": "length_m", "spread, %": "length_spread %"},
    **{"distance, m": "depth_m", "spread, % ": "depth_spread %", "ms": "ms"},
}
BY_LENGTH: Columns = {f"{name} px": _group("by_length", name) for name in LENGTHS}
BY_FRAMES: Columns = {name: _group("by_frames", name) for name in FRAMES}
BY_DISTANCE: Columns = {f"from {low} m": _group("depth", f"{low}", "error", "ends") for low in DISTANCES}


# What the figures of a kind, by clip and tracker, are shown in: title and columns.
TABLES: Mapping[str, Mapping[str, Columns]] = {
    "matches": {"Pairs of lines of two images": MATCHES},
    "partners": {
        "Partners in the right image": PARTNERS,
        "Their disparities": DISPARITIES,
        "Error of distances, %": BY_DISTANCE,
    },
    "first_pairs": {"Lines from a first pair": FIRST_PAIRS},
    "at_rest": {"Upright lines at rest": AT_REST},
    "sequences": {
        "Identities": IDENTITIES,
        "Tracks": LIVES,
        "True lines and the tracks that cover them": COVERAGE,
        "Jitter of end points, px": JITTER,
    },
    "accuracy": {"Lines against the truth": ACCURACY},
    "posed": {
        "Tracks that are one line in space": CONSISTENT,
        "The same by length of line, %": BY_LENGTH,
        "The same by frames, %": BY_FRAMES,
    },
}


def show(figures: Mapping[str, Mapping[str, Mapping[str, Row]]], legend: str) -> None:
    """Print all tables that have rows: of every kind, by the name of the clip, then of the tracker."""
    from rich.console import Console

    console = Console()
    for kind, clips in figures.items():
        for title, columns in TABLES[kind].items() if clips else ():
            console.print(_table(title, clips, columns))
    console.print(legend)


def _table(title: str, clips: Mapping[str, Mapping[str, Row]], columns: Columns) -> Table:
    """The name of every clip, and a row for each of its trackers."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column()  # the only one that wraps where the terminal is narrow
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    for clip, rows in clips.items():
        table.add_row(clip)
        for name, row in rows.items():
            table.add_row(f"  {name}", *(_text(row, column) for column in columns.values()))
        table.add_section()
    return table
