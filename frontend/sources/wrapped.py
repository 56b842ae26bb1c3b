"""A source around another source."""

from __future__ import annotations

from frontend.protocols import Source, is_live, reconnects_of, stop


class WrappedSource:
    """Answers all that a `Source` is asked, but for its frames; who wraps one says those, and what else is different.

    Args:
        source: closing this closes it.
    """

    def __init__(self, source: Source) -> None:
        self._source = source

    @property
    def name(self) -> str:
        return self._source.name

    @property
    def frame_count(self) -> int | None:
        return self._source.frame_count

    @property
    def skipped(self) -> int:
        return self._source.skipped

    @property
    def live(self) -> bool:
        return is_live(self._source)

    @property
    def reconnects(self) -> int:
        return reconnects_of(self._source)

    def stop(self) -> None:
        """End the iteration, whose thread may be waiting for a frame."""
        stop(self._source)

    def close(self) -> None:
        """Stop, and close the source."""
        self.stop()
        self._source.close()
