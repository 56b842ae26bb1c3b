"""Train the edge network on photographs without labels: `python -m airline.train --images DIR --out FILE`.

The same command goes on where an interrupted training stopped.
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

import cv2
import numpy as np
import torch

from airline.command import EXIT_USER_ERROR, Parser, StderrHandler, number
from airline.errors import AirLineError, InputError
from airline.evaluation.dataset import list_images
from airline.network.spec import SPECS
from airline.network.unet import UNet, measure_ranges
from airline.network.weights import save_unet
from airline.training.crops import Crops
from airline.training.dataset import HELD_OUT_SEED, Sample, fingerprint, load_samples, render_samples
from airline.training.loop import Schedule, State, Validation, find_device, split
from airline.training.session import Session

log = logging.getLogger("airline.train")

DEFAULT_STEPS = 28000
HELD_OUT_SCENES = 12
# what a checkpoint depends on
SETTINGS = ("model", "minutes", "batch", "rate", "scenes", "views", "seed", "loss_weight", "loss_radius")


def build_parser() -> argparse.ArgumentParser:
    """All arguments."""
    parser = Parser(
        prog="python -m airline.train", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--images", type=Path, required=True, metavar="DIR", help="folder of photographs; labels are not needed")
    add("--out", type=Path, required=True, metavar="FILE", help="weights file to write (.safetensors)")
    add("--model", choices=SPECS, default="default", help="shape of the network (default: %(default)s)")
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--steps", type=number(int, 1), metavar="N", help=f"training steps (default: {DEFAULT_STEPS})")
    length.add_argument("--minutes", type=number(float, 0.01), metavar="M", help="train for this long instead")
    batch, rate, weight, radius = Crops.batch, Schedule.peak_rate, Crops.weight, Crops.radius
    add("--batch", type=number(int, 1), default=batch, metavar="N", help="crops per step (default: %(default)s)")
    add("--rate", type=number(float, 1e-9), default=rate, metavar="R", help="peak learning rate (default: %(default)s)")
    add("--scenes", type=number(int, 0), default=0, metavar="N", help="add N rendered scenes with exact lines")
    add("--limit", type=number(int, 1), metavar="N", help="use at most N photographs")
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
    photographs, scenes, held_out_scenes = _samples(options)
    held_out, rest = split(photographs)
    steps = DEFAULT_STEPS if options.steps is None and options.minutes is None else options.steps
    crops = Crops(rest + scenes, options.seed, options.batch, weight=options.loss_weight, radius=options.loss_radius)
    session = Session(
        schedule=Schedule(steps, options.minutes, options.rate),
        validation=Validation(held_out, held_out_scenes, crops),
        validate_every=options.validate_every,
        settings={
            "--images": f"{len(photographs)} photographs ({fingerprint(photographs)})",
            "--steps": steps,
            **{f"--{name.replace('_', '-')}": getattr(options, name) for name in SETTINGS},
        },
        checkpoint=options.out.with_name(options.out.stem + ".checkpoint"),
        sheets=options.out.with_name(options.out.stem + "-samples"),
    )
    log.info("%s network on %s: %d photographs, %d scenes", options.model, device.type, len(rest), len(scenes))
    log.info("held out: %d photographs, %d scenes; pictures in %s", len(held_out), len(held_out_scenes), session.sheets)
    torch.manual_seed(options.seed)
    state = State(UNet(SPECS[options.model], norm=True), device)
    if not session.run(state, crops):
        return False
    notes = {name: str(getattr(options, name)) for name in ("model", "batch", "rate", "seed")}
    notes |= {"images": str(len(photographs)), "scenes": str(len(scenes)), "steps": str(state.step)}
    ranges = measure_ranges(state.net.folded(), (sample.gray for sample in held_out + held_out_scenes))
    log.info("wrote %s  sha256 %s", options.out, save_unet(state.net, options.out, ranges, **notes))
    return True


def _samples(options: argparse.Namespace) -> tuple[list[Sample], list[Sample], list[Sample]]:
    """Photographs in the seed's order, scenes to train on, scenes held out."""
    paths = list_images(options.images)
    np.random.default_rng(options.seed).shuffle(paths)
    cache = options.cache or options.out.with_name(options.out.stem + "-labels")
    photographs = load_samples(paths[: options.limit], options.views, cache)
    if not photographs:
        raise InputError(f"none of the images in {options.images} can be read: give photographs of 64 px and more")
    held_out = render_samples(min(HELD_OUT_SCENES, options.scenes), HELD_OUT_SEED)
    return photographs, render_samples(options.scenes), held_out


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
