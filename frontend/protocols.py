"""What the pipeline needs of a source of frames and of a sink of results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

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
        right: as `trace`, of the frame's right image; None without one.
    """

    frame: Frame
    trace: Trace
    tracks: LineTracks
    stage_ms: Mapping[str, float]
    latency_ms: float = 0.0
    read_ns: int = 0
    right: Trace | None = None


class Source:
    """A stream of frames. A subclass needs a `name` and `__iter__`, and says what else differs from the defaults.

    It is iterated once, perhaps in another thread, and yields frames in time order.

    Attributes:
        name: short, for progress bars and file names.
        frame_count: how many frames iteration yields at most; None where nobody knows.
        live: whether frames come whether or not somebody takes them.
        skipped: frames so far that could not be read.
        dropped: frames so far for which there was no time.
        reconnects: how often the stream was lost and came back.
        unpaired: of a stereo source, frames so far of the left and of the right camera without one of the other.
        kind: for people, what the input was taken for.
        codec: for people, how its pictures are stored; empty where nobody knows.
        orientation: for people, how its pictures were turned upright, if they were.
        notes: for people, a sentence on each thing that was guessed or done to the input; more may come on the way.
        calibration: for people, the file that its frames' camera is from, as far as that is known; None for another.
        first_stamp_ns: stamp of the first frame, from which `seek` counts; None for a source that cannot seek.
        last_stamp_ns: stamp of the last frame, as far as it is known without reading all of them.
    """

    # read-only for those who use a source; who writes one may have properties or attributes of these names
    if TYPE_CHECKING:

        @property
        def name(self) -> str: ...
        @property
        def frame_count(self) -> int | None: ...
        @property
        def live(self) -> bool: ...
        @property
        def skipped(self) -> int: ...
        @property
        def dropped(self) -> int: ...
        @property
        def reconnects(self) -> int: ...
        @property
        def unpaired(self) -> tuple[int, int]: ...
        @property
        def kind(self) -> str: ...
        @property
        def codec(self) -> str: ...
        @property
        def orientation(self) -> str: ...
        @property
        def notes(self) -> Sequence[str]: ...
        @property
        def calibration(self) -> str | None: ...
        @property
        def first_stamp_ns(self) -> int | None: ...
        @property
        def last_stamp_ns(self) -> int | None: ...

    else:
        name, kind, codec, orientation = "source", "frames", "", "as stored"
        live = False
        skipped = dropped = reconnects = 0
        unpaired = (0, 0)
        frame_count = first_stamp_ns = last_stamp_ns = calibration = None
        notes = ()

    def __iter__(self) -> Iterator[Frame]:
        raise NotImplementedError

    def seek(self, start_s: float) -> None:
        """Begin iteration with the first frame at or after start_s seconds since the first; not all sources can."""

    def stop(self) -> None:
        """End an iteration that may be waiting for a frame in another thread."""

    def close(self) -> None:
        """Release files and devices; safe to call twice."""


class Sink(Protocol):
    """Where results go."""

    def write(self, result: FrameResult) -> None:
        """Take one frame's result."""
        ...

    def close(self) -> None:
        """Finish what was written; safe to call twice."""
        ...
