"""Lines of known parameters through the stages after edge detection, by both presets."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.ideal import ANGLES, binary_map, ideal_line, measure, soft_map

CASES = [(soft_map, shift) for shift in [(0.0, 0.0), (0.3, 0.2), (-0.45, 0.4)]]
# a staircase of whole pixels can stand only for a line through pixel centres
CASES += [(binary_map, (0.5, 0.5))]


def errors(preset, draw, shift):
    """(angles, 3) errors, of which the worst are printed."""
    lines = [ideal_line(angle, shift) for angle in ANGLES]
    found, *rows = zip(*(measure(preset, draw(line), line) for line in lines), strict=True)
    assert set(found) == {1}
    angle, offset, ends = np.max(rows, axis=1)
    print(f"{preset:8} {draw.__name__:10} angle {angle:.3f} deg  offset {offset:.3f} px  end points {ends:.2f} px")
    return np.transpose(rows)


@pytest.mark.parametrize(("draw", "shift"), CASES)
def test_default_is_exact(draw, shift):
    assert (errors("default", draw, shift).max(axis=0) <= [0.2, 0.1, 1.5]).all()


def test_paper_finds_every_line_with_a_larger_error():
    paper, default = (errors(preset, soft_map, (0.3, 0.2)) for preset in ("paper", "default"))
    assert (paper.mean(axis=0) > default.mean(axis=0)).all()
    assert (paper.max(axis=0)[:2] <= 0.5).all()
