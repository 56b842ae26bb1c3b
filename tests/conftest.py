"""Inputs that several test files share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from logs.files.mcap_file import McapFile

# before torch is loaded: on small images threads gain nothing, and on a busy machine they wait for each other
os.environ.setdefault("OMP_NUM_THREADS", "1")

# `make test` tells of a change, by the same inputs every time; `make fuzz` looks for other ones
settings.register_profile("fixed", derandomize=True, deadline=None)
settings.register_profile("search", deadline=None, print_blob=True)
settings.load_profile("fixed")


@pytest.fixture(scope="session")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of 8 rendered pictures of a room, 160x120, from a moving camera."""
    import cv2

    from airline.scenes import RenderedClip

    folder = tmp_path_factory.mktemp("inputs") / "room"
    folder.mkdir()
    for number, view in enumerate(RenderedClip(kind="indoor", motion="handheld", seed=12, frames=8, size=(160, 120))):
        assert cv2.imwrite(str(folder / f"{number}.png"), view.image)
    return folder


@pytest.fixture(scope="session")
def scene() -> np.ndarray:
    """(480, 640) uint8 first frame of the built-in clip."""
    from airline.scenes import RenderedClip

    image: np.ndarray = RenderedClip(seed=12, frames=300).render(0).image[:, :, 1]
    return image


@pytest.fixture(scope="session")
def _start_of_the_built_in_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from airline.scenes import render_pairs
    from tests.helpers.built_in_clip import built_in_clip, write_clip

    video = tmp_path_factory.mktemp("clip") / "corridor.mp4"
    write_clip(islice(render_pairs(built_in_clip()), 8), video)
    return video


@pytest.fixture
def short_built_in_clip(_start_of_the_built_in_clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The built-in clip has 8 frames instead of 300, within this process."""
    monkeypatch.setattr("frontend.sources.scene.CLIP", _start_of_the_built_in_clip)


@pytest.fixture
def open_log() -> Iterator[Callable[[Path], McapFile]]:
    """Opens MCAP files and closes them after the test."""
    from logs.files.mcap_file import McapFile

    with ExitStack() as stack:
        yield lambda path: stack.enter_context(closing(McapFile(path)))


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Bright rectangles on a dark ground, annotated; see `write_annotated`."""
    from tests.helpers.data_sets import write_annotated

    return write_annotated(tmp_path / "rectangles")
