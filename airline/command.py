"""What all command lines share: errors in one sentence, log lines that get along with a progress bar."""

from __future__ import annotations

import argparse
import logging
import sys
from typing import NoReturn

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
