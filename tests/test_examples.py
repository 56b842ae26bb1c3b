"""Every example runs as a user runs it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from airline.scenes import Sequence

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("[0-9]*.py"))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_runs(example, tmp_path):
    done = subprocess.run([sys.executable, example], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) > 5


def test_dark_frames_draw_what_they_report(tmp_path):
    example = next(path for path in EXAMPLES if path.stem == "03_dark_frames")
    frame = Sequence(seed=3, effects=None).render(0).image
    cv2.imwrite(str(tmp_path / "frame.png"), frame)
    command = [sys.executable, example, "frame.png", "--out", "picture.png"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    counts = [int(line.split(": ")[1].split()[0]) for line in done.stdout.splitlines()[:3]]
    picture = cv2.imread(str(tmp_path / "picture.png")).astype(int)
    assert picture.shape == (300, 1600, 3)
    coloured = (np.ptp(picture, axis=2) > 40).reshape(300, 4, 400).sum(axis=(0, 2))
    assert coloured[0] == 0
    assert coloured[3] > 2 * coloured[1], "AirLine sees in the dark, LSD does not"
    assert counts[2] > counts[0]
    assert subprocess.run([*command[:2], "none.png"], cwd=tmp_path, capture_output=True, timeout=300).returncode == 1
