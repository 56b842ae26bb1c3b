"""The figures as tables for the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rich.box import SIMPLE_HEAD
from rich.table import Table

from frontend.evaluation.metrics import Figures

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
Clips = Mapping[str, Mapping[str, Figures]]  # clip, tracker

_IDENTITIES: dict[str, Column] = {
    "P": ("link_precision", 100, ".1f"),
    "R": ("link_recall", 100, ".1f"),
    "wrong": ("wrong_links", 1, "d"),
    "IDF1": ("idf1", 100, ".1f"),
    "switch": ("switches_per_100", 1, ".0f"),
    "frag": ("fragments_per_100", 1, ".0f"),
    "ms": ("ms", 1, ".1f"),
}
_LENGTHS: dict[str, Column] = {
    "tracks": ("tracks", 1, "d"),
    "length": ("track_length_mean", 1, ".1f"),
    "med": ("track_length_median", 1, ".0f"),
    "pure": ("pure_length_mean", 1, ".1f"),
    "of": ("visible_length_mean", 1, ".1f"),
    ">=3": ("alive_3", 100, ".0f"),
    ">=5": ("alive_5", 100, ".0f"),
    ">=10": ("alive_10", 100, ".0f"),
}
_END_POINTS: dict[str, Column] = {
    "across": ("jitter_across_px", 1, ".2f"),
    "along": ("jitter_along_px", 1, ".1f"),
}
_POSED: dict[str, Column] = {
    "tracks": ("tracks_5", 1, "d"),
    "consistent": ("consistent_tracks", 1, "d"),
    "share": ("consistent_share", 100, ".1f"),
    "length": ("consistent_length_mean", 1, ".1f"),
    "parallax": ("parallax_deg", 1, ".2f"),
    "ms": ("ms", 1, ".1f"),
}


def sequence_tables(clips: Clips) -> Iterator[Table]:
    """Trackers on clips with known identities."""
    yield _table("Identities", clips, _IDENTITIES)
    yield _table("Tracks", clips, _LENGTHS)
    yield _table("Jitter of the end points, px", clips, _END_POINTS)


def posed_table(clips: Clips) -> Table:
    """Trackers on clips with known poses."""
    return _table("Tracks seen in 5 frames and more, and those that are one line in space", clips, _POSED)


def _table(title: str, clips: Clips, columns: Mapping[str, Column]) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column(no_wrap=True, min_width=max(map(len, clips)))
    table.add_column(no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right")
    for clip, trackers in clips.items():
        for k, (tracker, figures) in enumerate(trackers.items()):
            texts = (_text(figures[key], factor, form) for key, factor, form in columns.values())
            table.add_row("" if k else clip, tracker, *texts)
        table.add_section()
    return table


def _text(value: float | int | None, factor: int, form: str) -> str:
    return "-" if value is None else format(value * factor, form)
