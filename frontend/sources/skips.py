"""Counts what a source could not read, and says so once."""

from __future__ import annotations

import logging


class Skips:
    """Frames that could not be read: how many, and what was wrong with the first."""

    def __init__(self, source: str) -> None:
        self.count = 0
        self.first = ""
        self._source = source
        self._reported = 0

    def add(self, what: str, count: int = 1) -> None:
        """Count frames; `what` names the first of them or says what is wrong with it."""
        self.first = self.first or what
        self.count += count

    def report(self, log: logging.Logger) -> None:
        """Log one warning if frames were skipped since the last report."""
        if self.count > self._reported:
            frames = "1 frame" if self.count == 1 else f"{self.count} frames"
            log.warning("%s: skipped %s that could not be read; first: %s", self._source, frames, self.first)
            self._reported = self.count
