"""How the viewer lays a run out."""

from __future__ import annotations

from typing import Literal

import rerun.blueprint as rrb

Kind = Literal["minimal", "full"]
LINES = ("/camera/tracks", "/camera/tracks/lost", "/camera/tails")


def layout(kind: Kind = "full", *, image: bool = True, stages: bool = True, space: bool = False) -> rrb.Blueprint:
    """The blueprint of a run. It goes into the recording, so that the file opens like the live viewer.

    Args:
        kind: minimal shows the image with its tracks, their number and the log; full adds the detector's stages and
            all figures.
        image: whether the recording has the camera's image.
        stages: whether the recording has the detector's stages.
        space: whether it has poses or lines in space.
    """
    below = ["/camera/image"] if image else []
    tracks = _camera_view("Tracks", *below, *LINES)
    counts = rrb.TimeSeriesView(
        origin="/stats/counts", name="Lines per frame", plot_legend=rrb.PlotLegend(corner="RightBottom")
    )
    columns = rrb.TextLogColumns(text_log_columns=["loglevel", "body"])
    log = rrb.TextLogView(origin="/log", name="Log", columns=columns)
    if kind == "minimal":
        figures = rrb.Horizontal(counts, log)
        return _blueprint(rrb.Vertical(tracks, figures, row_shares=[4, 1]))
    length = rrb.TimeSeriesView(
        origin="/stats/track_length", name="Track length (frames)", plot_legend=rrb.PlotLegend(visible=False)
    )
    times = rrb.TimeSeriesView(
        origin="/stats/time_ms", name="Time per stage (ms)", plot_legend=rrb.PlotLegend(corner="RightTop")
    )
    figures = rrb.Horizontal(counts, length, times, log)
    beside: list[rrb.View | rrb.Container] = []
    if space:
        beside.append(_space_view())
    if stages:
        beside.append(
            rrb.Grid(
                _camera_view("Edges", "/camera/edges"),
                _camera_view("Orientation (hue = angle)", "/camera/orientation"),
                _camera_view("Regions of lines", "/camera/regions"),
                _camera_view("Segments", *below, "/camera/segments"),
                grid_columns=2,
            )
        )
    top = rrb.Horizontal(tracks, rrb.Vertical(*beside), column_shares=[3, 2])
    return _blueprint(rrb.Vertical(top if beside else tracks, figures, row_shares=[3, 1]))


def _blueprint(root: rrb.Container) -> rrb.Blueprint:
    return rrb.Blueprint(root, rrb.TimePanel(state="collapsed", timeline="frame"), collapse_panels=True)


def _camera_view(name: str, *contents: str) -> rrb.Spatial2DView:
    """Its origin is the first, the picture: at the pinhole above it, lines vanish when fx != fy (rerun#12711)."""
    return rrb.Spatial2DView(origin=contents[0], contents=list(contents), name=name)


def _space_view() -> rrb.Spatial3DView:
    """The camera's way is logged step by step; the view shows all steps so far."""
    so_far = rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(
                timeline, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
            )
            for timeline in ("frame", "sensor_time")
        ]
    )
    return rrb.Spatial3DView(
        origin="/", contents=["/world/**", "/camera", "/camera/image"], name="Space", overrides={"/world/path": so_far}
    )
