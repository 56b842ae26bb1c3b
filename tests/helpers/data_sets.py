"""Small data sets of the kinds that the evaluations read."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

RECTANGLES = [((40, 30, 119, 89),), ((20, 20, 69, 99), (90, 50, 139, 79))]  # per image: left, top, right, bottom


def write_annotated(folder: Path) -> Path:
    """Bright rectangles on a dark ground, 160x120; all edges are annotated densely, the first four sparsely."""
    for part in ("images", "lines_denis", "lines_cho"):
        (folder / part).mkdir(parents=True)
    for number, boxes in enumerate(RECTANGLES):
        image = np.full((120, 160, 3), 40, np.uint8)
        for left, top, right, bottom in boxes:
            image[top : bottom + 1, left : right + 1] = 100
        cv2.imwrite(str(folder / "images" / f"{number}.png"), image)
        rows = [" ".join(map(str, row)) + "\n" for box in boxes for row in _outline(*box)]
        (folder / "lines_cho" / f"{number}.txt").write_text("".join(rows))
        (folder / "lines_denis" / f"{number}.txt").write_text("".join(rows[:4]))
    return folder


def _outline(left: int, top: int, right: int, bottom: int) -> list[tuple[float, ...]]:
    """The edges lie between the last pixel inside and the first one outside."""
    x0, y0, x1, y1 = left - 0.5, top - 0.5, right + 0.5, bottom + 0.5
    return [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]


def write_labelled(folder: Path) -> Path:
    """Three frames with labelled lines; one line goes through all, one appears in the second, one skips it."""
    for part in ("images", "lines", "associations"):
        (folder / part).mkdir(parents=True)
    rows = [
        "10.5,20.5,90.5,20.5\n30,10,30,70\n",
        "50,5,60,40\n11.5,20.5,91.5,20.5\n",
        "12.5,20.5,92.5,20.5\n30,10,30,70\n",
    ]
    for k, text in enumerate(rows):
        cv2.imwrite(str(folder / "images" / f"{k}.png"), np.full((80, 100, 3), 40 * k, np.uint8))
        (folder / "lines" / f"{k}.csv").write_text(text)
    (folder / "associations" / "0_1.csv").write_text("0.0,1.0\n")
    (folder / "associations" / "1_2.csv").write_text("1,0\n")
    return folder


def write_posed(folder: Path) -> Path:
    """Six views of a rendered room with their poses."""
    from airline.scenes import RenderedClip

    (folder / "images").mkdir(parents=True)
    sequence = RenderedClip(kind="indoor", motion="handheld", seed=3, frames=6, size=(320, 240))
    rows = []
    for k, view in enumerate(sequence):
        cv2.imwrite(str(folder / "images" / f"{k:03}.png"), view.image)
        rows.append(" ".join(map(str, view.pose[:3].ravel())))
    (folder / "poses.txt").write_text("\n".join(rows))
    projection = np.column_stack([sequence.K, np.zeros(3)])
    (folder / "calib.txt").write_text("P0: " + " ".join(map(str, projection.ravel())) + "\n")
    return folder
