"""Training data: losses, labels, crops and rendered scenes against cases that one can work out."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from airline.training.consensus import PIECE, PseudoLabels, consensus, detect_lsd
from airline.training.dataset import (
    Sample,
    draw_labels,
    fingerprint,
    label_image,
    list_images,
    load_samples,
    motion_kernel,
    random_crop,
)
from airline.training.loss import PixelWeights, disk, edge_loss
from airline.training.rendered import FIRST_SEED, HELD_OUT_SEED, cut, render_sample
from tests.helpers.pictures import labelled, picture


def test_loss_of_a_hand_computed_map():
    # one positive pixel in a 21 x 21 map of zero logits: BCE is log 2 everywhere, so any weights give log 2
    spot = np.zeros((21, 21), np.float32)
    spot[10, 10] = 1
    pixel_weights = PixelWeights(weight=0.8, radius=5)(spot, np.ones((21, 21), bool))
    target, given = (torch.from_numpy(array)[None, None] for array in (spot, pixel_weights))
    assert edge_loss(torch.zeros(1, 1, 21, 21), target, given).item() == pytest.approx(np.log(2), abs=1e-6)
    # a wrong pixel within the disk weighs 1, outside it 1 - w; 81 pixels lie within 5 px
    weights = 81 + (441 - 81) * 0.2
    for place, weight in (((10, 15), 1.0), ((0, 0), 0.2)):
        logits = torch.full((1, 1, 21, 21), -30.0)
        logits[0, 0, 10, 10] = 30.0
        logits[(0, 0, *place)] = 30.0
        assert edge_loss(logits, target, given).item() == pytest.approx(30 * weight / weights, rel=1e-4)


def test_pixels_outside_the_photograph_do_not_count():
    logits, target = torch.randn(1, 1, 16, 16), torch.zeros(1, 1, 16, 16)
    inside = np.ones((16, 16), bool)
    inside[:, :8] = False
    weights = torch.from_numpy(PixelWeights()(target[0, 0].numpy(), inside))[None, None]
    changed = logits.clone()
    changed[..., :8] += 100
    assert edge_loss(changed, target, weights) == edge_loss(logits, target, weights)


def test_disk_holds_the_offsets_within_its_radius():
    assert disk(1).tolist() == [[0, 1, 0], [1, 1, 1], [0, 1, 0]]
    assert disk(5).sum() == 81


def test_labels_are_ridges_of_the_lines_shares():
    target = draw_labels(np.array([[[10, 20], [50, 20]]], np.float32), np.array([0.7], np.float32), 64)
    assert target[20, 10:51] == pytest.approx(np.full(41, 0.7), abs=1e-6)
    assert target[21, 30] == pytest.approx(0.7 * np.exp(-1 / (2 * 0.64)), abs=1e-6)
    assert target[24].max() == 0


def test_lsd_positions_count_from_the_pixel_centre():
    image = np.full((128, 128), 60, np.uint8)
    image[:, 64:] = 180  # the edge is at x = 63.5
    for scale in (1.0, 0.5):
        found = detect_lsd(image, scale)
        assert len(found) >= 1
        assert np.abs(found[:, :, 0] - 63.5).max() < 0.15


def test_consensus_trusts_edges_and_not_noise():
    image = np.full((200, 200), 90, np.uint8)
    image[50:150, 40:160] = 200
    rng = np.random.default_rng(0)
    noisy = np.clip(image + rng.normal(0, 6, image.shape), 0, 255).astype(np.uint8)
    labels = consensus(noisy, 6, rng)
    middle = labels.pieces.mean(axis=1)
    corners = np.array([[39.5, 49.5], [159.5, 149.5]])
    gap = np.minimum(np.abs(middle - corners[0]), np.abs(middle - corners[1])).min(axis=1)
    on_edge = gap < 1.0
    assert on_edge.sum() * 8 > 0.7 * 440, "most of the outline is labelled"
    assert labels.shares[on_edge].mean() > 0.8
    assert gap[on_edge & (labels.shares > 0.5)].mean() < 0.2, "views with all turns leave no bias"
    assert labels.shares[~on_edge].sum() < 0.05 * labels.shares[on_edge].sum()


def test_a_crop_moves_its_labels_with_the_image():
    # a bright half plane: wherever the crop lies, strong gradients must lie under the label
    gray = np.full((200, 200), 60, np.uint8)
    gray[:, 100:] = 200
    sample = Sample(gray, PseudoLabels(np.array([[[99.5, 0], [99.5, 199]]], np.float32), np.ones(1, np.float32)))
    rng, checked = np.random.default_rng(3), 0
    for _ in range(40):
        image, target, inside = random_crop(sample, 96, rng)
        assert image.shape == target.shape == inside.shape == (96, 96)
        gradient = cv2.magnitude(*(cv2.Sobel(image, cv2.CV_32F, *order) for order in ((1, 0), (0, 1))))
        ridge = (target > 0.9) & inside
        if ridge.sum() > 40 and image.std() > 40 and gradient[ridge].size:
            checked += 1
            assert gradient[ridge].mean() > 2 * gradient[(target < 0.01) & inside].mean()
    assert checked > 5


@pytest.mark.parametrize("length", [3, 8, 9, 13])
@pytest.mark.parametrize("angle", [0.0, 0.6, 1.5, 3.0])
def test_motion_blur_keeps_edges_in_place(length, angle):
    kernel = motion_kernel(length, angle)
    assert kernel.sum() == pytest.approx(1)
    assert np.allclose(kernel, kernel[::-1, ::-1])


def test_rendered_scenes_label_every_visible_line():
    sample = render_sample(3)
    delta = sample.labels.pieces[:, 1] - sample.labels.pieces[:, 0]
    assert sample.gray.shape == (480, 640)
    assert len(sample.labels.pieces) > 100
    assert np.linalg.norm(delta, axis=1).max() < 2 * PIECE
    assert (sample.labels.shares == 1).all()
    image = cv2.GaussianBlur(sample.gray, (0, 0), 1.0)
    gradient = cv2.magnitude(*(cv2.Sobel(image, cv2.CV_32F, *order) for order in ((1, 0), (0, 1))))
    x, y = np.rint(sample.labels.pieces.mean(axis=1)).astype(int).T
    assert np.median(gradient[y, x]) > 5 * np.median(gradient), "labels lie on edges"


def test_cutting_keeps_every_line_whole():
    lines = np.array([[[0, 0], [30, 40]], [[5, 5], [5, 6]]], np.float32)
    pieces = cut(lines)
    assert len(pieces) == 6 + 1
    assert pieces[0, 0].tolist() == [0, 0]
    assert pieces[5, 1] == pytest.approx([30, 40], abs=1e-4)
    assert np.abs(pieces[1:6, 0] - pieces[:5, 1]).max() < 1e-4
    assert np.array_equal(pieces[6], lines[1])
    assert cut(lines[:0]).shape == (0, 2, 2)


def test_held_out_scenes_are_not_trained_on():
    from airline.train import HELD_OUT_SCENES

    assert HELD_OUT_SEED + HELD_OUT_SCENES <= FIRST_SEED
    assert not np.array_equal(render_sample(1).gray, render_sample(1, HELD_OUT_SEED).gray)


def test_labels_are_kept_and_a_damaged_cache_is_mended(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    path, cache = tmp_path / "a.png", tmp_path / "labels"
    cv2.imwrite(str(path), picture())
    (sample,) = load_samples([path], 1, cache)
    (stored,) = cache.glob("*.npz")
    assert np.load(stored)["shares"].tolist() == sample.labels.shares.tolist()
    whole = stored.read_bytes()
    for damaged in (b"", b"no archive", whole[: len(whole) // 2]):
        stored.write_bytes(damaged)
        again = label_image(path, 1, cache)
        assert again is not None
        assert np.array_equal(again.labels.pieces, sample.labels.pieces)
        assert "damaged" in caplog.text
        caplog.clear()


def test_only_image_files_are_listed(tmp_path: Path):
    for name in ("b.PNG", "a.jpg", "notes.txt"):
        (tmp_path / name).touch()
    (tmp_path / "folder.png").mkdir()
    assert [path.name for path in list_images(tmp_path)] == ["a.jpg", "b.PNG"]


def test_fingerprint_tells_pixels_labels_and_order_apart():
    first, second = labelled(0), labelled(1)
    brighter = Sample(first.gray + 1, first.labels)
    surer = Sample(first.gray, PseudoLabels(first.labels.pieces, first.labels.shares / 2))
    bare = Sample(first.gray, PseudoLabels(first.labels.pieces[:0], first.labels.shares[:0]))
    sets = [[first, second], [second, first], [first], [brighter], [surer], [bare], []]
    assert len({fingerprint(samples) for samples in sets}) == len(sets)
    assert fingerprint([labelled(0)]) == fingerprint([first])
