"""The training command: weights that load, the same weights by any way, Ctrl-C, and errors that one can mend."""

from __future__ import annotations

import _thread
import os
import pty
import re
import signal
from pathlib import Path

import cv2
import pytest
import torch
from safetensors import safe_open

from airline.network.spec import SPECS
from airline.network.weights import load_ranges, load_unet
from airline.train import main
from airline.training.loop import Validation
from tests.helpers.command import command, python, read_screen, refusal
from tests.helpers.pictures import picture

NO_CUDA = pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("training") / "photographs"
    folder.mkdir()
    for seed in range(4):
        cv2.imwrite(str(folder / f"{seed}.png"), picture(seed))
    (folder / "broken.jpg").write_bytes(b"no image")
    return folder


def arguments(photographs: Path, out: Path, *more: object) -> list[str]:
    cache = photographs.parent / "labels"
    given = ("--images", photographs, "--cache", cache, "--views", 1, "--model", "fast", "--out", out, *more)
    return [str(argument) for argument in given]


def content(weights: Path) -> tuple[dict[str, str], dict[str, bytes]]:
    """Header and tensors; safetensors writes the header in any order."""
    with safe_open(weights, framework="pt") as stored:
        return stored.metadata(), {key: stored.get_tensor(key).numpy().tobytes() for key in stored.keys()}  # noqa: SIM118


@pytest.fixture(scope="module")
def uninterrupted(photographs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "net.safetensors"
    assert main(arguments(photographs, out, "--steps", 3)) == 0
    return out


def test_weights_load_and_pictures_show_what_was_learned(uninterrupted):
    assert load_unet(uninterrupted).spec == SPECS["fast"]
    assert load_ranges(uninterrupted)["head"][1] > 0, "what 8-bit inference needs"
    (sheet,) = (uninterrupted.parent / "net-samples").iterdir()
    assert sheet.name == "step-000003.png"
    assert cv2.imread(str(sheet)).shape[1] == 4 * 404


def test_ctrl_c_keeps_a_checkpoint_and_the_same_command_ends_with_the_same_weights(
    photographs, uninterrupted, tmp_path, monkeypatch, caplog
):
    out = tmp_path / "net.safetensors"
    command = arguments(photographs, out, "--steps", 3, "--validate-every", 0.01)
    write_sheet = Validation.write_sheet

    def write_and_interrupt(*given: object) -> None:
        write_sheet(*given)
        _thread.interrupt_main()

    with monkeypatch.context() as patched:  # what a signal does, at a moment that we can choose
        patched.setattr(Validation, "write_sheet", write_and_interrupt)
        assert main(command) == 130
    assert re.search(r"stopped at step 1: the same command goes on from .*net\.checkpoint", caplog.text)
    assert not out.exists()
    caplog.clear()
    assert main(command) == 0
    assert "going on at step 1" in caplog.text
    assert content(out) == content(uninterrupted)


def test_a_finished_training_is_extended_and_other_settings_are_refused(photographs, tmp_path, caplog):
    out = tmp_path / "net.safetensors"
    assert main(arguments(photographs, out, "--steps", 1, "--scenes", 1)) == 0
    for kind in ("photographs", "scenes"):
        assert f"held-out {kind}" in caplog.text
    assert "1 of 5 images could not be read" in caplog.text
    assert main(arguments(photographs, out, "--steps", 2, "--scenes", 1)) == 0
    assert "extended from --steps 1 to 2" in caplog.text
    checkpoint = (tmp_path / "net.checkpoint").read_bytes()
    for change, name in (
        (("--seed", 1), "--seed was 0 and is 1"),
        (("--loss-radius", 3), "--loss-radius was 5"),
        (("--limit", 2), "--images was 4 photographs"),
    ):
        assert name in refusal(*arguments(photographs, out, "--steps", 2, "--scenes", 1, *change), main=main)
    assert (tmp_path / "net.checkpoint").read_bytes() == checkpoint


def test_drawn_lines_beside_consensus_and_alone(photographs, tmp_path, caplog):
    for name in ("0.txt", "2.png.txt"):
        (tmp_path / name).write_text("10 10 100 80\n")
    drawn = ("--labels", tmp_path, "--steps", 1)
    out, alone = tmp_path / "net.safetensors", tmp_path / "alone.safetensors"
    assert main(arguments(photographs, out, *drawn)) == 0
    assert "2 images with drawn lines, 3 without: labelled by consensus" in caplog.text
    assert "fast network on cpu: 1 drawn images, 1 photographs" in caplog.text
    assert "best F on drawn images" in caplog.text
    assert content(out)[0].items() >= {"drawn": "2", "images": "2"}.items()
    reason = refusal(*arguments(photographs, out, "--steps", 1), main=main)
    assert re.search(r"--labels was 2 drawn images \(.*\) and is None", reason)
    caplog.clear()
    given = [{"--model": "--start"}.get(word, word) for word in arguments(photographs, alone, *drawn)]
    assert main([*given, "--drawn-only"]) == 0
    assert "2 images with drawn lines, 3 without: left out" in caplog.text
    assert content(alone)[0].items() >= {"drawn": "2", "images": "0", "start": "fast", "rate": "0.0005"}.items()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("--labels", "file"), "there is no folder of labels file"),
        (("--labels", "folder"), "no labels of the images in folder"),
        (("--drawn-only",), "--drawn-only needs drawn lines"),
        (("--start", "fast"), "argument --start: not allowed with argument --model"),
        (("--images", "nowhere"), "no images in nowhere"),
        (("--out", "nowhere/net.safetensors"), "give a file in a folder that exists"),
        (("--out", "folder"), "folder is a folder"),
        (("--cache", "file"), "mend that"),
        (("--images", "folder"), "none of the images in folder can be read"),
        (("--steps", "0"), "0 must be at least 1"),
        (("--steps", "many"), "invalid int value: 'many'"),
        (("--minutes", "nan"), "nan must be at least 0.01"),
        (("--steps", "3", "--minutes", "3"), "not allowed with"),
        (("--scenes", "-1"), "-1 must be at least 0"),
        (("--loss-weight", "1"), "1 must be at least 0 and below 1"),
        (("--model", "huge"), "invalid choice: 'huge'"),
        pytest.param(("--device", "cuda"), "no CUDA device", marks=NO_CUDA),
    ],
)
def test_errors_are_one_sentence(photographs, tmp_path, monkeypatch, change, reason):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "a.png").write_bytes(b"no image")
    (tmp_path / "file").touch()
    outcome = command(*arguments(photographs, tmp_path / "net.safetensors", *change), main=main)
    assert outcome.code == 2
    (line,) = (line for line in outcome.err.splitlines() if line.startswith("error: "))
    assert reason in line
    assert not (tmp_path / "net.safetensors").exists()


def test_a_terminal_shows_a_bar_and_ctrl_c_stops_it(photographs, tmp_path):
    control, terminal = pty.openpty()
    given = arguments(photographs, tmp_path / "net.safetensors", "--steps", 100_000)
    child = python(*given, module="airline.train", stderr=terminal)
    os.close(terminal)
    asked = []

    def interrupt_once(screen: bytes) -> None:
        if not asked and b"steps/s" in screen:
            asked.append(True)
            child.send_signal(signal.SIGINT)

    with child:
        text = read_screen(control, interrupt_once)
    assert child.returncode == 130, text
    assert re.search(r"step \d+/100000  \d+\.\d steps/s  loss \d\.\d{4}", text)
    assert re.search(r"[\r\n]stopped at step \d+: the same command goes on from", text)
    assert (tmp_path / "net.checkpoint").is_file()
