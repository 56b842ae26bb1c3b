"""Lines that a person drew: how files are read, what is wrong with them in one sentence, and that they are learned."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from airline import AirLine, UNetEdges
from airline.errors import InputError
from airline.evaluation.metrics import match, mean, pixel_scores
from airline.scenes import RenderedClip
from airline.train import main
from airline.training import drawn as reading
from airline.training.consensus import detect_lsd
from airline.training.crops import draw_labels
from airline.training.dataset import draw_image
from airline.training.drawn import read_drawn

IMAGES = [Path(f"images/{name}") for name in ("a.jpg", "b.png", "c.png")]
ENTRY = {"filename": "a.jpg", "lines": [[1, 2, 3.5, 4]], "height": 480, "width": 640}


def write(folder: Path, **files: object) -> Path:
    """Files by name with _ for the point: text as it is, anything else as JSON."""
    for name, content in files.items():
        text = content if isinstance(content, str) else json.dumps(content)
        (folder / name.replace("_", ".")).write_text(text)
    return folder


def test_text_and_json_give_the_same_lines(tmp_path, caplog):
    write(tmp_path, b_txt="# by hand\n\n10 20 30 40\n0.5 -1 7e1 8\n", c_png_txt="", train_json=[ENTRY], notes_txt="?")
    found = read_drawn(tmp_path, IMAGES)
    assert list(found) == IMAGES
    lines = [found[image].segments.reshape(-1, 4).tolist() for image in IMAGES]
    assert lines == [[[1, 2, 3.5, 4]], [[10, 20, 30, 40], [0.5, -1, 70, 8]], []]
    assert found[IMAGES[0]].size == (640, 480)
    assert "labels of no image, left out: 1 (notes)" in caplog.text
    write(tmp_path, train_json={"lines": [[5, 6, 7, 8]]}).joinpath("train.json").rename(tmp_path / "a.json")
    assert read_drawn(tmp_path, IMAGES)[IMAGES[0]].segments.tolist() == [[[5, 6], [7, 8]]]
    # made for images of the same names in another format
    write(tmp_path, a_json={**ENTRY, "filename": "train/a.png"})
    assert read_drawn(tmp_path, IMAGES)[IMAGES[0]].segments[0, 1].tolist() == [3.5, 4]


@pytest.mark.parametrize(
    ("files", "reason"),
    [
        ({"a_txt": "1 2 3 4\n1 2 3\n"}, "a.txt, row 2: '1 2 3' is not x0 y0 x1 y1"),
        ({"a_txt": "# five\n1 2 3 4 5\n"}, "a.txt, row 2: '1 2 3 4 5' is not"),
        ({"a_txt": "1 2 3 four\n"}, "a.txt, row 1: '1 2 3 four' is not"),
        ({"a_txt": "1 2 3 4\n\n1 nan 3 4\n"}, "a.txt, row 3: it must be four finite numbers"),
        ({"a_txt": "1 2 3 1e300\n"}, "a.txt, row 1: it must be four finite numbers"),
        ({"a_txt": "\0" * 2**21}, "a.txt has more than 1 MB"),
        ({"a_txt": "1 2 3 4\n" * 30}, "a.txt: 30 lines are more than the 20"),
        ({"t_json": [{**ENTRY, "lines": [[1, 2, 3, 4], [1, 2]]}]}, r"t.json is no JSON of lines .*\$\[0\].lines\[1\]"),
        ({"t_json": [{**ENTRY, "lines": [[1, float("nan"), 3, 4]]}]}, "t.json is no JSON of lines"),
        ({"t_json": [{**ENTRY, "lines": [[1, 2, 3, 4], [1, 1e300, 3, 4]]}]}, "t.json, a.jpg, row 2: it must be"),
        ({"t_json": '{"lines":' + "[" * 10**5}, "t.json is no JSON of lines"),
        ({"t_json": {"points": []}}, "t.json is no JSON of lines .*`lines`"),
        ({"t_json": [{"lines": []}]}, "t.json: image 0 of the list has no `filename`"),
        ({"t_json": [ENTRY], "a_txt": ""}, "a.jpg has lines in .*a.txt and in .*t.json, a.jpg: keep one"),
        ({"t_json": [ENTRY, ENTRY]}, "keep one"),
        ({"d_txt": ""}, "'d' may be d.jpg or d.png: give its full name"),
        ({"x_txt": "", "y_txt": ""}, r"no labels of the images in .* \(2 of others\)"),
        ({}, "no labels of the images"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_one_sentence(tmp_path, monkeypatch, files, reason):
    monkeypatch.setattr(reading, "MAX_LINES", 20)
    images = [*IMAGES, Path("images/d.jpg"), Path("images/d.png")]
    with pytest.raises(InputError, match=reason) as error:
        read_drawn(write(tmp_path, **files), images)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_bytes_that_are_no_text_are_an_error(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"\xff\xfe1 2 3 4")
    with pytest.raises(InputError, match=r"a\.txt is no text"):
        read_drawn(tmp_path, IMAGES)


def test_lines_must_fit_their_image(tmp_path):
    path = tmp_path / "a.jpg"
    cv2.imwrite(str(path), np.zeros((100, 200), np.uint8))

    def label(**files: object):
        return draw_image(path, read_drawn(write(tmp_path, **files), [path])[path])

    sample = label(a_txt="-1.5 50 200.5 50\n20 10 20 90\n")  # a pixel beyond the border is a slip of the hand
    assert (sample.shares == 1).all()
    target = draw_labels(sample.pieces, sample.shares, (100, 200))
    assert (target[50] > 0.999).all()
    assert (target[10:91, 20] > 0.999).all()
    assert target[30, 100] == 0
    with pytest.raises(InputError, match=r"a\.txt, row 3: the line leaves the image of 200x100 px by more than 1 px"):
        label(a_txt="0 0 1 1\n# next\n3 3 201 3\n")
    (tmp_path / "a.txt").unlink()
    assert len(label(t_json=[{**ENTRY, "height": 100.0, "width": 200}]).pieces) == 1
    with pytest.raises(InputError, match=r"t\.json, a\.jpg: drawn on 640x480 px, but the image has 200x100 px"):
        label(t_json=[ENTRY])


def striped(scene: int, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """A rendered view with two dark stripes, 10 px wide, across it, and their middles: lines where no edge is."""
    view = RenderedClip(kind=("indoor", "street")[scene % 2], seed=scene, size=(320, 240), effects=None).render(frame)
    gray = cv2.cvtColor(view.image, cv2.COLOR_BGR2GRAY).astype(float)
    (top, bottom), (left, right) = np.random.default_rng((scene, frame)).uniform(0.1, 0.9, (2, 2)) * [[320], [240]]
    lines = np.array([[[top, 10], [bottom, 230]], [[10, left], [310, right]]])
    y, x = np.mgrid[:240, :320]
    for (x0, y0), (x1, y1) in lines:
        (dx, dy), length = (x1 - x0, y1 - y0), np.hypot(x1 - x0, y1 - y0)
        across, along = ((x - x0) * dy - (y - y0) * dx) / length, ((x - x0) * dx + (y - y0) * dy) / length
        gray -= 40 * np.clip(5.5 - abs(across), 0, 1) * ((along > 0) & (along < length))
    return np.clip(np.rint(gray), 0, 255).astype(np.uint8), lines


def quality(detect, pictures) -> tuple[float, float]:
    """F-score at 2 px, and the share of the lines that are found, both in percent."""
    found = [(np.asarray(detect(gray), float), lines, gray.shape) for gray, lines in pictures]
    scores = mean([pixel_scores(segments, lines, lines, shape) for segments, lines, shape in found])
    return scores.f2, 100 * float(np.mean([len(match(segments, lines)) / len(lines) for segments, lines, _ in found]))


def test_twenty_drawn_images_teach_lines_that_no_detector_finds(tmp_path):
    for k in range(20):
        gray, lines = striped(k % 5, 4 * k)
        cv2.imwrite(str(tmp_path / f"{k}.png"), gray)
        np.savetxt(tmp_path / f"{k}.txt", lines.reshape(-1, 4), fmt="%.1f")
    out, given = tmp_path / "net.safetensors", ("--images", tmp_path, "--labels", tmp_path, "--start", "fast")
    assert main([*map(str, (*given, "--steps", 160, "--batch", 4, "--rate", 3e-3, "--out", out))]) == 0
    unseen = [striped(5 + k % 2, 10 * k) for k in range(6)]
    start, trained = (AirLine(edges=UNetEdges(weights)) for weights in ("fast", out))
    before, hits_before = quality(lambda gray: start(gray).segments, unseen)
    after, hits = quality(lambda gray: trained(gray).segments, unseen)
    assert max(hits_before, quality(detect_lsd, unseen)[1]) < 20
    assert hits > 60
    assert after > before + 20
