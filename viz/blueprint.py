"""How the viewer lays a run out: the tracks large, the detector's stages beside them, the figures below."""

from __future__ import annotations

import rerun.blueprint as rrb


def layout() -> rrb.Blueprint:
    """The blueprint of a run. It goes into the recording, so that the file opens like the live viewer."""
    stages = rrb.Vertical(
        _camera_view("Edges", "/camera/edges"),
        _camera_view("Orientation", "/camera/orientation"),
        _camera_view("Segments", "/camera/image", "/camera/segments"),
    )
    tracks = _camera_view("Tracks", "/camera/image", "/camera/tracks")
    single = rrb.PlotLegend(visible=False)
    columns = rrb.TextLogColumns(text_log_columns=["loglevel", "body"])
    figures = rrb.Horizontal(
        rrb.TimeSeriesView(origin="/stats/counts", name="Lines per frame"),
        rrb.TimeSeriesView(origin="/stats/track_length", name="Track length (frames)", plot_legend=single),
        rrb.TimeSeriesView(origin="/stats/time_ms", name="Time per stage (ms)"),
        rrb.TextLogView(origin="/log", name="Log", columns=columns),
    )
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(tracks, stages, column_shares=[5, 2]), figures, row_shares=[3, 1]),
        rrb.TimePanel(state="collapsed", timeline="frame"),
        collapse_panels=True,
    )


def _camera_view(name: str, picture: str, *above: str) -> rrb.Spatial2DView:
    """Its origin is the picture: at the pinhole above it, lines vanish when fx != fy (rerun-io/rerun#12711)."""
    return rrb.Spatial2DView(origin=picture, contents=[picture, *above], name=name)
