"""Streams of frames, joined by their times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from airline.errors import InputError

if TYPE_CHECKING:
    from frontend.tracks import LineTracks


@dataclass(frozen=True)
class Moment:
    """What one of the streams has at one time."""

    stamp_ns: int
    tracks: tuple[LineTracks, ...]
    image: bytes | None = None


def joined(streams: Sequence[Iterator[Moment]], names: tuple[str, str]) -> Iterator[tuple[Moment, ...]]:
    """The moments that all streams have; raises InputError where there is none, or times go back."""
    starts: list[Moment] = []
    found = False
    for moments in _common(streams, starts):
        found = True
        yield moments
    if found:
        return
    if len(starts) < len(streams):
        raise InputError("there is nothing to compare: one of the two has no frame")
    times = " and ".join(f"{moment.stamp_ns / 1e9:.3f} s" for moment in starts)
    raise InputError(
        f"{names[0]} and {names[1]} have no frame in common (they begin at {times}): give two runs on the same input"
    )


def _common(streams: Sequence[Iterator[Moment]], starts: list[Moment]) -> Iterator[tuple[Moment, ...]]:
    heads = [next(stream, None) for stream in streams]
    starts += [head for head in heads if head is not None]
    while True:
        present = [head for head in heads if head is not None]
        if len(present) < len(heads):
            return
        latest = max(head.stamp_ns for head in present)
        behind = [k for k, head in enumerate(present) if head.stamp_ns < latest]
        if not behind:
            yield tuple(present)
            behind = list(range(len(heads)))
        for k in behind:
            heads[k] = _after(streams[k], present[k])


def _after(stream: Iterator[Moment], moment: Moment) -> Moment | None:
    following = next(stream, None)
    if following is not None and following.stamp_ns <= moment.stamp_ns:
        raise InputError(
            f"the frame at {following.stamp_ns} ns comes behind one at {moment.stamp_ns} ns: "
            "frames must be in the order of their times"
        )
    return following
