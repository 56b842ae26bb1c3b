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
Columns = Mapping[str, Callable[[Row], str]]


def _number(key: str, form: str, factor: int = 1) -> Callable[[Row], str]:
    return lambda row: "-" if row[key] is None else format(row[key] * factor, form)


def _group(kind: str, name: str, what: str = "share", count: str = "tracks", form: str = ".0f") -> Callable[[Row], str]:
    share = _number(what, form, 100)
    return lambda row: f"{share(row[kind][name])} ({row[kind][name][count]})"


IDENTITIES: Columns = {
    "P": _number("link_precision", ".1f", 100),
    "R": _number("link_recall", ".1f", 100),
    "wrong": _number("wrong_links", "d"),
    "IDF1": _number("idf1", ".1f", 100),
    "switch": _number("switches_per_100", ".0f"),
    "frag": _number("fragments_per_100", ".0f"),
    "ms": _number("ms", ".1f"),
}
LIVES: Columns = {
    "tracks": _number("tracks", "d"),
    "length": _number("track_length_mean", ".1f"),
    "med": _number("track_length_median", ".0f"),
    "of": _number("visible_length_mean", ".1f"),
    ">=3": _number("alive_3", ".0f", 100),
    ">=5": _number("alive_5", ".0f", 100),
    ">=10": _number("alive_10", ".0f", 100),
}
COVERAGE: Columns = {
    "lines": _number("lines", "d"),
    "visible": _number("visible_mean", ".1f"),
    "covered": _number("covered_mean", ".1f"),
    "share": _number("coverage", ".1f", 100),
    "all": _number("coverage_of_all", ".1f", 100),
    "80 %": _number("covered_most", ".1f", 100),
    "<3": _number("under_3", ".1f", 100),
    "confirmed": _number("confirmed_under_3", ".1f", 100),
}
JITTER: Columns = {"across": _number("jitter_across_px", ".2f"), "along": _number("jitter_along_px", ".1f")}
ACCURACY: Columns = {
    "lines": _number("lines", "d"),
    "across": _number("across_px", ".3f"),
    "68 %": _number("across_68_px", ".3f"),
    "along": _number("along_px", ".2f"),
    "offset": _number("offset_68", ".2f"),
    "rms": _number("offset_rms", ".2f"),
    "angle": _number("angle_68", ".2f"),
    "rms ": _number("angle_rms", ".2f"),
}
MATCHES: Columns = {
    "first": _number("lines", ".0f"),
    "pairs": _number("pairs", "d"),
    **{
        f"{name}{px}": _number(f"{key}{px and '_' + px.strip()}", ".1f", 100)
        for px in ("", " 3px", " 5px")
        for name, key in (("P", "precision"), ("R", "recall"), ("F", "f"))
    },
    "ms": _number("ms", ".0f"),
}
CONSISTENT: Columns = {
    "tracks": _number("tracks", "d"),
    "good": _number("consistent", "d"),
    "share": _number("share", ".1f", 100),
    "a frame": _number("observations_per_frame", ".1f"),
    "rms": _number("rms_across_px", ".2f"),
    "length": _number("length_mean", ".1f"),
    "ms": _number("ms", ".1f"),
}
PARTNERS: Columns = {
    "pairs": _number("partners", "d"),
    "P": _number("precision", ".1f", 100),
    "wrong": _number("wrong", "d"),
    "unknown": _number("unknown", "d"),
    "R": _number("recall", ".1f", 100),
    "ms": _number("ms", ".1f"),
}
DISPARITIES: Columns = {
    "depth": _number("depth_known", ".0f", 100),
    "flat": _number("along_rows", ".0f", 100),
    "rms": _number("disparity_rms_px", ".2f"),
    "median": _number("disparity_median_px", ".2f"),
    "chi2": _number("chi2", ".2f"),
}
FIRST_PAIRS: Columns = {
    "tracks": _number("tracks", "d"),
    "of": _number("of", "d"),
    "always": _number("always", "d"),
    "share": _number("always_share", ".1f", 100),
    "usually": _number("usually", "d"),
    "share ": _number("usually_share", ".1f", 100),
    "ms": _number("ms", ".1f"),
}
AT_REST: Columns = {
    "tracks": _number("tracks", "d"),
    "length, m": _number("length_m", ".2f"),
    "spread, %": _number("length_spread", ".1f", 100),
    "distance, m": _number("depth_m", ".2f"),
    "spread, % ": _number("depth_spread", ".1f", 100),
    "ms": _number("ms", ".1f"),
}
BY_LENGTH: Columns = {f"{name} px": _group("by_length", name) for name in LENGTHS}
BY_FRAMES: Columns = {name: _group("by_frames", name) for name in FRAMES}
BY_DISTANCE: Columns = {f"from {low} m": _group("depth", f"{low}", "error", "ends", ".1f") for low in DISTANCES}


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
            table.add_row(f"  {name}", *(text(row) for text in columns.values()))
        table.add_section()
    return table
