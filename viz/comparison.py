"""Two runs on the same images in one recording: matching lines in matching colours."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from frontend.tracks import LineTracks
from viz.matching import Partners, TrackLengths, match_lines
from viz.strips import strips_2d
from viz.track_lines import CONFIRMED_RADIUS, TENTATIVE_RADIUS, log_tracks
from viz.track_recording import Clock, dark, encoded_image, size_of

if TYPE_CHECKING:
    from rich.table import Table

UNMATCHED = (190, 190, 190)
SIDES = ("a", "b")
SERIES = {"a": (255, 150, 40), "b": (60, 170, 255), "matched": (120, 220, 120)}
DISTANCE_STEP = 0.01  # px, of the histogram that the median is taken from


@dataclass
class Side:
    """Figures of one run so far.

    Attributes:
        name: shown to people.
        lines: in all frames.
        matched: those of them that the other run has too.
        lengths: of its tracks, in the frames that both runs have.
    """

    name: str
    lines: int = 0
    matched: int = 0
    lengths: TrackLengths = field(default_factory=TrackLengths)


class Comparison:
    """Logs the frames of two runs, and counts.

    `/camera/image`, and for `/a` and `/b` each: `tracks`, coloured by the tracks of A, and `unmatched`, grey. Figures
    are below `/stats`. Timelines are `frame` and `sensor_time`, those of A.

    Args:
        stream: where to log to.
        names: of the two runs.
    """

    def __init__(self, stream: rr.RecordingStream, names: tuple[str, str]) -> None:
        self.sides = Side(names[0]), Side(names[1])
        self.frames = 0
        self._stream = stream
        self._clock = Clock(stream)
        self._partners = Partners()
        self._distances = np.zeros(1024, np.int64)

    def write(self, a: LineTracks, b: LineTracks, image: bytes | None = None) -> None:
        """Log one frame of both runs.

        Args:
            a, b: the tracks of the same image.
            image: that image, as JPEG or PNG.
        """
        if not self.frames:
            self._start(a, has_image=image is not None)
        self.frames += 1
        self._clock.set(a.frame_index, a.stamp_ns)
        if image is not None:
            self._stream.log("/camera/image", encoded_image(image))
        rows, columns, distances = match_lines(a.segments_px, b.segments_px)
        self._log_lines("/a", a, rows, a.ids[rows])
        self._log_lines("/b", b, columns, self._partners.update(b.ids[columns], a.ids[rows]))
        for side, tracks in zip(self.sides, (a, b), strict=True):
            side.lines += len(tracks)
            side.matched += len(rows)
            side.lengths.add(tracks.ids)
        steps = np.rint(distances / DISTANCE_STEP).astype(int)
        self._distances += np.bincount(steps, minlength=len(self._distances))
        self._log_figures(a, b, distances)

    @property
    def median_distance(self) -> float | None:
        """Of all matched lines, px, to 0.01 px; None without any."""
        total = np.cumsum(self._distances)
        return None if not total[-1] else float(np.searchsorted(total, (total[-1] + 1) // 2) * DISTANCE_STEP)

    def table(self) -> Table:
        """The figures of both runs, for the terminal."""
        from rich.box import SIMPLE_HEAD
        from rich.table import Table
        from rich.text import Text

        distance = self.median_distance
        apart = "none" if distance is None else f"{distance:.2f} px apart (median)"
        title = f"{self.frames} frames; matched lines are {apart}"
        table = Table(title=title, title_justify="left", box=SIMPLE_HEAD)
        table.add_column("run", no_wrap=True)
        for column in ("lines", "per frame", "matched, %", "tracks", "median length", "mean"):
            table.add_column(column, justify="right")
        for side in self.sides:
            lengths = side.lengths.lengths()
            figures = [str(side.lines), f"{side.lines / max(self.frames, 1):.1f}"]
            figures += [f"{100 * side.matched / side.lines:.1f}" if side.lines else "-", str(len(lengths))]
            figures += [f"{np.median(lengths):.0f}", f"{lengths.mean():.1f}"] if len(lengths) else ["-", "-"]
            table.add_row(Text(side.name), *figures)
        return table

    def _start(self, a: LineTracks, *, has_image: bool) -> None:
        for group in ("lines", "matched_share", "track_length"):
            for name in (*SIDES, "matched") if group == "lines" else SIDES:
                label = name if name == "matched" else self.sides[SIDES.index(name)].name
                look = rr.SeriesLines(names=label, colors=SERIES[name], widths=1.5)
                self._stream.log(f"/stats/{group}/{name}", look, static=True)
        if not has_image:
            self._stream.log("/camera/image", dark(*size_of(a)), static=True)

    def _log_lines(self, root: str, tracks: LineTracks, rows: NDArray[np.int64], colour_ids: NDArray[np.int64]) -> None:
        order = np.argsort(rows)  # ids stay ascending
        log_tracks(self._stream, _rows(tracks, rows[order]), root=root, colour_ids=colour_ids[order])
        rest = np.delete(np.arange(len(tracks)), rows)
        radii = np.where(tracks.confirmed[rest], CONFIRMED_RADIUS, TENTATIVE_RADIUS)
        strips = rr.LineStrips2D(
            strips_2d(tracks.segments_px[rest]), colors=UNMATCHED, radii=rr.Radius.ui_points(radii)
        )
        self._stream.log(f"{root}/unmatched", strips, rr.AnyValues(track_id=tracks.ids[rest]))

    def _log_figures(self, a: LineTracks, b: LineTracks, distances: NDArray[np.float64]) -> None:
        figures = {"lines/matched": float(len(distances))}
        for name, tracks in zip(SIDES, (a, b), strict=True):
            ages = tracks.ages[tracks.confirmed]
            figures[f"lines/{name}"] = float(len(tracks))
            figures[f"matched_share/{name}"] = 100 * len(distances) / len(tracks) if len(tracks) else 0.0
            figures[f"track_length/{name}"] = float(np.median(ages)) if len(ages) else 0.0
        if len(distances):
            figures["distance"] = float(np.median(distances))
        for path, value in figures.items():
            self._stream.log(f"/stats/{path}", rr.Scalars(value))


def layout(names: tuple[str, str], size: tuple[int, int]) -> rrb.Blueprint:
    """Both runs side by side on the same part of the image, their figures below on one time axis.

    Args:
        names: of the runs.
        size: width and height of the image, px.
    """
    bounds = rrb.VisualBounds2D(x_range=(0, size[0]), y_range=(0, size[1]))
    views = [
        rrb.Spatial2DView(
            origin="/camera/image",
            contents=["/camera/image", f"/{side}/tracks/**", f"/{side}/unmatched"],
            name=name,
            visual_bounds=bounds,
        )
        for side, name in zip(SIDES, names, strict=True)
    ]
    plots = {
        "lines": "Lines per frame",
        "matched_share": "Matched lines, %",
        "track_length": "Track length (frames)",
        "distance": "Distance of matched lines (px)",
    }
    axis = rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
    figures = [
        rrb.TimeSeriesView(
            origin=f"/stats/{path}", name=name, axis_x=axis, plot_legend=rrb.PlotLegend(visible=path == "lines")
        )
        for path, name in plots.items()
    ]
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(*views), rrb.Horizontal(*figures), row_shares=[3, 1]),
        rrb.TimePanel(state="collapsed", timeline="frame"),
        collapse_panels=True,
    )


def _rows(tracks: LineTracks, rows: NDArray[np.int64]) -> LineTracks:
    """Some of the tracks. Fragments count as whole lines, as their darker tone would hide which line is which."""
    return replace(
        tracks.take(rows),
        fragment_of=np.full(len(rows), -1),
        lost_ids=tracks.lost_ids[:0],
        lost_segments_px=tracks.lost_segments_px[:0],
    )
