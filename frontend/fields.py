"""What the arrays of `LineTracks` hold, as a table of which every format of files and messages is made."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal

import numpy as np

ROWS = {
    **{"seen": ("N", "ids"), "right": ("N", "right_hits")},
    **{"lost": ("L", "lost_ids"), "ended": ("E", "ended_ids"), "points": ("P", "point_ids")},
}
"""Whose rows an array has: the letter of its first axis, and the field that says how many there are.

Arrays of the right image have those of the tracks seen, in the same order, and without a right image none.
"""


@dataclass(frozen=True)
class Field:
    """What an array of `LineTracks` holds, one row per line or point.

    Attributes:
        meaning: for people, in files too.
        unit: of all numbers, or one for each number of a row, separated by commas.
        shape: of a row; (-1,) is any length, the same for all rows of a frame.
        columns: names in Parquet and CSV, one for each number of a row; by default the field's name. A name that comes
            twice is the same number. Rows of any length, and those of lost and ended tracks, are one column.
        rows: whose: tracks seen in the frame (N), their partners in the right image (N, or 0 without one), lost (L) or
            ended (E), or points (P).
        older: what stands for it in files from before it was there; None: all files have it.
        words: what tables have in place of the numbers 0, 1, ...
        name: of the attribute. It and the dtype come from the declaration.
        dtype: numpy's, of the array.
    """

    meaning: str
    unit: str = ""
    shape: tuple[int, ...] = ()
    columns: str = ""
    rows: Literal["seen", "right", "lost", "ended", "points"] = "seen"
    older: float | None = None
    words: tuple[str, ...] = ()
    name: str = ""
    dtype: Any = None

    @property
    def text(self) -> str:
        """Shape, unit and meaning, such as "(N, 2, 2) px, the line"."""
        axes = [ROWS[self.rows][0], *("C" if n < 0 else str(n) for n in self.shape)]
        return f"({', '.join(axes)}) {self.unit + ', ' if self.unit and ',' not in self.unit else ''}{self.meaning}"

    @property
    def numbers(self) -> list[tuple[str, str]]:
        """Name and unit of each column, in the order of a row's numbers."""
        count = 1 if self.shape == (-1,) or self.rows in ("lost", "ended") else int(np.prod(self.shape))
        names = self.columns.split() or [self.name if count == 1 else f"{self.name}_{k}" for k in range(count)]
        units = self.unit.split(", ")
        return list(zip(names, units if len(units) == count else [self.unit] * count, strict=True))


def ends_named(prefix: str = "") -> str:
    return " ".join(prefix + end for end in ("x0", "y0", "x1", "y1"))


def words_of(kind: type[IntEnum]) -> tuple[str, ...]:
    return tuple(one.name.lower() for one in kind)
