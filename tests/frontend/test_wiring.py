"""What the command line says of its outputs."""

from __future__ import annotations

import pytest

from frontend.cli.wiring import can_be_replayed


@pytest.mark.parametrize(
    ("spec", "can"),
    [("a.mcap", True), ("a.parquet", True), ("a_uvslam.mcap", False), ("plvins:a.mcap", False), ("a.csv", False)],
)
def test_only_tracks_of_ours_are_to_be_replayed(spec: str, can: bool) -> None:
    assert can_be_replayed(spec) is can
