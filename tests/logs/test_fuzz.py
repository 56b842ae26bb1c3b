"""A short run of `tests.helpers.fuzz` on every target, and that the harness sees what it is to find."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from airline.errors import AirLineError
from frontend.camera.calibration import read_calibration
from frontend.cli.settings import load
from tests.helpers.fuzz import attempt, fuzz
from tests.helpers.fuzz_targets import all_targets

INPUTS = 60


def test_nothing_but_our_errors(tmp_path: Path) -> None:
    found = {name: fuzz(name, target, INPUTS, 1, tmp_path) for name, target in all_targets(tmp_path).items()}
    assert len(found) > 20
    assert not {name: findings for name, findings in found.items() if findings}


def test_the_harness_sees_faults(tmp_path: Path) -> None:
    assert "ZeroDivisionError" in (attempt(lambda _: 1 / 0, b"", tmp_path) or "")
    assert attempt(lambda _: Path("/etc/passwd").read_text(), b"", tmp_path) == "opened /etc/passwd"
    assert "took 2" in (attempt(lambda _: time.sleep(2.1), b"", tmp_path) or "")
    assert attempt(lambda _: None, b"", tmp_path) is None


@pytest.mark.parametrize("tag", ["!!python/object/apply:os.system", "!!python/name:os.system", "!!python/module:os"])
def test_yaml_makes_no_objects(tmp_path: Path, tag: str) -> None:
    """Tags are passed over: what stands behind them is text, or no calibration."""
    (tmp_path / "c.yaml").write_text(f"image_width: {tag} ['touch {tmp_path}/made']\nimage_height: 1\ncamera_matrix: 1")
    with pytest.raises(AirLineError, match=r"c\.yaml"):
        read_calibration(tmp_path / "c.yaml")
    assert [path.name for path in tmp_path.iterdir()] == ["c.yaml"]


def test_paths_in_files_are_never_followed(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("width: 7")
    for text in (f"!include {secret}", json.dumps({"fx": str(secret), "width": f"@{secret}", "include": str(secret)})):
        (tmp_path / "c.yaml").write_text(text)
        with pytest.raises(AirLineError) as caught:
            read_calibration(tmp_path / "c.yaml")
        assert "7" not in str(caught.value).replace(str(tmp_path), "")
    (tmp_path / "s.toml").write_text(f'[input]\nresize = "{secret}"\n')
    with pytest.raises(AirLineError):
        load(tmp_path / "s.toml", {})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c.yaml", "s.toml", "secret"]
