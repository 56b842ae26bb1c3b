"""What a container says of its video."""

from __future__ import annotations

from contextlib import suppress
from fractions import Fraction
from itertools import pairwise
from typing import Any, NamedTuple

import av
from av.container import InputContainer
from av.video.stream import VideoStream

_WRAP = 1 << 33  # behind which the clock of MPEG-TS and MPEG-PS begins anew
_COUNTED = 1 << 28  # bytes of a file without an index whose pictures are counted, in about a second


class Described(NamedTuple):
    """What a container says of its video.

    Attributes:
        format: for people.
        codec: for people, with the pixels' format where they have more than 8 bits.
        unit: of the times, s.
        timed: whether it holds times.
        fps: frames per second, 0 where nobody says.
        duration_s: to the end of the last picture; from zero on, or from the first one.
        frames: as stated, 0 where it is not.
        from_zero: whether `duration_s` counts from zero.
        hides: whether `frames` may count pictures that are not shown.
        coded_order: whether times are in the order of the packets.
        indexed: whether there is an index or a header; else nothing of this is known to be right.
    """

    format: str
    codec: str
    unit: Fraction
    timed: bool
    fps: float
    duration_s: float | None
    frames: int
    from_zero: bool
    hides: bool
    coded_order: bool
    indexed: bool

    def end(self, origin_s: float) -> tuple[int | None, int | None]:
        """How many pictures there are at most, and the stamp of the last, ns, where the first is at origin_s."""
        if not self.indexed or self.duration_s is None:
            return self.frames or None, None
        seconds = self.duration_s - (origin_s if self.from_zero else 0)
        timed = round(seconds * self.fps)
        stated = self.frames - (round(origin_s * self.fps) if self.from_zero else 0)
        count = timed if stated <= 0 or (self.hides and timed < stated) else stated
        if not 0 < count < 1e9:
            return None, None
        return count, max(round((seconds - 1 / self.fps) * 1e9), 0)

    def step_back(self, before: int, after: int) -> float:
        """By how many seconds a clock steps back between packets, as where videos are joined; else 0.

        FFmpeg takes some such steps for a clock that begins anew, and so for one ahead.
        """
        back = before - after
        if not self.indexed and 2 * back < -_WRAP:
            back += _WRAP
        seconds = float(back * self.unit)
        return seconds if seconds > 4 / (self.fps or 30) else 0.0


def describe(container: InputContainer, stream: VideoStream, suffix: str) -> Described:
    """What the container says of a video stream; `suffix` is that of the input's name."""
    names = container.format.name.split(",")
    codec = stream.codec_context.codec.canonical_name
    pixels = stream.codec_context.format
    if pixels is not None and any(part.bits > 8 for part in pixels.components):
        codec += f" ({pixels.name})"
    unit = stream.time_base or Fraction(1, av.time_base)
    no_times: Any = av.format.Flags.no_timestamps
    timed = not container.format.flags & no_times.value
    # without times FFmpeg states a rate of 25 whatever the stream says
    rate = (stream.average_rate or stream.guessed_rate) if timed else stream.codec_context.framerate
    fps = float(rate) if rate and 0 < rate < 10_000 else 0.0
    duration_s = None
    if stream.duration:
        duration_s = float(stream.duration * unit)
    elif container.duration and container.duration > 0:
        duration_s = container.duration / av.time_base
        if "nut" in names and fps:  # which states where the last picture begins
            duration_s += 1 / fps
    return Described(
        format=suffix if suffix in names else "mp4" if "mp4" in names else names[0],
        codec=codec,
        unit=unit,
        timed=timed,
        fps=fps,
        duration_s=duration_s,
        frames=stream.frames,
        from_zero=not {"matroska", "webm", "nut", "avi"}.isdisjoint(names),
        hides="mp4" in names,
        coded_order="avi" in names,
        indexed={"mpegts", "mpeg"}.isdisjoint(names),
    )


def last_stamp(container: InputContainer, index: int, said: Described, origin: int) -> int | None:
    """Of a file with an index, ns behind `origin`, by its last packets: rates may vary; it is closed."""
    with container, suppress(av.FFmpegError):
        stream = container.streams[index]
        container.seek(1 << 62, stream=stream)
        times = [packet.pts for packet in container.demux(stream) if packet.pts is not None and not packet.is_discard]
        return round((max(times) - origin) * said.unit * 10**9) if times else None
    return None


def counted(container: InputContainer, index: int, said: Described, origin: int) -> tuple[int | None, int | None, bool]:
    """What `Described.end` says, of a file without an index, and whether its clock steps back; it is read, and closed.

    Of large files nothing is known. `index` is the stream's.
    """
    with container:
        if container.size > _COUNTED:
            return None, None, False
        packets = [packet for packet in container.demux(container.streams[index]) if packet.pts is not None]
    clock = [packet.dts for packet in packets if packet.dts is not None]
    times = [packet.pts for packet in packets if packet.pts is not None]
    times = times[times.index(origin) :] if origin in times else times
    if any(said.step_back(*pair) for pair in pairwise(clock)):
        return len(times), None, True
    return len(times) or None, round((max(times, default=origin) - origin) * said.unit * 10**9), False
