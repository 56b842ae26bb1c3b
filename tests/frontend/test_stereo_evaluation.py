"""What the evaluation of pairs says of hand-made partners, whose figures are known."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from airline.scenes import RenderedClip
from frontend.evaluate import main
from frontend.evaluation.baselines import nearest_on_rows
from frontend.evaluation.stereo import Pairs, PairTruth, first_pair_scores, partner_scores, rest_scores
from frontend.evaluation.truth import longest_pieces, owners
from frontend.sources.scene import frame_of
from frontend.stereo.disparity import disparities, in_metres
from tests.helpers.data_sets import write_posed

CLIP = RenderedClip("indoor", "handheld", 3, 60)
FRAMES = range(0, 60, 12)
ERRORS = np.diag([0.2**2, 0.002**2]).astype(np.float32)  # covariance of either line: px^2, rad^2


@cache
def views():
    return [(CLIP.render(i), CLIP.render(i, right=True)) for i in FRAMES]


def truths() -> list[PairTruth]:
    return [PairTruth.of(*pair) for pair in views()]


def of_lines(ids, left, right) -> Pairs:
    """With what the lines tell of disparities and distances."""
    covariances, camera = np.tile(ERRORS, (len(ids), 1, 1)), frame_of(0, *views()[0]).camera
    lines = left.astype(np.float32), covariances, right.astype(np.float32), 1.25 * covariances
    disparity, variances, known = disparities(*lines, 0.0)
    points, _ = in_metres(*lines, known, camera)
    return Pairs(ids, lines[0], lines[2], disparity, variances, known, points, 0.0)


@cache
def perfect() -> list[Pairs]:
    """Every line that can be told from its neighbours in both images, by its true id."""
    run = []
    for truth in truths():
        ids = np.intersect1d(truth.left.ids, truth.right.ids)
        left, right = (view.segments_px[longest_pieces(view, ids)] for view in (truth.left, truth.right))
        right = np.where(((left[:, 1] - left[:, 0]) * (right[:, 1] - right[:, 0])).sum(axis=1)[:, None, None] < 0,
                         right[:, ::-1], right)  # fmt: skip
        clear = (owners(left, truth.left) == ids) & (owners(right, truth.right) == ids) & truth.visible(left, ids)
        run.append(of_lines(ids[clear], left[clear], right[clear]))
    return run


def with_right(changed) -> list[Pairs]:
    """The perfect run with other lines on the right."""
    return [of_lines(pairs.ids, pairs.left, changed(pairs.right.copy())) for pairs in perfect()]


def test_perfect_partners_have_perfect_figures():
    figures = partner_scores(perfect(), truths())
    assert figures["partners"] == figures["visible"] > 300
    assert figures["precision"] == figures["recall"] == 1
    assert figures["wrong"] == figures["unknown"] == 0
    assert figures["disparity_rms_px"] < 0.01
    assert figures["chi2"] < 0.01
    assert figures["depth_known"] > 0.4
    assert figures["along_rows"] > 0.1
    assert sum(group["ends"] for group in figures["depth"].values()) > 300
    assert all(group["error"] < 1e-3 for group in figures["depth"].values() if group["ends"])


def test_lost_and_mistaken_partners_are_counted():
    def lost(right):
        right[:10] = np.nan
        return right

    def mistaken(right):
        right[:10] = np.roll(right[:10], 1, axis=0)
        return right

    lines = sum(len(pairs.ids) for pairs in perfect())
    ten = 10 * len(FRAMES)
    figures = partner_scores(with_right(lost), truths())
    assert (figures["visible"], figures["precision"]) == (lines, 1)
    assert figures["recall"] == pytest.approx(1 - ten / lines, abs=1e-4)
    figures = partner_scores(with_right(mistaken), truths())
    assert (figures["visible"], figures["wrong"]) == (lines, ten)
    assert figures["precision"] == figures["recall"] == pytest.approx(1 - ten / lines, abs=1e-4)
    figures = partner_scores(with_right(lambda right: right - (23, 31)), truths())
    assert figures["unknown"] + figures["wrong"] > 0.9 * lines


def test_shifted_partners_have_that_error():
    figures = partner_scores(with_right(lambda right: right - (0.5, 0)), truths())
    assert figures["precision"] == 1
    assert figures["disparity_rms_px"] == pytest.approx(0.5, abs=0.01)
    assert figures["disparity_median_px"] == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("factor", [1, 2])
def test_honest_noise_is_called_so(factor):
    rng = np.random.default_rng(0)

    def moved(lines, errors):
        delta = lines[:, 1] - lines[:, 0]
        ends = errors[:, :1] / np.hypot(*delta.T)[:, None] + errors[:, 1:] * (-0.5, 0.5)
        return lines + ends[:, :, None] * (delta[:, ::-1] * (-1, 1))[:, None]

    def noisy(pairs):
        left, own = factor * rng.multivariate_normal((0, 0), ERRORS, (2, len(pairs.ids)))
        return of_lines(pairs.ids, moved(pairs.left, left), moved(pairs.right, left + 0.5 * own))

    run = [noisy(pairs) for pairs in perfect() for _ in range(3)]
    figures = partner_scores(run, [truth for truth in truths() for _ in range(3)])
    assert figures["chi2"] == pytest.approx(factor**2, rel=0.15)


def test_lines_from_a_first_pair():
    poses = SimpleNamespace(name="", K=CLIP.K, poses=np.array([CLIP.pose(i)[:3] for i in FRAMES]))
    figures = first_pair_scores(perfect(), poses)
    assert figures["of"] > figures["tracks"] == figures["always"] == figures["usually"] > 20
    run = perfect()
    run = [*run[:3], replace(run[3], left=run[3].left + 5), run[4]]
    figures = first_pair_scores(run, poses)
    assert figures["always"] < 0.2 * figures["usually"]
    assert figures["usually_share"] == 1, "one frame of four is off"
    nearer = replace(perfect()[0], points=0.7 * perfect()[0].points)
    figures = first_pair_scores([nearer, *perfect()[1:]], poses)
    assert figures["usually_share"] < 0.5
    unknown = replace(perfect()[0], known=np.zeros_like(perfect()[0].known))
    assert first_pair_scores([unknown, *perfect()[1:]], poses)["tracks"] == 0


def test_spread_at_rest():
    pairs = perfect()[0]
    run = [replace(pairs, points=pairs.points * size) for size in (0.98, 0.99, 1, 1.01, 1.02)]
    figures = rest_scores(run)
    assert figures["tracks"] > 10
    assert figures["depth_spread"] == pytest.approx(0.0148, abs=1e-4)
    assert figures["length_spread"] == pytest.approx(0.0148, abs=1e-4)
    assert rest_scores(run[:1])["depth_spread"] == 0


def test_the_plain_partner_is_the_nearest_on_the_rows():
    image = np.full((100, 200), 100, np.uint8)
    image[:, 150:] = 160  # another scene to the right
    upright = np.array([[[100.0, 20.0], [100.0, 60.0]]], np.float32)
    others = upright + np.array([-30, -12, 9, 0, 70])[:, None, None] * np.array([1, 0], np.float32)
    others[3] += (-5, 30)  # a quarter of the rows
    leaning = upright + np.array([[-12.0, 0.0], [6.0, 0.0]], np.float32)
    assert nearest_on_rows(upright, others, image, image).tolist() == [1]
    assert nearest_on_rows(upright, others[:, ::-1], image, image).tolist() == [1], "in any direction"
    assert nearest_on_rows(upright, others[2:], image, image).tolist() == [-1]
    assert nearest_on_rows(upright, leaning, image, image).tolist() == [-1]
    assert nearest_on_rows(upright, upright - (60, 0), image, image).tolist() == [-1], "too near to be seen"
    assert nearest_on_rows(upright + (60, 0), upright + (35, 0), image, image).tolist() == [-1], "unlike"
    both = np.concatenate([upright, upright + (20, 0)])
    assert nearest_on_rows(both, others, image, image).tolist() == [1, 2]
    assert nearest_on_rows(both, others[:0], image, image).tolist() == [-1, -1]
    assert nearest_on_rows(both[:0], others, image, image).tolist() == []


def test_command(tmp_path, capsys):
    path, folder = tmp_path / "figures.json", write_posed(tmp_path / "posed")
    assert main(["--stereo", "--sequence", "room", "--limit", "2", "--json", str(path)]) == 0
    figures = json.loads(path.read_text())
    assert list(figures["partners"]) == ["room"]
    assert list(figures["partners"]["room"]) == ["ours", "plain"]
    assert figures["partners"]["room"]["plain"]["precision"] > 0.7
    assert figures["partners"]["room"]["plain"]["recall"] > 0.6
    right = folder / "images_right"
    right.mkdir()
    clip = RenderedClip("indoor", "handheld", 3, 6, (320, 240))
    for k in range(6):
        cv2.imwrite(str(right / f"{k:03}.png"), clip.render(k, right=True).image)
    moved = np.column_stack([clip.K, (-clip.K[0, 0] * clip.baseline_m, 0, 0)])
    with (folder / "calib.txt").open("a") as file:
        file.write("P1: " + " ".join(map(str, moved.ravel())) + "\n")
    assert main(["--stereo", str(folder), "--json", str(path)]) == 0
    plain = json.loads(path.read_text())["first_pairs"]["posed"]["plain"]
    assert plain["of"] >= plain["tracks"] > 10
    assert plain["usually_share"] > 0.5
    (folder / "poses.txt").unlink()
    assert main(["--stereo", str(folder), "--json", str(path)]) == 0
    assert json.loads(path.read_text())["at_rest"]["posed"]["plain"]["tracks"] > 5
    assert main(["--stereo", "--sequence", "forest"]) == 2
    printed = capsys.readouterr()
    assert "no sequence 'forest'" in printed.err
    assert max(map(len, printed.out.splitlines())) <= 100
