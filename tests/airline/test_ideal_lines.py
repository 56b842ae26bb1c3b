"""Lines of known parameters through the stages after edge detection, by both presets."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.ideal import ANGLES, binary_map, ideal_line, measure, report, soft_map

CASES = [("soft", soft_map, shift) for shift in [(0.0, 0.0), (0.3, 0.2), (-0.45, 0.4)]]
# a staircase of whole pixels can stand only for a line through pixel centres
CASES += [("binary", binary_map, (0.5, 0.5))]


@pytest.mark.parametrize(("kind", "draw", "shift"), CASES)
def test_default_is_exact(kind, draw, shift, capsys):
    errors = [measure("default", draw(line), line) for line in (ideal_line(a, shift) for a in ANGLES)]
    with capsys.disabled():
        print("\n" + report("default", kind, errors))
    assert [e.found for e in errors] == [1] * len(ANGLES)
    assert max(e.angle for e in errors) <= 0.2
    assert max(e.offset for e in errors) <= 0.1
    assert max(e.ends for e in errors) <= 1.5


def test_paper_finds_every_line_with_a_larger_error(capsys):
    lines = [ideal_line(a, (0.3, 0.2)) for a in ANGLES]
    paper = [measure("paper", soft_map(line), line) for line in lines]
    default = [measure("default", soft_map(line), line) for line in lines]
    with capsys.disabled():
        print("\n" + report("paper", "soft", paper))
    assert [e.found for e in paper] == [1] * len(ANGLES)
    for name in ("angle", "offset", "ends"):
        assert np.mean([getattr(e, name) for e in paper]) > np.mean([getattr(e, name) for e in default])
    assert max(e.angle for e in paper) <= 0.5
    assert max(e.offset for e in paper) <= 0.5
