"""The figures as tables for the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

Figures = dict[str, Any]


def tables(name: str, figures: Figures) -> Iterator[Table]:
    """What was measured of the detector `name`, and of LSD where that ran beside it."""
    rivals = {name: figures} | ({"LSD": figures["lsd"]} if "lsd" in figures else {})
    yield _scores(rivals)
    yield _lines(rivals)
    if "bad_light" in figures:
        yield _bad_light(name, figures["bad_light"])


def ablation(rows: dict[str, Figures]) -> Table:
    """Scores, lines per image and median ms of every variant of the detector."""
    radii = next(iter(rows.values()))["lp"]
    table = _table("Ablation, %", *(f"LP{radius}" for radius in radii), "P2", "R2", "F2", "lines", "ms")
    for name, figures in rows.items():
        scores = [*figures["lp"].values(), *(figures[key] for key in ("p2", "r2", "f2"))]
        table.add_row(name, *(f"{value:.1f}" for value in scores), f"{figures['lines']:.0f}", f"{figures['ms']:.1f}")
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table("", title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for column in columns:
        table.add_column(column, justify="right")
    return table


def _scores(rivals: dict[str, Figures]) -> Table:
    radii = next(iter(rivals.values()))["lp"]
    table = _table("Scores, %", *(f"LP{radius}" for radius in radii), "P2", "R2", "F2", "F1")
    for name, figures in rivals.items():
        values = [*figures["lp"].values(), *(figures[key] for key in ("p2", "r2", "f2", "f1"))]
        table.add_row(name, *(f"{value:.1f}" for value in values))
    return table


def _lines(rivals: dict[str, Figures]) -> Table:
    """Line counts, and what only a detector that ran here has: repeatability, localisation, time."""
    formats = {
        "lines": ("lines", "{:.1f}"),
        "repeatability": ("repeatability", "{:.3f}"),
        "localisation": ("localisation, px", "{:.3f}"),
        "ms": ("median ms", "{:.1f}"),
    }
    known = [key for key in formats if key in next(iter(rivals.values()))]
    table = _table("Lines per image", *(formats[key][0] for key in known))
    for name, figures in rivals.items():
        values = (figures[key] for key in known)
        table.add_row(
            name, *("-" if v is None else formats[k][1].format(v) for k, v in zip(known, values, strict=True))
        )
    return table


def _bad_light(name: str, lights: Figures) -> Table:
    table = _table("Bad light, %", "P2", "R2", "F2")
    for light, figures in lights.items():
        rows = {name: figures, "LSD": figures["lsd"], "LSD, prepared": figures["lsd_prepared"]}
        for row, scores in rows.items():
            table.add_row(f"{light}: {row}", *(f"{scores[key]:.1f}" for key in ("p2", "r2", "f2")))
        table.add_section()
    return table
