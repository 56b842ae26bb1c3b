"""The generated scenes: determinism, exact ground truth, and agreement of picture and lines."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from airline.errors import ConfigError
from airline.scenes import CameraEffects, RenderedClip, RenderedView, render_clip, render_pairs
from airline.scenes.builder import Light, Material, Place, Scene, SceneBuilder, Walk, merge_collinear
from airline.scenes.camera import develop, rotation
from airline.scenes.clip import build_scene, render_scene

KINDS = ("indoor", "street", "shelves")
SIZES = ((64, 64), (640, 480), (333, 217))


def _project(view: RenderedView, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixels (..., 2) and depths (...) of world points."""
    camera = (points - view.pose[:3, 3]) @ view.pose[:3, :3]
    rays = camera @ view.K.T
    return rays[..., :2] / rays[..., 2:], camera[..., 2]


def _same(a: RenderedView, b: RenderedView) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))


@pytest.mark.parametrize("kind", KINDS)
def test_frames_depend_on_nothing_but_the_fields_and_the_index(kind):
    sequence = RenderedClip(kind=kind, motion="fast", seed=5, frames=6, size=(160, 120))
    frames = list(sequence)
    assert len(frames) == len(sequence) == 6
    assert _same(dataclasses.replace(sequence).render(4), frames[4])
    assert all(_same(a, b) for a, b in zip(frames, render_clip(sequence, workers=2), strict=True))
    assert not np.array_equal(dataclasses.replace(sequence, seed=6).render(4).image, frames[4].image)


@pytest.mark.parametrize(
    ("of", "settings", "word"),
    [
        (RenderedClip, {"kind": "forest"}, "kind"),
        (RenderedClip, {"motion": "swimming"}, "motion"),
        (RenderedClip, {"size": (31, 480)}, "31x480"),
        (RenderedClip, {"frames": 0}, "1 frame"),
        (RenderedClip, {"seed": -1}, "seed"),
        (RenderedClip, {"baseline_m": -0.1}, "-0.1 m"),
        (CameraEffects, {"gamma": 0}, "gamma"),
        (CameraEffects, {"noise_sigma": -1}, "noise_sigma"),
        (CameraEffects, {"motion_blur": 1.5}, "motion_blur"),
    ],
)
def test_wrong_settings_are_refused(of, settings, word):
    with pytest.raises(ConfigError, match=word):
        of(**settings)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", KINDS)
def test_ground_truth_is_consistent(kind, size):
    view = RenderedClip(kind=kind, seed=1, frames=31, size=size).render(30)
    width, height = size
    assert (view.image.shape, view.image.dtype) == ((height, width, 3), np.uint8)
    assert (view.depth.shape, view.depth.dtype) == ((height, width), np.float32)
    assert (view.segments_px.dtype, view.ids.dtype) == (np.float32, np.int64)
    assert len(view.ids) == len(view.segments_px) == len(view.segments_world) > 5
    assert view.stamp_ns == 1_000_000_000
    assert not np.isnan(view.depth).any()
    assert (view.depth > 0.3).all()

    pixels, depths = _project(view, view.segments_world)
    assert np.abs(pixels - view.segments_px).max() < 0.01
    assert (depths > 0).all()
    assert (view.segments_px >= -1e-3).all()
    assert (view.segments_px <= np.array(size) - 1 + 1e-3).all()


@pytest.mark.parametrize("kind", KINDS)
def test_lines_lie_on_the_surfaces_of_the_depth_map(kind):
    view = RenderedClip(kind=kind, seed=3, frames=1, size=(640, 480)).render(0)
    middle, depth = _project(view, view.segments_world.mean(axis=1))
    x, y = np.round(middle).astype(int).T
    # A line is the border of its surface: that surface covers one of the pixels around it.
    padded = np.pad(view.depth, 1, mode="edge")
    around = np.stack([padded[y + j, x + i] for i in range(3) for j in range(3)])
    close = (np.abs(around - depth) < 0.02 * depth).any(axis=0)
    assert close.mean() > 0.99
    assert (around.max(axis=0) > 0.98 * depth).all()


def _distance_to_line(points: NDArray[np.float64], line: NDArray[np.float64]) -> NDArray[np.float64]:
    along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    return np.asarray(np.linalg.norm(np.cross(points - line[0], along), axis=1))


@pytest.mark.parametrize("kind", KINDS)
def test_an_id_is_one_line_in_space(kind):
    sequence, scene = RenderedClip(kind=kind, seed=2, frames=60, size=(320, 240)), build_scene(kind, 2)
    first, recurring = sequence.render(0), 0
    for i in (5, 20, 59):
        view = sequence.render(i)
        recurring += len(np.intersect1d(first.ids, view.ids))
        for line, piece in zip(view.ids.tolist(), view.segments_world, strict=True):
            pipe, _ = divmod(line - len(scene.lines), 2)
            if pipe < 0:
                assert _distance_to_line(piece, scene.lines[line]).max() < 1e-6
            else:
                np.testing.assert_allclose(_distance_to_line(piece, scene.pipes[pipe]), scene.radii[pipe], atol=1e-6)
    assert recurring > 100


def _flat(value: float) -> Material:
    return Material(0, (value, value, value), (value, value, value), 1.0)


def _hand_built(with_box: bool) -> Scene:
    """A wall at y = 4, dark below z = 1 and light above; a box at y = 2 may stand before the line between."""
    world = Place(SceneBuilder())
    world.quad((-3, 4, -3), (6, 0, 0), (0, 0, 4), _flat(0.2), "t")
    world.quad((-3, 4, 1), (6, 0, 0), (0, 0, 4), _flat(0.8), "")
    if with_box:
        world.box((-0.25, 2, 0.5), (0.25, 2.2, 1.5), _flat(0.5))
    light = Light(np.array([0.0, -0.6, 0.8]), 0.7, 0.3, np.zeros(3))
    return world.scene.build(light, Walk((0, 0, 1), (0, 0, 0), 0, 1))


def _looking_at_it(focal: float, size: tuple[int, int], roll: float = 0.0) -> tuple[NDArray[np.float64], ...]:
    """Pose and intrinsic matrix of a camera before the wall."""
    pose = np.eye(4)
    pose[:3, :3] = rotation(np.pi / 2, 0.0, roll)
    pose[:3, 3] = (0.0, 0.0, 1.2)
    return pose, np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])


def test_a_box_hides_exactly_the_part_of_a_line_behind_it():
    pose, K = _looking_at_it(500, (640, 480))
    _, bare = render_scene(_hand_built(False), pose, K, (640, 480), 10.0)
    assert len(bare.ids) == 1
    np.testing.assert_allclose(np.sort(bare.segments_px[0, :, 0]), (0, 639), atol=1e-3)
    np.testing.assert_allclose(bare.segments_px[0, :, 1], 239.5 + 500 * 0.2 / 4, atol=1e-3)

    _, view = render_scene(_hand_built(True), pose, K, (640, 480), 10.0)
    depth = view.segments_world[:, :, 1]
    pieces = np.abs(depth - 4).max(axis=1) < 1e-9
    assert (pieces.sum(), len(set(view.ids[pieces]))) == (2, 1)
    ends = np.sort(view.segments_px[pieces][:, :, 0].ravel())
    np.testing.assert_allclose(ends, (0, 319.5 - 500 * 0.25 / 2, 319.5 + 500 * 0.25 / 2, 639), atol=1e-3)
    front = np.abs(depth - 2).max(axis=1) < 1e-9  # its outline is seen; the box's edges at the back are hidden
    assert front.sum() == 4
    assert (pieces | front).all()


def test_a_line_without_contrast_is_dropped():
    pose, K = _looking_at_it(200, (200, 200))
    _, view = render_scene(_hand_built(False), pose, K, (200, 200), 10.0)
    step = float(np.ptp(view.image[:, 100, 0].astype(float)))
    assert len(view.ids) == 1
    _, below = render_scene(_hand_built(False), pose, K, (200, 200), step - 1)
    _, above = render_scene(_hand_built(False), pose, K, (200, 200), step + 1)
    assert (len(below.ids), len(above.ids)) == (1, 0)


def test_edges_are_placed_and_smoothed_to_a_fraction_of_a_pixel():
    pose, K = _looking_at_it(500, (640, 480), 0.03)
    linear, view = render_scene(_hand_built(False), pose, K, (640, 480), 10.0)
    (x0, y0), (x1, y1) = view.segments_px[0]
    dark, light = linear[-1, 320, 0], linear[0, 320, 0]
    columns = np.arange(50, 590)
    # The share of light pixels in a column, counted from the image's upper border at -0.5, is the edge's position.
    measured = ((linear[:, columns, 0] - dark) / (light - dark)).sum(axis=0) - 0.5
    off = measured - (y0 + (columns - x0) * (y1 - y0) / (x1 - x0))
    assert np.abs(off).max() < 0.2
    assert np.abs(off.mean()) < 0.01


def test_shared_and_touching_edges_become_one_line():
    rows = [[[0, 0, 0], [1, 0, 0]], [[2, 0, 0], [1, 0, 0]], [[0.5, 0, 0], [0.7, 0, 0]], [[3, 0, 0], [4, 0, 0]]]
    merged = merge_collinear(np.array([*rows, [[0, 0, 1], [1, 0, 1]]], np.float64))
    expected = [[[0, 0, 0], [2, 0, 0]], [[0, 0, 1], [1, 0, 1]], [[3, 0, 0], [4, 0, 0]]]
    np.testing.assert_allclose(merged[np.lexsort((merged[:, 0, 2], merged[:, 0, 0]))], expected, atol=1e-9)


@pytest.mark.parametrize(
    ("motion", "least", "most"), [("static", 0, 0), ("slow", 0.1, 4), ("handheld", 1, 15), ("fast", 10, 50)]
)
def test_motions_move_as_named_and_smoothly(motion, least, most):
    sequence = RenderedClip(motion=motion, seed=1, frames=200)
    poses = np.stack([sequence.pose(i) for i in range(200)])
    turned, moved = poses[:, :3, :3], poses[:, :3, 3]
    cosine = (np.einsum("nij,nij->n", turned[:-1], turned[1:]) - 1) / 2
    assert least <= float((np.arccos(np.clip(cosine, -1, 1)) * sequence.K[0, 0]).max()) <= most
    assert np.linalg.norm(np.diff(moved, axis=0), axis=1).max() < 1.5 / 30
    assert np.linalg.norm(np.diff(moved, 2, axis=0), axis=1).max() < 0.01
    np.testing.assert_allclose(turned @ turned.transpose(0, 2, 1), np.tile(np.eye(3), (200, 1, 1)), atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_cameras_stay_clear_of_everything_and_see_structure(kind):
    few = {"frames": 2000, "size": (96, 72), "effects": None, "min_contrast": 5}
    for seed in range(12):
        clip = RenderedClip(kind=kind, motion="fast", seed=seed, **few)
        for i in range(seed, 2000, 662):
            view = clip.render(i)
            assert view.depth.min() > 0.3
            assert len(view.ids) >= 3


def test_noise_and_effects_do_not_touch_the_ground_truth():
    effects = (None, CameraEffects(), CameraEffects(noise_sigma=20, exposure=0.2))
    clips = [RenderedClip(motion="static", frames=30, size=(160, 120), effects=each) for each in effects]
    plain, first, rough = (clip.render(0) for clip in clips)
    for view in (first, rough, clips[1].render(29)):
        assert np.array_equal(plain.segments_px, view.segments_px)
        assert np.array_equal(plain.depth, view.depth)
        assert not np.array_equal(first.image, view.image) or view is first
    assert rough.image.mean() < plain.image.mean()


_OFF = CameraEffects(exposure_jitter=0, noise_sigma=0, motion_blur=0, lens_blur=0, vignetting=0)


def test_noise_vignetting_gamma_and_exposure():
    grey = np.full((200, 300, 3), 0.25, np.float32)

    def seen(exposure: float, frame: int = 0, **effects: float) -> NDArray[np.float64]:
        return develop(grey, exposure, dataclasses.replace(_OFF, **effects), 0, frame).astype(float)

    assert (seen(1.0) == round(255 * 0.25 ** (1 / 2.2))).all()
    for exposure, level in ((1.0, 64), (2.0, 128), (9.0, 255)):
        assert (seen(exposure, gamma=1.0) == level).all()
    noisy, dimmed = seen(1.0, noise_sigma=6), seen(1.0, gamma=1.0, vignetting=0.5)
    assert noisy.std() == pytest.approx(6, rel=0.03)
    assert noisy.mean() == pytest.approx(135.8, abs=0.1)
    assert abs(np.corrcoef(noisy[:, :-1].ravel(), noisy[:, 1:].ravel())[0, 1]) < 0.02
    assert not np.array_equal(noisy, seen(1.0, frame=1, noise_sigma=6))
    assert (dimmed[100, 150, 0], dimmed[0, 0, 0]) == (64, 32)


def test_fast_motion_is_blurred_and_exposure_drifts():
    clips = (RenderedClip(motion="fast", seed=1, effects=dataclasses.replace(_OFF, motion_blur=b)) for b in (0.0, 0.8))
    sharp, smeared = (np.abs(cv2.Laplacian(clip.render(5).image, cv2.CV_32F)).mean() for clip in clips)
    assert smeared < 0.7 * sharp
    drifting = RenderedClip(motion="static", size=(64, 64), effects=dataclasses.replace(_OFF, exposure_jitter=0.5))
    levels = [drifting.render(i).image.mean() for i in range(0, 90, 10)]
    assert max(levels) > 1.1 * min(levels)


@pytest.mark.parametrize("kind", ["indoor", "street"])
def test_the_second_camera_sees_the_same_world_from_its_place(kind):
    """Pixels of the left image, moved by the disparity of their depth, look the same in the right one."""
    clip = RenderedClip(kind, "handheld", 3, 2, (320, 240), baseline_m=0.2)
    _, (left, right) = render_pairs(clip)
    assert _same(left, clip.render(1))
    assert _same(right, clip.render(1, right=True))
    x, y = np.meshgrid(np.arange(320, dtype=np.float32), np.arange(240, dtype=np.float32))
    there = (x - clip.K[0, 0] * 0.2 / left.depth).astype(np.float32)
    looks, depth = (cv2.remap(image, there, y, cv2.INTER_LINEAR) for image in (right.image, right.depth))
    seen = (there >= 0) & (abs(depth - left.depth) < 0.02 * left.depth)
    assert seen.mean() > 0.7
    assert np.median(abs(looks.astype(float) - left.image)[seen]) < 3.5  # noise of 2.5 in both, less by interpolation
    assert np.median(abs(left.image.astype(float) - right.image)[seen]) > 4
    for line in np.intersect1d(left.ids, right.ids):
        if line < len(build_scene(kind, 3).lines):  # not the outline of a pipe, which is another from elsewhere
            points = right.segments_world[right.ids == line].reshape(-1, 2, 3)
            assert _distance_to_line(points, left.segments_world[left.ids == line][0]).max() < 1e-6
