"""Training data: losses, labels, crops and rendered scenes against cases that one can work out."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from airline.train import HELD_OUT_SCENES
from airline.training.consensus import PIECE, consensus
from airline.training.crops import draw_labels, pixel_weights, random_crop, random_light
from airline.training.dataset import (
    FIRST_SEED,
    HELD_OUT_SEED,
    Sample,
    cut,
    fingerprint,
    label_image,
    load_samples,
    render_sample,
)
from airline.training.loop import edge_loss
from tests.helpers.pictures import labelled, picture


def gradient_of(image):
    return cv2.magnitude(*(cv2.Sobel(image, cv2.CV_32F, *order) for order in ((1, 0), (0, 1))))


def test_loss_of_a_hand_computed_map():
    # one positive pixel in a 21 x 21 map of zero logits: BCE is log 2 everywhere, so any weights give log 2
    spot, inside = np.zeros((21, 21), np.float32), np.ones((21, 21), bool)
    spot[10, 10] = 1
    target, weights = (torch.from_numpy(a)[None, None] for a in (spot, pixel_weights(spot, inside, 0.8, 5)))
    assert edge_loss(torch.zeros(1, 1, 21, 21), target, weights).item() == pytest.approx(np.log(2), abs=1e-6)
    # a wrong pixel within the disk weighs 1, outside it 1 - w; 81 pixels lie within 5 px
    total = 81 + (441 - 81) * 0.2
    for place, weight in (((10, 15), 1.0), ((0, 0), 0.2)):
        logits = torch.full((1, 1, 21, 21), -30.0)
        logits[0, 0, 10, 10] = logits[(0, 0, *place)] = 30.0
        assert edge_loss(logits, target, weights).item() == pytest.approx(30 * weight / total, rel=1e-4)
    inside[:, :8] = False  # outside of the photograph: does not count
    assert np.array_equal(pixel_weights(0 * spot, inside, 0.8, 5) > 0, inside)


def test_labels_are_ridges_of_the_lines_shares():
    target = draw_labels(np.array([[[10, 20], [50, 20]]], np.float32), np.array([0.7], np.float32), (64, 64))
    assert target[20, 10:51] == pytest.approx(np.full(41, 0.7), abs=1e-6)
    assert target[21, 30] == pytest.approx(0.7 * np.exp(-1 / (2 * 0.64)), abs=1e-6)
    assert target[24].max() == 0


def test_consensus_trusts_edges_and_not_noise():
    image = np.full((200, 200), 90, np.uint8)
    image[50:150, 40:160] = 200
    rng = np.random.default_rng(0)
    pieces, shares = consensus(np.clip(image + rng.normal(0, 6, image.shape), 0, 255).astype(np.uint8), 6, rng)
    gaps = np.abs(pieces.mean(axis=1)[:, None] - [[39.5, 49.5], [159.5, 149.5]]).min(axis=(1, 2))
    on_edge = gaps < 1.0
    assert on_edge.sum() * 8 > 0.7 * 440, "most of the outline is labelled"
    assert shares[on_edge].mean() > 0.8
    assert gaps[on_edge & (shares > 0.5)].mean() < 0.2, "views with all turns leave no bias"
    assert shares[~on_edge].sum() < 0.05 * shares[on_edge].sum()


def test_a_crop_moves_its_labels_with_the_image():
    # a bright half plane: wherever the crop lies, strong gradients must lie under the label
    gray = np.full((200, 200), 60, np.uint8)
    gray[:, 100:] = 200
    sample = Sample(gray, np.array([[[99.5, 0], [99.5, 199]]], np.float32), np.ones(1, np.float32))
    rng, checked = np.random.default_rng(3), 0
    for _ in range(40):
        image, target, inside = random_crop(sample, 96, rng)
        assert image.shape == target.shape == inside.shape == (96, 96)
        gradient, ridge = gradient_of(image), (target > 0.9) & inside
        if ridge.sum() > 40 and image.std() > 40:
            checked += 1
            assert gradient[ridge].mean() > 2 * gradient[(target < 0.01) & inside].mean()
    assert checked > 5


def test_bad_light_keeps_things_in_their_place():
    dot = np.zeros((65, 65), np.uint8)
    dot[31:34, 31:34] = 255
    seen = [random_light(dot, np.random.default_rng(seed)).astype(float) for seed in range(60)]
    assert len({image.tobytes() for image in seen}) > 50
    weights = np.mean(seen, axis=0) - np.median(seen)
    for places in np.mgrid[:65, :65] - 32:
        assert (weights * places).sum() / weights.sum() == pytest.approx(0, abs=0.3)


def test_rendered_scenes_label_every_visible_line():
    sample = render_sample(3)
    assert sample.gray.shape == (480, 640)
    assert len(sample.pieces) > 100
    assert np.linalg.norm(sample.pieces[:, 1] - sample.pieces[:, 0], axis=1).max() < 2 * PIECE
    assert (sample.shares == 1).all()
    gradient = gradient_of(cv2.GaussianBlur(sample.gray, (0, 0), 1.0))
    x, y = np.rint(sample.pieces.mean(axis=1)).astype(int).T
    assert np.median(gradient[y, x]) > 5 * np.median(gradient), "labels lie on edges"


def test_cutting_keeps_every_line_whole():
    lines = np.array([[[0, 0], [30, 40]], [[5, 5], [5, 6]]], np.float32)
    pieces = cut(lines)
    assert len(pieces) == 6 + 1
    np.testing.assert_allclose(pieces[[0, 5, 6], [0, 1, 0]], [[0, 0], [30, 40], [5, 5]], atol=1e-4)
    np.testing.assert_allclose(pieces[1:6, 0], pieces[:5, 1], atol=1e-4)
    assert cut(lines[:0]).shape == (0, 2, 2)


def test_held_out_scenes_are_not_trained_on():
    assert HELD_OUT_SEED + HELD_OUT_SCENES <= FIRST_SEED


def test_labels_are_kept_and_a_damaged_cache_is_mended(tmp_path, caplog):
    path, cache = tmp_path / "a.png", tmp_path / "labels"
    cv2.imwrite(str(path), picture())
    (sample,) = load_samples([path], 1, cache)
    (stored,) = cache.glob("*.npz")
    assert np.load(stored)["shares"].tolist() == sample.shares.tolist()
    whole = stored.read_bytes()
    for damaged in (b"", b"no archive", whole[: len(whole) // 2]):
        stored.write_bytes(damaged)
        again = label_image(path, 1, cache)
        assert again is not None
        assert np.array_equal(again.pieces, sample.pieces)
        assert "damaged" in caplog.text
        caplog.clear()


def test_fingerprint_tells_pixels_labels_and_order_apart():
    first, second = labelled(0), labelled(1)
    bare = replace(first, pieces=first.pieces[:0], shares=first.shares[:0])
    changed = [[replace(first, gray=first.gray + 1)], [replace(first, shares=first.shares / 2)], [bare]]
    sets = [[first, second], [second, first], [first], *changed, []]
    assert len({fingerprint(samples) for samples in sets}) == len(sets)
    assert fingerprint([labelled(0)]) == fingerprint([first])
