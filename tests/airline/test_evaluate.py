"""The evaluation command: repeatability, bad light, data sets, and the whole command on a small drawn data set."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from airline.errors import InputError
from airline.evaluate import main
from airline.evaluation.benchmark import BAD_LIGHT, BadLight, darken, lsd, measure, motion_blur, overexpose
from airline.evaluation.dataset import list_images, load_dataset, read_lines
from airline.evaluation.metrics import clip, compare, corners, match, random_view, warp
from tests.helpers.command import refusal

SHAPE = (120, 160)
SCORE_KEYS = ["lp", "p2", "r2", "f2", "f1", "lines"]
RUN_KEYS = [*SCORE_KEYS, "repeatability", "localisation", "ms"]


def _line(x0: float, y0: float, x1: float, y1: float) -> NDArray[np.float64]:
    return np.array([[[x0, y0], [x1, y1]]], float)


def _random_lines(seed: int, count: int = 40) -> NDArray[np.float64]:
    return np.random.default_rng(seed).uniform((0, 0), (SHAPE[1] - 1, SHAPE[0] - 1), (count, 2, 2))


@pytest.mark.parametrize("seed", range(5))
def test_an_ideal_detector_repeats_everything_exactly(seed):
    lines = _random_lines(seed)
    _, homography = random_view(np.random.default_rng(seed), np.zeros(SHAPE, np.uint8))
    seen = clip(warp(lines, homography), corners(SHAPE))  # it finds no line outside its image
    scores = compare(lines, seen[:, ::-1], homography, SHAPE)
    assert scores.repeatability == 1.0
    assert scores.localisation == pytest.approx(0, abs=1e-9)


def test_what_the_scores_of_a_pair_are():
    lines = np.concatenate([_line(20, y, 120, y) for y in (20, 40, 60, 80)])
    scores = compare(lines, lines[:2] + (0, 0.5), np.eye(3), SHAPE)
    assert scores.repeatability == pytest.approx((2 / 4 + 2 / 2) / 2), "the mean of both directions"
    assert scores.localisation == pytest.approx(0.5)
    lines = np.concatenate([_line(5, 2 * y, 150, 2 * y) for y in range(1, 56)])
    moved = lines + np.where(np.arange(55) < 10, 0.4, 0)[:, None, None] * (0, 1)
    assert compare(lines, moved, np.eye(3), SHAPE).localisation == pytest.approx(5 * 0.4 / 50), "of the 50 best"
    none = compare(lines[:0], lines[:0], np.eye(3), SHAPE)
    assert none.repeatability == 0.0
    assert np.isnan(none.localisation)


def test_only_lines_that_both_images_see_count():
    shift = np.array([[1, 0, 100], [0, 1, 0], [0, 0, 1.0]])
    seen, lost = _line(5, 20, 50, 20), _line(70, 30, 150, 30)
    assert compare(np.concatenate([seen, lost]), seen + (100, 0), shift, SHAPE).repeatability == 1.0
    assert compare(lost, _line(5, 50, 90, 50), shift, SHAPE).repeatability == 0.0


def test_matching_is_one_to_one_and_nearest_first():
    line = _line(20, 20, 120, 20)
    twice = np.concatenate([line + (0, 0.4), line + (0, 0.1)])
    assert match(line, twice) == pytest.approx([0.1])
    pairs = np.concatenate([line, line + (0, 2)]), np.concatenate([line + (0, 1.8), line + (0, 4)])
    assert match(*pairs) == pytest.approx([0.2])


@pytest.mark.parametrize(
    ("other", "distances"),
    [
        (_line(0, 2.9, 100, 2.9), [2.9]),
        (_line(0, 3.1, 100, 3.1), []),
        (_line(49, 0, 149, 0), [0]),  # covers 51 of 100 px
        (_line(51, 0, 151, 0), []),
        (_line(100, 0, 0, 0), [0]),
        (_line(0, 0, 34, 0), [0]),  # all of one and a third of the other
        (_line(0, 1, 100, 3), [1 + 1 / np.hypot(1, 0.02)]),  # the mean over both lines and their ends
    ],
)
def test_what_matches(other, distances):
    assert match(_line(0, 0, 100, 0), other) == pytest.approx(distances)


def test_a_detector_that_finds_nothing(dataset):
    figures = measure(load_dataset(dataset, limit=1), lambda image: np.zeros((0, 2, 2)))
    assert (figures["p2"], figures["r2"], figures["f2"], figures["lines"]) == (100, 0, 0, 0)
    assert (figures["repeatability"], figures["localisation"]) == (0, None)


@pytest.mark.parametrize(("degrees", "matches"), [(29, 1), (31, 0)])
def test_lines_at_an_angle_do_not_match(degrees, matches):
    arm = 5.5 * np.array([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])  # the ends are under 3 px away
    assert len(match(_line(-5.5, 0, 5.5, 0), _line(*-arm, *arm))) == matches


def test_views_agree_with_their_homography():
    image = np.zeros((240, 320), np.uint8)
    cv2.circle(image, (140, 110), 4, 255, -1)
    y, x = np.mgrid[:240, :320]
    for seed in range(5):
        view, homography = random_view(np.random.default_rng(seed), image)
        weight = view / view.sum(dtype=float)
        found = np.array([(weight * x).sum(), (weight * y).sum()])
        np.testing.assert_allclose(found, warp(np.array([140.0, 110.0]), homography), atol=0.1)
        assert np.array_equal(view, random_view(np.random.default_rng(seed), image)[0])


def test_what_bad_light_does():
    image = np.full((200, 200), 240, np.uint8)
    dark = darken(image, 3)
    assert dark.mean() == pytest.approx(60, abs=0.2)
    assert dark.std() == pytest.approx(8, abs=0.1)
    assert np.array_equal(dark, darken(image, 3))
    assert not np.array_equal(dark, darken(image, 4))
    dot, expected = np.zeros((2, 9, 31), np.uint8)
    dot[4, 15], expected[4, 11:20] = 90, 10
    assert np.array_equal(motion_blur(dot, 0), expected)
    assert overexpose(np.array([[10, 127, 128, 250]], np.uint8), 0).tolist() == [[20, 254, 255, 255]]


def test_preparation_blurs_sharpens_and_stretches():
    step = np.repeat(np.array([[50, 100]], np.uint8), 40, axis=1)
    blurred, sharpened = (BadLight(darken, sigma=2, amount=amount, gain=1).prepare(step) for amount in (-1, 1))
    np.testing.assert_array_equal(blurred, cv2.GaussianBlur(step, (0, 0), 2))
    assert 50 < blurred[0, 39] < 75 < blurred[0, 40] < 100
    assert sharpened[0, 39] < 50
    assert sharpened[0, 40] > 100
    assert set(BadLight(darken, sigma=2, amount=0, gain=4).prepare(step)[0].tolist()) == {200, 255}


def test_line_files(tmp_path):
    path = tmp_path / "lines.txt"
    path.write_text("1 2 3 4 0.9\n\n5.5 6 -7 8e1 0.1 line\n")
    assert read_lines(path).tolist() == [[[1, 2], [3, 4]], [[5.5, 6], [-7, 80]]]
    path.write_text("")
    assert read_lines(path).shape == (0, 2, 2)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        *((bad, r"lines\.txt is malformed") for bad in (b"1 2 3\n", b"1 2 3 4\n1 2\n", b"a b c d\n", b"\xff\xfe")),
        (b"1 2 3\n4 1 2\n3 4 1\n2 3 4\n", r"lines\.txt is malformed"),  # four times three numbers
        *((b"1 2 3 " + bad, "coordinates") for bad in (b"nan", b"inf", b"-1e7")),
    ],
)
def test_malformed_line_files(tmp_path, content, message):
    path = tmp_path / "lines.txt"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_lines(path)


def test_dataset(dataset):
    samples = load_dataset(dataset)
    assert [sample.path.name for sample in samples] == ["0.png", "1.png"]
    assert [(len(sample.sparse), len(sample.dense)) for sample in samples] == [(4, 4), (4, 8)]
    assert samples[0].read().shape == SHAPE


def test_only_image_files_are_listed(tmp_path):
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "notes.txt").touch()
    with pytest.raises(InputError, match="no images in"):
        list_images(tmp_path)
    for name in ("b.PNG", "a.jpg"):
        (tmp_path / name).touch()
    assert [path.name for path in list_images(tmp_path)] == ["a.jpg", "b.PNG"]


def test_both_sides_are_measured_alike(dataset):
    """LSD against LSD: the same images, views and noise for both, so everything but the time agrees."""
    figures = measure(load_dataset(dataset), lsd())
    rival = figures.pop("lsd")
    assert set(figures) == {*RUN_KEYS, "bad_light"}
    for key in set(RUN_KEYS) - {"ms"}:
        assert figures[key] == rival[key], key
    assert figures["f2"] > 95
    assert figures["repeatability"] > 0.9
    assert 0 < figures["localisation"] < 0.5
    for light in figures["bad_light"].values():
        assert light.pop("lsd") == {key: light[key] for key in ("p2", "r2", "f2")}
    assert figures["bad_light"]["dark"]["lsd_prepared"]["r2"] > figures["bad_light"]["dark"]["r2"]


def test_command(dataset, tmp_path, capsys):
    out = tmp_path / "figures.json"
    assert main([str(dataset), "--json", str(out)]) == 0
    figures = json.loads(out.read_text())
    assert set(figures) == {"images", *RUN_KEYS, "lsd", "bad_light"}
    assert figures["images"] == 2
    assert min(scores[key] for scores in (figures, figures["lsd"]) for key in ("p2", "r2")) > 90
    assert set(figures["bad_light"]) == set(BAD_LIGHT) == {"dark", "blur", "bright"}
    printed = capsys.readouterr().out
    for word in ("AirLine", "LSD", "LP10", "P2", "repeatability", "dark: LSD, prepared"):
        assert word in printed


def test_command_scores_predictions(dataset, tmp_path, capsys):
    out = tmp_path / "figures.json"
    arguments = [str(dataset), "--predictions", str(dataset / "lines_cho"), "--limit", "1", "--json", str(out)]
    assert main(arguments) == 0
    figures = json.loads(out.read_text())
    assert figures == {
        "images": 1,
        "lp": dict.fromkeys(("0", "1", "2", "3", "5", "10"), 100.0),
        **dict.fromkeys(("p2", "r2", "f2", "f1"), 100.0),
        "lines": 4.0,
    }
    assert "lines_cho" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("part", "content", "message"),
    [
        ("lines_denis/1.txt", None, "no line file"),
        ("lines_cho/0.txt", "1 2 3\n", "is malformed"),
        ("images/0.png", "not a picture", "cannot be read as an image"),
        ("images", None, "no folder"),
    ],
)
def test_bad_data_is_one_sentence(dataset, part, content, message):
    if content is None:
        (dataset / part).rename(dataset / "elsewhere")
    else:
        (dataset / part).write_text(content)
    assert message in refusal(dataset, main=main)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--limit", "0"], "--limit"),
        (["--preset", "best"], "no preset"),
        (["--weights", "nothing.safetensors"], "no weights file"),
        (["--json", "nowhere/figures.json"], "no folder"),
        (["--predictions", "nowhere"], "no line file"),
        (["--ablate", "--preset", "fast"], "--ablate does not go with --preset"),
        (["--predictions", "x", "--weights", "y"], "--predictions does not go with --weights"),
        (["--runtime", "abacus"], "invalid choice"),
    ],
)
def test_bad_arguments_are_one_sentence(dataset, arguments, message):
    assert message in refusal(dataset, *arguments, main=main)
