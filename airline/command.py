"""What all command lines share: errors in one sentence, checked arguments, log lines beside a progress bar."""

from __future__ import annotations

import argparse
import json
import logging
import math
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from airline.errors import AirLineError

EXIT_USER_ERROR = 2
Item = TypeVar("Item")


class Parser(argparse.ArgumentParser):
    """Prints errors as one sentence."""

    def error(self, message: str) -> NoReturn:
        """Print and exit with 2."""
        self.exit(EXIT_USER_ERROR, f"error: {message}; see --help\n")

    def add_json(self) -> None:
        """The argument --json, a file in a folder that exists; see `write_json`."""
        self.add_argument("--json", type=_json_file, metavar="FILE", help="write the figures as JSON")


def _json_file(text: str) -> Path:
    path = Path(text)
    if not path.parent.is_dir():
        raise argparse.ArgumentTypeError(f"no folder {path.parent}: create it, or give another --json file")
    return path


def number(kind: type[int] | type[float], low: float, below: float = math.inf) -> Callable[[str], float]:
    """Reader of an argument that is a number of a kind, from `low` on and under `below`."""

    def read(text: str) -> float:
        value: float = kind(text)
        if not low <= value < below:
            upper = f" and below {below:g}" if math.isfinite(below) else ""
            raise argparse.ArgumentTypeError(f"{text} must be at least {low:g}{upper}")
        return value

    read.__name__ = kind.__name__  # argparse names it when the text is no number
    return read


def image_size(text: str) -> tuple[int, int]:
    """Reader of an argument WIDTHxHEIGHT, px."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and min(int(width), int(height)) >= 16):
        raise argparse.ArgumentTypeError(f"'{text}' is no size: give WIDTHxHEIGHT of 16 px and more, such as 640x480")
    return int(width), int(height)


class StderrHandler(logging.Handler):
    """Prints to what sys.stderr is at that time: a progress bar takes its place to keep such lines above itself."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print one record."""
        print(self.format(record), file=sys.stderr)


def track(items: Iterable[Item], title: str, total: int) -> Iterable[Item]:
    """The items, with a passing progress bar on stderr where a person looks on."""
    from rich.console import Console
    from rich.progress import track

    console = Console(stderr=True)
    return track(items, title, total, console=console, transient=True, disable=not console.is_terminal)


def print_errors(error: AirLineError) -> None:
    """Print an error, and before it those that it came on top of: when one output fails, others may, too."""
    before, cause = error.__context__, error.__cause__
    if isinstance(before, AirLineError) and before is not cause:
        print_errors(before)
    print(f"error: {error}", file=sys.stderr)


def exit_code(run: Callable[[argparse.Namespace], None], options: argparse.Namespace) -> int:
    """Run a command; 2 after printing an error that the user can mend, else 0."""
    try:
        run(options)
    except AirLineError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USER_ERROR
    return 0


def write_json(path: Path | None, figures: dict[str, Any]) -> None:
    """Write the figures, where that was asked for."""
    if path is not None:
        path.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
