"""Training: losses and labels against hand-computed cases, and a few real steps."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

from airline.train import Schedule, main, make_batch, train
from airline.training.consensus import PIECE, PseudoLabels, consensus, detect_lsd
from airline.training.dataset import Sample, draw_labels, motion_kernel, random_crop
from airline.training.loss import disk, edge_loss
from airline.training.rendered import cut, render_sample
from airline.unet import UNet, UNetSpec
from airline.weights import load_unet

SMALL = UNetSpec(base=8, levels=3)


def picture(seed: int = 0, size: int = 160) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = np.full((size, size), 110, np.uint8)
    for _ in range(6):
        box = rng.integers(0, size, 4).reshape(2, 2)
        cv2.rectangle(image, box[0].tolist(), box[1].tolist(), int(rng.integers(0, 255)), -1)
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.7) + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)


def labelled(seed: int) -> Sample:
    gray = picture(seed)
    return Sample(gray, consensus(gray, 2, np.random.default_rng(seed)))


def test_loss_of_a_hand_computed_map():
    # one positive pixel in a 21 x 21 map of zero logits: BCE is log 2 everywhere, so any weights give log 2
    target = torch.zeros(1, 1, 21, 21)
    target[0, 0, 10, 10] = 1
    inside = torch.ones(1, 1, 21, 21, dtype=torch.bool)
    assert edge_loss(torch.zeros(1, 1, 21, 21), target, inside).item() == pytest.approx(np.log(2), abs=1e-6)
    # a wrong pixel within the disk weighs 1, outside it 1 - w; 81 pixels lie within 5 px
    weights = 81 + (441 - 81) * 0.2
    for place, weight in (((10, 15), 1.0), ((0, 0), 0.2)):
        logits = torch.full((1, 1, 21, 21), -30.0)
        logits[0, 0, 10, 10] = 30.0
        logits[(0, 0, *place)] = 30.0
        assert edge_loss(logits, target, inside).item() == pytest.approx(30 * weight / weights, rel=1e-4)


def test_pixels_outside_the_photograph_do_not_count():
    logits, target = torch.randn(1, 1, 16, 16), torch.zeros(1, 1, 16, 16)
    inside = torch.ones(1, 1, 16, 16, dtype=torch.bool)
    inside[..., :8] = False
    changed = logits.clone()
    changed[..., :8] += 100
    assert edge_loss(changed, target, inside) == edge_loss(logits, target, inside)


def test_disk_holds_the_offsets_within_its_radius():
    assert disk(1)[0, 0].tolist() == [[0, 1, 0], [1, 1, 1], [0, 1, 0]]
    assert disk(5).sum() == 81


def test_labels_are_ridges_of_the_lines_shares():
    target = draw_labels(np.array([[[10, 20], [50, 20]]], np.float32), np.array([0.7], np.float32), 64)
    assert target[20, 10:51] == pytest.approx(np.full(41, 0.7), abs=1e-6)
    assert target[21, 30] == pytest.approx(0.7 * np.exp(-1 / (2 * 0.64)), abs=1e-6)
    assert target[24].max() == 0


def test_lsd_positions_count_from_the_pixel_centre():
    image = np.full((128, 128), 60, np.uint8)
    image[:, 64:] = 180  # the edge is at x = 63.5
    found = detect_lsd(image)
    assert len(found) >= 2, "one per scale"
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


def test_a_few_steps_lower_the_loss_and_repeat_exactly():
    samples = [labelled(seed) for seed in range(3)]
    schedule = Schedule(steps=60, batch=2, crop=64, warmup=2)
    losses, weights = [], []
    for _ in range(2):
        torch.manual_seed(0)
        net = UNet(SMALL, norm=True)
        image, target, inside = make_batch(samples, schedule, (9, 9))
        net.eval()
        before = edge_loss(net(image), target, inside).item()
        train(samples, net, schedule, seed=1)
        net.eval()
        losses.append((before, edge_loss(net(image), target, inside).item()))
        weights.append(net.head.weight.detach().clone())
    assert losses[0][1] < 0.85 * losses[0][0]
    assert torch.equal(*weights), "the same seed gives the same weights"


def test_command_writes_weights_that_load(tmp_path, capsys):
    (tmp_path / "photos").mkdir()
    for seed in range(3):
        cv2.imwrite(str(tmp_path / "photos" / f"{seed}.png"), picture(seed))
    (tmp_path / "photos" / "broken.jpg").write_bytes(b"no image")
    out = tmp_path / "net.safetensors"
    command = ["--images", str(tmp_path / "photos"), "--out", str(out), "--steps", "2", "--views", "1", "--scenes", "1"]
    assert main(command) == 0
    assert load_unet(out).spec == UNetSpec()
    assert main(["--images", str(tmp_path / "nowhere"), "--out", str(out)]) == 2
    assert "no images in" in capsys.readouterr().err


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


def test_training_resumes_where_it_stopped(tmp_path):
    samples = [labelled(0)]
    torch.manual_seed(0)
    whole = train(samples, UNet(SMALL, norm=True), Schedule(4, 2, 64, warmup=1), seed=1)
    torch.manual_seed(0)
    checkpoint = tmp_path / "state"
    schedule = Schedule(4, 2, 64, warmup=1)
    part = UNet(SMALL, norm=True)
    train(samples, part, schedule, seed=1, checkpoint=checkpoint)
    state = torch.load(checkpoint, weights_only=True)
    assert state["step"] == 4
    assert all(torch.equal(value, whole.state_dict()[key]) for key, value in state["net"].items())
    again = train(samples, UNet(SMALL, norm=True), schedule, seed=1, checkpoint=checkpoint)
    assert torch.equal(again.head.weight, part.head.weight), "a finished run is not trained further"
