"""What the pipeline needs of a source of frames and of a sink of results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from airline.trace import Trace
from frontend.frame import Frame
from frontend.tracks import LineTracks


@dataclass(frozen=True)
class FrameResult:
    """All that is known of one frame after detection and tracking.

    Attributes:
        frame: the input.
        trace: the detector's intermediate results and lines.
        tracks: the tracks seen in this frame.
        stage_ms: milliseconds per stage of the whole pipeline.
        latency_ms: milliseconds from when the frame had been read to when its tracks were known.
        read_ns: wall-clock time (`time.time_ns`) when the frame had been read, 0 where nobody noted it.
    """

    frame: Frame
    trace: Trace
    tracks: LineTracks
    stage_ms: Mapping[str, float]
    latency_ms: float = 0.0
    read_ns: int = 0


@runtime_checkable
class Source(Protocol):
    """A stream of frames. Iterating yields frames in time order; a source is iterated once, perhaps in another thread.

    A source whose frames come whether or not somebody takes them says so by an attribute `live = True`.
    """

    @property
    def name(self) -> str:
        """Short name, for progress bars and file names."""
        ...

    @property
    def frame_count(self) -> int | None:
        """How many frames iteration will yield at most, or None for an endless stream."""
        ...

    @property
    def skipped(self) -> int:
        """How many frames could not be read so far."""
        ...

    def __iter__(self) -> Iterator[Frame]: ...

    def close(self) -> None:
        """Release files and devices; safe to call twice."""
        ...


def is_live(source: Source) -> bool:
    """Whether the source's frames come whether or not somebody takes them."""
    return bool(getattr(source, "live", False))


def reconnects_of(source: Source) -> int:
    """How often the source, or the one it selects from, was lost and came back."""
    count = getattr(source, "reconnects", 0)
    return count if isinstance(count, int) else 0


def stop(source: Source) -> None:
    """Tell a source that may be waiting for a frame, in another thread, to end its iteration; few need to know how."""
    end = getattr(source, "stop", None)
    if end is not None:
        end()


@contextmanager
def stopping(source: Source) -> Iterator[None]:
    """Stop the source at the end of the block, before those are waited for who wait for its next frame."""
    try:
        yield
    finally:
        stop(source)


class Sink(Protocol):
    """Where results go."""

    def write(self, result: FrameResult) -> None:
        """Take one frame's result."""
        ...

    def close(self) -> None:
        """Finish what was written; safe to call twice."""
        ...
