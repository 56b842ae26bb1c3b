"""How the viewer lays recordings out; a layout goes into the recording, so that the file opens like the live view."""

from __future__ import annotations

from typing import Literal

import numpy as np
import rerun.blueprint as rrb

Kind = Literal["minimal", "default", "full"]
CLEAN, REST = ("/camera/tracks", "/camera/tails", "/camera/points"), ("/camera/tracks/rest", "/camera/tracks/lost")
BOLD, TAILS = "bold: long and old", "tails: where they were"
PARTNERS = "Their partners in the right image"
BEHIND, AHEAD = np.array([-4.0, -7.0, -10.0]), np.array([0.0, 0.0, 20.0])  # baselines from the left camera
WIDE = 2.5  # images of this width to height have the whole width of the window


def layout(
    kind: Kind = "default",
    size: tuple[int, int] | None = None,
    *,
    image: bool = True,
    stages: bool = True,
    space: bool = False,
    right: bool = False,
    baseline_m: float = 0.0,
) -> rrb.Blueprint:
    """The blueprint of a run.

    Args:
        kind: minimal shows the image with its tracks, their number and the log; default adds the detector's stages and
            all figures; full shows all tracks, tentative and lost ones too.
        size: width and height of the image, px; it decides what is beside what.
        image: whether the recording has the camera's image.
        stages: whether the recording has the detector's stages.
        space: whether it has poses or lines in space.
        right: whether it has a right image, which goes beside the left one.
        baseline_m: of two cameras without poses, whose lines in space are seen from behind them; 0 for a view of all.
    """
    aspect = size[0] / size[1] if size else 4 / 3
    wide = aspect >= WIDE
    below = ["/camera/image"] if image else []
    title, parts = f"Tracks ({BOLD}, thin: other confirmed ones, {TAILS})", [*CLEAN]
    if kind == "full":
        title, parts = f"All tracks ({BOLD}, thin: all others, grey: lost, {TAILS})", [*REST, *CLEAN]
    tracks: rrb.View | rrb.Container = _camera_view(title, *below, *parts)
    if right:
        names = ["/right/image"] * image + ["/right/tracks/rest"] * (kind == "full") + ["/right/tracks"]
        pair = rrb.Vertical if wide and kind == "minimal" else rrb.Horizontal
        tracks = pair(tracks, _camera_view(PARTNERS, *names))
    counts = _plot("counts", "Lines per frame", rrb.PlotLegend(corner="LeftTop"))
    columns = rrb.TextLogColumns(text_log_columns=["loglevel", "body"])
    log = rrb.TextLogView(origin="/log", name="Log", columns=columns)
    if kind == "minimal":
        return _blueprint(rrb.Vertical(tracks, rrb.Horizontal(counts, log), row_shares=[4, 1]))
    length = _plot("track_length", "Track length (frames)", rrb.PlotLegend(visible=False))
    times = _plot("time_ms", "Time per stage (ms)", rrb.PlotLegend(corner="LeftTop"))
    figures = rrb.Horizontal(counts, times, length, log, column_shares=[3, 3, 2, 2])
    if right:
        partners = _plot("partners", "With a partner", rrb.PlotLegend(corner="LeftTop"))
        figures = rrb.Horizontal(counts, times, length, partners, log, column_shares=[3, 3, 2, 2, 2])
    views: list[rrb.View | rrb.Container] = [_space_view(baseline_m)] if space else []
    if stages:
        pictures = [
            _camera_view("Edges", "/camera/edges"),
            _camera_view("Orientation (hue: angle)", "/camera/orientation"),
            _camera_view("Regions of lines", "/camera/regions"),
            _camera_view("Segments (hue: angle)", *below, "/camera/segments"),
        ]
        views.append(rrb.Grid(*pictures, grid_columns=4 if wide and not right else 2))
    if not views:
        return _blueprint(rrb.Vertical(tracks, figures, row_shares=[5, 2]))
    if right:
        share = min(8 / aspect + 0.4, 4.5)  # of the window's height, which is 10 to 16 of its width
        return _blueprint(rrb.Vertical(tracks, rrb.Horizontal(*views), figures, row_shares=[share, 8 - share, 2]))
    if wide:
        shares = [16 / aspect, 4 / aspect + 0.5 if not space else 4, 3]
        return _blueprint(rrb.Vertical(tracks, rrb.Horizontal(*views), figures, row_shares=shares))
    share = min(max(0.44 * aspect, 0.35), 0.6)  # of the window's width
    top = rrb.Horizontal(tracks, rrb.Vertical(*views), column_shares=[share, 1 - share])
    return _blueprint(rrb.Vertical(top, figures, row_shares=[5, 2]))


def side_by_side(names: tuple[str, str], size: tuple[int, int], *, image: bool) -> rrb.Blueprint:
    """The blueprint of a comparison of two runs, with their figures below on one time axis; wide ones are stacked."""
    below = ["/camera/image"] if image else []
    views = [
        _camera_view(name, *below, f"/{side}/tracks", f"/{side}/unmatched")
        for side, name in zip("ab", names, strict=True)
    ]
    axis = rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
    plots = {
        "lines": "Lines per frame",
        "matched_share": "Matched lines, %",
        "track_length": "Track length (frames)",
        "distance": "Distance of matched lines (px)",
    }
    figures = [_plot(path, name, rrb.PlotLegend(visible=path == "lines"), axis) for path, name in plots.items()]
    top = (rrb.Vertical if size[0] >= WIDE * size[1] else rrb.Horizontal)(*views)
    return _blueprint(rrb.Vertical(top, rrb.Horizontal(*figures), row_shares=[3, 1]))


def _blueprint(root: rrb.Container) -> rrb.Blueprint:
    return rrb.Blueprint(root, rrb.TimePanel(state="collapsed", timeline="frame"), collapse_panels=True)


def _plot(path: str, name: str, legend: rrb.PlotLegend, axis: rrb.TimeAxis | None = None) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin=f"/stats/{path}", name=name, plot_legend=legend, axis_x=axis)


def _camera_view(name: str, *contents: str) -> rrb.Spatial2DView:
    """Its origin is the first, the picture: at the pinhole above it, lines vanish when fx != fy (rerun#12711)."""
    return rrb.Spatial2DView(origin=contents[0], contents=list(contents), name=name)


def _space_view(baseline_m: float) -> rrb.Spatial3DView:
    """The camera's way is logged step by step; the view shows all steps so far."""
    eye = None
    if baseline_m:
        eye = rrb.EyeControls3D(position=baseline_m * BEHIND, look_target=baseline_m * AHEAD, eye_up=(0, -1, 0))
    start, end = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    ranges = [rrb.VisibleTimeRange(timeline, start=start, end=end) for timeline in ("frame", "sensor_time")]
    return rrb.Spatial3DView(
        origin="/",
        contents=["/world/**", "/camera", "/camera/image"],
        name="Space",
        overrides={"/world/path": rrb.VisibleTimeRanges(ranges)},
        eye_controls=eye,
    )
