"""What all command lines share: errors in one sentence, log lines that get along with a progress bar."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from airline.errors import AirLineError

EXIT_USER_ERROR = 2


class Parser(argparse.ArgumentParser):
    """Prints errors as one sentence."""

    def error(self, message: str) -> NoReturn:
        """Print and exit with 2."""
        self.exit(EXIT_USER_ERROR, f"error: {message}; see --help\n")


class StderrHandler(logging.Handler):
    """Prints to what sys.stderr is at that time: a progress bar takes its place to keep such lines above itself."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print one record."""
        print(self.format(record), file=sys.stderr)


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
