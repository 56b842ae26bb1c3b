"""Folders of images with annotated lines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.errors import InputError
from airline.image import to_gray

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm"}
MAX_COORDINATE = 1e6  # px; lines are drawn with 32-bit integers


@dataclass(frozen=True)
class Sample:
    """One annotated image.

    Attributes:
        path: the image file.
        sparse: (K, 2, 2) float64 px, the lines that matter most (Denis et al.'s Manhattan lines in YorkUrban).
        dense: (L, 2, 2) float64 px, all lines (Cho et al.'s in YorkUrban).
    """

    path: Path
    sparse: NDArray[np.float64]
    dense: NDArray[np.float64]

    def read(self) -> NDArray[np.uint8]:
        """The (H, W) grey image; InputError where the file is none."""
        image = cv2.imread(str(self.path), cv2.IMREAD_COLOR)
        if image is None:
            raise InputError(f"{self.path} cannot be read as an image: replace or remove it")
        return to_gray(image).astype(np.uint8, copy=False)


def load_dataset(folder: Path, limit: int | None = None) -> list[Sample]:
    """Samples of a folder with `images/`, `lines_denis/` (sparse) and `lines_cho/` (dense), sorted by name.

    Every `images/NAME.*` has a `NAME.txt` in both others. Raises InputError where one is missing or malformed.
    """
    images, sparse, dense = (folder / name for name in ("images", "lines_denis", "lines_cho"))
    for part in (images, sparse, dense):
        if not part.is_dir():
            raise InputError(f"no folder {part}: a data set has the folders images, lines_denis and lines_cho")
    paths = list_images(images)[:limit]
    return [Sample(path, *(read_lines(part / f"{path.stem}.txt") for part in (sparse, dense))) for path in paths]


def list_images(folder: Path) -> list[Path]:
    """Image files directly in a folder, sorted by name; InputError if there are none."""
    found = sorted(p for p in folder.glob("*") if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file())
    if not found:
        raise InputError(f"no images in {folder}: give a folder of photographs (jpg, png, ...)")
    return found


def read_lines(path: Path) -> NDArray[np.float64]:
    """(N, 2, 2) segments of a text file, px: a line `x0 y0 x1 y1` per row, more columns ignored; raises InputError."""
    if not path.is_file():
        raise InputError(f"no line file {path}: write one per image, empty where there are no lines")
    try:
        rows = [row.split()[:4] for row in path.read_text(encoding="utf-8").splitlines() if row.strip()]
        values = np.array(rows, np.float64).reshape(len(rows), 4)
    except ValueError:  # ragged rows, too few columns, words, or not even text
        raise InputError(f"{path} is malformed: every row must be four numbers, x0 y0 x1 y1") from None
    if not (np.abs(values) <= MAX_COORDINATE).all():
        raise InputError(f"{path} holds coordinates that no image has: they must be finite numbers of pixels")
    return values.reshape(-1, 2, 2)
