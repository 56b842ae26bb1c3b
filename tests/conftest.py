"""Inputs that several test files share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from logs.files.mcap_file import McapFile

# before torch is loaded: on small images threads gain nothing, and on a busy machine they wait for each other
os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.fixture(scope="session")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of 8 rendered pictures of a room, 160x120, from a moving camera."""
    import cv2

    from airline.scenes import Sequence

    folder = tmp_path_factory.mktemp("inputs") / "room"
    folder.mkdir()
    for number, view in enumerate(Sequence(kind="indoor", motion="handheld", seed=12, frames=8, size=(160, 120))):
        assert cv2.imwrite(str(folder / f"{number}.png"), view.image)
    return folder


@pytest.fixture
def open_log() -> Iterator[Callable[[Path], McapFile]]:
    """Opens MCAP files and closes them after the test."""
    from logs.files.mcap_file import McapFile

    with ExitStack() as stack:
        yield lambda path: stack.enter_context(closing(McapFile(path)))


RECTANGLES = [((40, 30, 119, 89),), ((20, 20, 69, 99), (90, 50, 139, 79))]  # per image: left, top, right, bottom


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Bright rectangles on a dark ground, 160x120; all edges are annotated densely, the first four sparsely."""
    import cv2
    import numpy as np

    folder = tmp_path / "rectangles"
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
