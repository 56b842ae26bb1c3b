"""Counts what a source could not read, and says so once."""

from __future__ import annotations

import logging
from collections import Counter

_NAMED = 5  # reasons in a warning


class Skips:
    """Frames that could not be read: how many, which was the first, and `reasons` with counts where some were given."""

    def __init__(self, source: str) -> None:
        self.count = 0
        self.first = ""
        self.reasons: Counter[str] = Counter()
        self._source = source
        self._reported = 0

    def add(self, what: str, count: int = 1, reason: str | None = None) -> None:
        """Count frames; `what` names the first of them or says what is wrong with it."""
        self.first = self.first or what
        self.count += count
        if reason is not None:
            self.reasons[reason] += count

    def report(self, log: logging.Logger) -> None:
        """Log one warning if frames were skipped since the last report."""
        if self.count > self._reported:
            frames = "1 frame" if self.count == 1 else f"{self.count} frames"
            log.warning(
                "%s: skipped %s that could not be read%s; first: %s", self._source, frames, self._why(), self.first
            )
            self._reported = self.count

    def _why(self) -> str:
        if len(self.reasons) < 2:  # the first one says it
            return ""
        named = [f"{count} x {reason}" for reason, count in self.reasons.most_common(_NAMED)]
        return f" ({', '.join(named)}{', ...' if len(self.reasons) > _NAMED else ''})"
