"""Our MCAP files as MCAP's and Foxglove's JavaScript libraries read them; npm fetches these where it can."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from frontend.colours import track_colours
from frontend.tracks import DERIVED, FIELDS
from logs.sinks.open import open_track_sink
from tests.helpers.made_tracks import clip_results, write_tracks

SCRIPT = Path(__file__).parents[1] / "helpers" / "read_mcap.mjs"
LIBRARIES = ("@mcap/core@2.2.2", "@mcap/support@1.1.0", "@mcap/nodejs@1.0.2")
ENCODINGS = {
    "/camera/calibration": ["protobuf", "foxglove.CameraCalibration", "protobuf"],
    "/camera/image": ["protobuf", "foxglove.CompressedImage", "protobuf"],
    "/lines/annotations": ["protobuf", "foxglove.ImageAnnotations", "protobuf"],
    "/lines/tracks": ["json", "frontend.LineTracks", "jsonschema"],
}


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The script, beside its libraries."""
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        pytest.skip("node and npm are not installed")
    folder = tmp_path_factory.mktemp("javascript")
    quiet = ["--no-audit", "--no-fund", "--ignore-scripts", "--fetch-retries=0", "--prefix", str(folder)]
    try:
        done = subprocess.run([npm, "install", *quiet, *LIBRARIES], capture_output=True, text=True, timeout=120)
    except subprocess.TimeoutExpired:
        pytest.skip("npm does not answer")
    if done.returncode:
        pytest.skip(f"npm cannot fetch the libraries: {done.stderr.strip()[-200:]}")
    return Path(shutil.copy(SCRIPT, folder))


def read(script: Path, spec: str, path: Path, **options: bool) -> dict[str, Any]:
    """The clip's tracks in a file, as the script finds them."""
    write_tracks(open_track_sink(f"{spec}:{path}", **options), clip_results())
    done = subprocess.run(["node", script.name, str(path)], cwd=script.parent, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_tracks(script: Path, tmp_path: Path) -> None:
    found = read(script, "mcap", tmp_path / "tracks.mcap", with_images=True, labels=True)
    topics, results = found["topics"], clip_results()
    kinds = {name: [one["messageEncoding"], one["schema"], one["schemaEncoding"]] for name, one in topics.items()}
    assert kinds == ENCODINGS
    stamps = [result.frame.stamp_ns for result in results]
    for name, one in topics.items():
        assert one["sequences"] == list(range(1, len(one["stamps"]) + 1))
        expected = stamps[:1] if name == "/camera/calibration" else stamps
        assert one["stamps"] == [[stamp, stamp] for stamp in expected]
    counts = {name: len(one["stamps"]) for name, one in topics.items()}
    assert found["statistics"]["topics"] == counts
    assert found["statistics"]["messages"] == sum(counts.values())
    assert "(0, 0)" in found["metadata"]["airline-frontend"]["pixels"]

    for result, message, drawn in zip(
        results, topics["/lines/tracks"]["messages"], topics["/lines/annotations"]["messages"], strict=True
    ):
        tracks = result.tracks
        for field in (*FIELDS, *DERIVED):
            expected = getattr(tracks, field.name)
            if expected is None:
                assert (message[field.name], field.rows) == (None, "right")
                continue
            values = np.array(message[field.name], field.dtype).reshape(expected.shape)
            np.testing.assert_array_equal(values, getattr(tracks, field.name), field.name)
        (lines,) = drawn["points"]
        points = np.array([(p["x"], p["y"]) for p in lines["points"]]).reshape(-1, 2, 2)
        np.testing.assert_allclose(points - 0.5, tracks.segments_px, atol=1e-9)
        colours = np.array([[c[k] for k in "rgb"] for c in lines["outline_colors"]])
        np.testing.assert_allclose(colours * 255, track_colours(tracks.ids), atol=1e-6)
        assert [text["text"] for text in drawn["texts"]] == [str(i) for i in tracks.ids[tracks.confirmed]]
    (calibration,) = topics["/camera/calibration"]["messages"]
    camera = results[0].frame.camera
    assert camera is not None
    assert calibration["K"] == camera.matrix.ravel().tolist()
    assert bytes(topics["/camera/image"]["messages"][0]["data"][:2]) == b"\xff\xd8"


def test_plvins(script: Path, tmp_path: Path) -> None:
    found = read(script, "plvins", tmp_path / "plvins.mcap")
    assert found["profile"] == "ros1"
    for one in found["topics"].values():
        assert (one["messageEncoding"], one["schemaEncoding"]) == ("ros1", "ros1msg")
        assert one["sequences"] == list(range(1, len(one["stamps"]) + 1))
        assert len(one["sequences"]) > 5
