"""What the commands on annotated images share."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from airline.errors import InputError

if TYPE_CHECKING:
    from airline.evaluation.dataset import Sample


def add_dataset(parser: argparse.ArgumentParser) -> None:
    """Arguments for the data set, how much of it, and where the figures go."""
    parser.add_argument("dataset", type=Path, help="folder with images/, lines_denis/ (sparse), lines_cho/ (dense)")
    parser.add_argument("--limit", type=int, metavar="N", help="use only the first N images")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures as JSON")


def open_dataset(options: argparse.Namespace) -> list[Sample]:
    """The samples that the arguments of `add_dataset` name; also checks where the figures go.

    Raises:
        InputError: an argument, folder or file cannot be used.
    """
    from airline.evaluation.dataset import load_dataset

    if options.limit is not None and options.limit < 1:
        raise InputError("--limit must be at least 1")
    if options.json is not None and not options.json.parent.is_dir():
        raise InputError(f"no folder {options.json.parent}: create it, or give another --json file")
    return load_dataset(options.dataset, options.limit)


def track(samples: list[Sample]) -> Iterable[Sample]:
    """The samples, with a progress bar where a person looks on."""
    from rich.console import Console
    from rich.progress import track

    errors = Console(stderr=True)
    return track(samples, "images", console=errors, transient=True) if errors.is_terminal else samples
