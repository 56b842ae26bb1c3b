"""The figures as tables for the terminal."""

from __future__ import annotations

from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

Figures = dict[str, Any]
PIXELS = ("p2", "r2", "f2")  # all detectors have them, in any light
LINES = {"lines": 1, "repeatability": 3, "localisation": 3, "ms": 1}  # decimals
TITLES = {"localisation": "localisation, px", "ms": "median ms"}


def tables(name: str, figures: Figures) -> list[Table]:
    """What was measured of the detector `name`, and of LSD where that ran beside it."""
    rivals = {name: figures} | ({"LSD": figures["lsd"]} if "lsd" in figures else {})
    found = [
        _table("Scores, %", rivals, dict.fromkeys((*PIXELS, "f1"), 1)),
        _table("Lines per image", rivals, {key: n for key, n in LINES.items() if key in figures}, lp=False),
    ]
    if "bad_light" in figures:
        rows = {}
        for light, scores in figures["bad_light"].items():
            entries = {name: scores, "LSD": scores["lsd"], "LSD, prepared": scores["lsd_prepared"]}
            rows.update({f"{light}: {row}": entry for row, entry in entries.items()})
        found.append(_table("Bad light, %", rows, dict.fromkeys(PIXELS, 1), lp=False))
    return found


def ablation(rows: dict[str, Figures]) -> Table:
    """Scores, lines per image and median ms of every variant of the detector."""
    return _table("Ablation, %", rows, {**dict.fromkeys(PIXELS, 1), "lines": 0, "ms": 1}, {"ms": "ms"})


def _table(
    title: str, rows: dict[str, Figures], decimals: dict[str, int], titles: dict[str, str] = TITLES, lp: bool = True
) -> Table:
    """Figures by name; what a row lacks is a dash."""
    table = Table("", title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    radii = [*next(iter(rows.values()))["lp"]] if lp else []
    names = (titles.get(key, key.upper() if key in (*PIXELS, "f1") else key) for key in decimals)
    for column in (*(f"LP{radius}" for radius in radii), *names):
        table.add_column(column, justify="right")
    for name, figures in rows.items():
        values = [(figures["lp"][radius], 1) for radius in radii] + [(figures[key], n) for key, n in decimals.items()]
        table.add_row(name, *("-" if value is None else f"{value:.{n}f}" for value, n in values))
    return table
