"""The built-in clip is what its truth says."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from frontend.sources.scene import CLIP, BuiltInClip
from tests.helpers.built_in_clip import built_in_clip, write_clip

DIGEST = "4a76f96ee321c6e76e5cb60fa8314b02e71c60301a02a0f4919f0164a4f3fb99"


def test_it_is_the_rendered_one_and_its_truth_lies_beside_it():
    rendered, frames = built_in_clip(), list(BuiltInClip())
    assert hashlib.sha256(CLIP.read_bytes()).hexdigest() == DIGEST
    assert [frame.index for frame in frames] == list(range(len(rendered)))
    rows = np.loadtxt(CLIP.with_name("poses.txt"))
    assert rows.shape == (len(rendered), 8)
    for k in (0, 150, 299):
        frame, view = frames[k], rendered.render(k)
        assert np.abs(frame.image.astype(int) - view.image).mean() < 4, "the same picture, but for its compression"
        assert frame.stamp_ns == pytest.approx(view.stamp_ns, abs=1)
        assert np.allclose(frame.camera.matrix, view.K)
        assert np.allclose(rows[k, :4], [k / 30, *view.pose[:3, 3]])
        assert np.allclose(Rotation.from_quat(rows[k, 4:]).as_matrix(), view.pose[:3, :3])


def test_the_second_camera_stands_beside_the_first():
    clip, source = built_in_clip(), BuiltInClip(stereo=True)
    frame = next(iter(source))
    source.close()
    assert np.abs(frame.image.astype(int) - clip.render(0).image).mean() < 4
    assert np.abs(frame.right.astype(int) - clip.render(0, right=True).image).mean() < 4
    assert frame.camera.baseline_m == pytest.approx(clip.baseline_m)
    assert source.unpaired == (0, 0)
    assert source.kind == BuiltInClip.kind


def test_the_command_writes_such_a_clip(tmp_path, monkeypatch):
    pairs = [(built_in_clip().render(k), built_in_clip().render(k, right=True)) for k in range(3)]
    write_clip(pairs, tmp_path / "corridor.mp4")
    monkeypatch.setattr("frontend.sources.scene.CLIP", tmp_path / "corridor.mp4")
    for frame, (left, right) in zip(BuiltInClip(stereo=True), pairs, strict=True):
        assert np.abs(frame.image.astype(int) - left.image).mean() < 4
        assert np.abs(frame.right.astype(int) - right.image).mean() < 4
        assert np.allclose(frame.camera.matrix, left.K)
        assert frame.camera.baseline_m == pytest.approx(built_in_clip().baseline_m)
