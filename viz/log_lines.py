"""Warnings of our packages, as lines of the recording's log."""

from __future__ import annotations

import logging
from collections.abc import Callable

PACKAGES = ("airline", "frontend", "logs", "viz")
LEVELS = {logging.WARNING: "WARN", logging.ERROR: "ERROR", logging.CRITICAL: "CRITICAL"}


class LogLines(logging.Handler):
    """Hands every warning of our packages' loggers to `write`, from where it is raised until it is closed."""

    def __init__(self, write: Callable[[str, str], None]) -> None:
        super().__init__(logging.WARNING)
        self._write = write
        for package in PACKAGES:
            logging.getLogger(package).addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Pass a record on as its text and Rerun's name of its level."""
        if not logging.getLogger().handlers and logging.lastResort is not None:
            logging.lastResort.handle(record)  # Python's own way to stderr, which having a handler here would close
        self._write(record.getMessage(), LEVELS.get(record.levelno, "WARN"))

    def close(self) -> None:
        """Take no more; safe to call twice."""
        for package in PACKAGES:
            logging.getLogger(package).removeHandler(self)
        super().close()
