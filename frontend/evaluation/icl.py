"""Frames with hand-labelled lines and labelled associations, as the ten ICL-NUIM frames of EVOLIN (2023)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError
from frontend.evaluation.truth import Truth
from frontend.frame import Frame
from frontend.sources.listing import list_images
from frontend.sources.stills import read_image

FRAMES_PER_SECOND = 30
_CORNER = 0.5  # px: the labels have (0, 0) at the corner of the top-left pixel, we at its centre


class LabelledClip:
    """A folder with `images/`, `lines/` and `associations/`.

    `lines/NAME.csv` has a line per row, `x0,y0,x1,y1`, px from the corner of the top-left pixel, for `images/NAME.*`;
    `associations/NAME_NEXT.csv` has rows `i,j`: row i of one frame and row j of the next are the same line. Chains of
    associations make the identities.

    Raises:
        InputError: a folder or file is missing or malformed.
    """

    def __init__(self, folder: Path) -> None:
        self.name = folder.resolve().name
        self._images = list_images(folder / "images", FRAMES_PER_SECOND).rows
        self._truth = _chained(folder, [row.path.stem for row in self._images])

    def __len__(self) -> int:
        return len(self._images)

    def __iter__(self) -> Iterator[tuple[Frame, Truth]]:
        for index, (row, truth) in enumerate(zip(self._images, self._truth, strict=True)):
            yield Frame(index, row.stamp_ns, read_image(row.path)), truth


def read_numbers(path: Path, columns: int, separator: str | None) -> NDArray[np.float64]:
    """(N, columns) numbers of a text file, a row per line.

    Lines that begin with # are skipped.

    Raises:
        InputError: the file is missing or malformed.
    """
    if not path.is_file():
        raise InputError(f"no file {path}: it belongs to the frames' ground truth")
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = [line.split(separator) for line in lines if line.strip() and not line.lstrip().startswith("#")]
        values = np.array(rows, np.float64).reshape(len(rows), columns)
    except ValueError:  # ragged rows, a wrong number of columns, words, or not even text
        raise InputError(f"{path} is malformed: every row must be {columns} numbers") from None
    if not np.isfinite(values).all():
        raise InputError(f"{path} is malformed: it holds numbers that are not finite")
    return values


def _chained(folder: Path, names: list[str]) -> list[Truth]:
    """The lines of every frame; a line without an association to the frame before gets a new id."""
    chain: list[Truth] = []
    next_id = 0
    for k, name in enumerate(names):
        segments = read_numbers(folder / "lines" / f"{name}.csv", 4, ",").reshape(-1, 2, 2) - _CORNER
        ids = np.full(len(segments), -1, np.int64)
        if k:
            path = folder / "associations" / f"{names[k - 1]}_{name}.csv"
            earlier, later = read_numbers(path, 2, ",").astype(np.int64).T
            for rows, known in ((earlier, chain[-1].ids), (later, ids)):
                if ((rows < 0) | (rows >= len(known))).any() or len(np.unique(rows)) < len(rows):
                    raise InputError(f"{path} is malformed: it must name rows of the line files, each once at most")
            ids[later] = chain[-1].ids[earlier]
        new = ids < 0
        ids[new] = np.arange(next_id, next_id + new.sum())
        next_id += int(new.sum())
        chain.append(Truth(segments.astype(np.float32), ids))
    return chain
