"""Inputs that several test files share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

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
