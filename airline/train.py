"""Train the edge network on photographs: `python -m airline.train --images DIR --out FILE`.

Labels are not needed; `--labels DIR` takes lines that a person drew into some or all of them.

The same command goes on where an interrupted training stopped.
"""

from __future__ import annotations

import argparse
import logging
import sys
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
import torch

from airline.command import EXIT_USER_ERROR, Parser, StderrHandler, number
from airline.errors import AirLineError, ConfigError, InputError
from airline.evaluation.dataset import list_images
from airline.network.spec import SPECS
from airline.network.unet import UNet, measure_ranges
from airline.network.weights import load_unet, save_unet
from airline.training.crops import Crops
from airline.training.dataset import HELD_OUT_SEED, Sample, fingerprint, load_drawn, load_samples, render_samples
from airline.training.drawn import read_drawn
from airline.training.loop import Schedule, State, Validation, find_device, split
from airline.training.session import Session

log = logging.getLogger("airline.train")

DEFAULT_STEPS = 28000
HELD_OUT_SCENES = 12
START_RATE = 5e-4  # peak learning rate for weights that are good already
# what a checkpoint depends on
SETTINGS = ("model", "start", "minutes", "batch", "rate", "scenes", "views", "seed", "loss_weight", "loss_radius")


def build_parser() -> argparse.ArgumentParser:
    """All arguments."""
    parser = Parser(
        prog="python -m airline.train", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--images", type=Path, required=True, metavar="DIR", help="folder of photographs; labels are not needed")
    add("--out", type=Path, required=True, metavar="FILE", help="weights file to write (.safetensors)")
    add("--labels", type=Path, metavar="DIR", help="lines drawn by a person: NAME.txt per image, or Wireframe's JSON")
    add("--drawn-only", action="store_true", help="leave out the photographs without drawn lines")
    shape = parser.add_mutually_exclusive_group()
    shape.add_argument("--model", choices=SPECS, default="default", help="shape of the network (default: %(default)s)")
    shape.add_argument("--start", metavar="WEIGHTS", help="train these on, bundled ones by name or a file")
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--steps", type=number(int, 1), metavar="N", help=f"training steps (default: {DEFAULT_STEPS})")
    length.add_argument("--minutes", type=number(float, 0.01), metavar="M", help="train for this long instead")
    batch, weight, radius = Crops.batch, Crops.weight, Crops.radius
    rates = f"{Schedule.peak_rate:g}, with --start {START_RATE:g}"
    add("--batch", type=number(int, 1), default=batch, metavar="N", help="crops per step (default: %(default)s)")
    add("--rate", type=number(float, 1e-9), metavar="R", help=f"peak learning rate (default: {rates})")
    add("--scenes", type=number(int, 0), default=0, metavar="N", help="add N rendered scenes with exact lines")
    add("--limit", type=number(int, 1), metavar="N", help="use at most N photographs, drawn ones first")
    add("--views", type=number(int, 1), default=7, metavar="N", help="random views per photograph for its labels")
    add("--cache", type=Path, metavar="DIR", help="folder of cached labels (default: beside --out)")
    add("--seed", type=number(int, 0, 2**63), default=0, metavar="N", help="of weights, crops and held-out photographs")
    add("--device", choices=("auto", "cpu", "cuda"), default="auto", help="where to train (default: %(default)s)")
    add("--validate-every", type=number(float, 0.01), default=180, metavar="SECONDS", help="(default: 180)")
    add("--loss-weight", type=number(float, 0, 1), default=weight, metavar="W", help="w of the loss: near lines")
    add("--loss-radius", type=number(int, 0, 51), default=radius, metavar="R", help="r of the loss: how near, px")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    options = build_parser().parse_args(arguments)
    logging.basicConfig(format="%(message)s", handlers=[StderrHandler()])
    logging.getLogger("airline").setLevel(logging.INFO)
    cv2.setNumThreads(1)
    try:
        return 0 if run(options) else 130
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    except OSError as error:
        print(f"error: {error}: mend that, or give another file or folder", file=sys.stderr)
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        print("interrupted: the same command goes on from what was kept", file=sys.stderr)
        return 130


def run(options: argparse.Namespace) -> bool:
    """Label, train, write the weights; False if Ctrl-C stopped it, ready to go on; raises AirLineError."""
    device = find_device(options.device)
    _check_writable(options.out)
    options.rate = options.rate or (START_RATE if options.start else Schedule.peak_rate)
    torch.manual_seed(options.seed)
    net = load_unet(options.start) if options.start else UNet(SPECS[options.model], norm=True)
    drawn, photographs = _samples(options)
    scenes = render_samples(options.scenes)
    kinds = {"drawn images": split(drawn), "photographs": split(photographs)}
    kinds["scenes"] = render_samples(min(HELD_OUT_SCENES, options.scenes), HELD_OUT_SEED), scenes
    held_out, rest = ({kind: halves[k] for kind, halves in kinds.items() if halves[k]} for k in range(2))
    steps = DEFAULT_STEPS if options.steps is None and options.minutes is None else options.steps
    every = list(chain.from_iterable(rest.values()))
    crops = Crops(every, options.seed, options.batch, weight=options.loss_weight, radius=options.loss_radius)
    session = Session(
        schedule=Schedule(steps, options.minutes, options.rate, min(Schedule.warmup, (steps or DEFAULT_STEPS) // 5)),
        validation=Validation(held_out, crops),
        validate_every=options.validate_every,
        settings={
            "--images": f"{len(photographs)} photographs ({fingerprint(photographs)})",
            "--labels": f"{len(drawn)} drawn images ({fingerprint(drawn)})" if drawn else None,
            "--steps": steps,
            **{f"--{name.replace('_', '-')}": getattr(options, name) for name in SETTINGS},
        },
        checkpoint=options.out.with_name(options.out.stem + ".checkpoint"),
        sheets=options.out.with_name(options.out.stem + "-samples"),
    )
    log.info("%s network on %s: %s", options.start or options.model, device.type, _counted(rest))
    log.info("held out: %s; pictures in %s", _counted(held_out), session.sheets)
    state = State(net, device)
    if not session.run(state, crops):
        return False
    origin = "start" if options.start else "model"
    notes = {name: str(getattr(options, name)) for name in (origin, "batch", "rate", "seed")}
    notes |= {"images": str(len(photographs)), "drawn": str(len(drawn)), "scenes": str(len(scenes))}
    notes["steps"] = str(state.step)
    ranges = measure_ranges(state.net.folded(), (sample.gray for sample in chain.from_iterable(held_out.values())))
    log.info("wrote %s  sha256 %s", options.out, save_unet(state.net, options.out, ranges, **notes))
    return True


def _samples(options: argparse.Namespace) -> tuple[list[Sample], list[Sample]]:
    """Images with drawn lines and photographs to be labelled by consensus, each in the seed's order."""
    if options.drawn_only and not options.labels:
        raise ConfigError("--drawn-only needs drawn lines: give --labels DIR")
    paths = list_images(options.images)
    np.random.default_rng(options.seed).shuffle(paths)
    drawn = read_drawn(options.labels, paths) if options.labels else {}
    others = [path for path in paths if path not in drawn]
    if drawn:
        how = "left out" if options.drawn_only else "labelled by consensus"
        log.info("%d images with drawn lines, %d without%s", len(drawn), len(others), f": {how}" if others else "")
    if options.limit:
        drawn = dict(list(drawn.items())[: options.limit])
        others = others[: options.limit - len(drawn)]
    marked = load_drawn(drawn)
    cache = options.cache or options.out.with_name(options.out.stem + "-labels")
    photographs = [] if options.drawn_only else load_samples(others, options.views, cache)
    if not marked and not photographs:
        raise InputError(f"none of the images in {options.images} can be read: give photographs of 64 px and more")
    return marked, photographs


def _counted(kinds: dict[str, list[Sample]]) -> str:
    return ", ".join(f"{len(samples)} {kind}" for kind, samples in kinds.items())


def _check_writable(out: Path) -> None:
    """Raise now and not after hours of training."""
    try:
        probe = out.with_name(out.name + ".partial")
        probe.touch()
        probe.unlink()
    except (OSError, ValueError) as error:
        raise InputError(f"cannot write {out} ({error}): give a file in a folder that exists as --out") from None
    if out.is_dir():
        raise InputError(f"{out} is a folder: give a file as --out")


if __name__ == "__main__":
    sys.exit(main())
