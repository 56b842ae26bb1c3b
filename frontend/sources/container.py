"""Opening a video by FFmpeg, and what its container says of it."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from typing import Any, NamedTuple

import av
from av.container import InputContainer
from av.stream import Disposition
from av.video.stream import VideoStream

from airline.errors import InputError

MOST_PIXELS = 1 << 26
"""More are refused by FFmpeg before it allocates for them."""
_WRAP = 1 << 33  # behind which the clock of MPEG-TS and MPEG-PS begins anew
_TIMEOUT_S = 5.0
_RETRY = {"reconnect": "1", "reconnect_on_network_error": "1", "reconnect_delay_max": "5"}
_PROTOCOLS = {"file": "file,crypto,data", "url": "http,https,tcp,tls,httpproxy,crypto,data", "pipe": "pipe"}
_TEXT_CODECS = ("ansi", "bintext", "xbin", "idf")  # FFmpeg renders text as a video of scrolling terminal output
_COUNTED = 1 << 28  # bytes of a file without an index whose pictures are counted, in about a second


class Described(NamedTuple):
    """What a container says of its video.

    Attributes:
        format: for people.
        codec: for people, with the pixels' format where they have more than 8 bits.
        unit: of the times, s.
        fps: frames per second, 0 where the stream holds neither times nor a rate.
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


def open_container(place: Any, way: str, form: str | None) -> InputContainer:
    """Open a "file", "url" or "pipe", of a format by its name if not None; raises FFmpegError, OSError, ValueError."""
    limits = {"protocol_whitelist": _PROTOCOLS[way], "max_pixels": str(MOST_PIXELS)}
    more, timeout = (_RETRY, (_TIMEOUT_S, _TIMEOUT_S)) if way == "url" else ({}, None)
    made: InputContainer = av.open(
        place, "r", form, options={**limits, **more}, metadata_errors="replace", timeout=timeout
    )
    return made


def video_stream(container: InputContainer, title: str) -> VideoStream:
    """The first video that is no cover picture; raises InputError where there is none to decode."""
    streams, form = container.streams, container.format.name
    if any(stream.codec_context and stream.codec_context.name in _TEXT_CODECS for stream in streams.video):
        raise InputError(f"{title} holds text, no readable video frame: give a video file")
    if form.endswith("_pipe") or form in ("image2", "ico"):
        raise InputError(f"{title} is a single picture, no video: convert it to PNG")
    for stream in streams.video:
        if not stream.disposition & Disposition.attached_pic:
            if stream.codec_context is None:
                raise InputError(f"{title} holds video of a codec that this FFmpeg cannot decode: convert it")
            stream.thread_type = "AUTO"
            stream.codec_context.options = {"max_pixels": str(MOST_PIXELS)}
            return stream
    held = sorted({str(stream.type) for stream in streams})
    cover = " and a cover picture" if streams.video else ""
    what = " and ".join(kind for kind in held if kind != "video") or "nothing"
    raise InputError(f"{title} holds {what}{cover}, no readable video frame: give a video file")


def describe(container: InputContainer, stream: VideoStream, suffix: str) -> Described:
    """What the container says of a video stream; `suffix` is that of the input's name."""
    names = container.format.name.split(",")
    codec = stream.codec_context.codec.canonical_name
    pixels = stream.codec_context.format
    if pixels is not None and any(part.bits > 8 for part in pixels.components):
        codec += f" ({pixels.name})"
    unit = stream.time_base or Fraction(1, av.time_base)
    rate = stream.average_rate or stream.guessed_rate
    fps = float(rate) if rate and 0 < rate < 10_000 else 0.0
    no_times: Any = av.format.Flags.no_timestamps
    if container.format.flags & no_times.value and not stream.codec_context.framerate:
        fps = 0.0
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
        fps=fps,
        duration_s=duration_s,
        frames=stream.frames,
        from_zero=not {"matroska", "webm", "nut", "avi"}.isdisjoint(names),
        hides="mp4" in names,
        coded_order="avi" in names,
        indexed={"mpegts", "mpeg"}.isdisjoint(names),
    )


def counted(container: InputContainer, title: str, said: Described, origin: int) -> tuple[int | None, int | None, bool]:
    """What `Described.end` says, of a file without an index, and whether its clock steps back; it is read, and closed.

    Of large files nothing is known.
    """
    with container:
        if container.size > _COUNTED:
            return None, None, False
        packets = [packet for packet in container.demux(video_stream(container, title)) if packet.pts is not None]
    clock = [packet.dts for packet in packets if packet.dts is not None]
    times = [packet.pts for packet in packets if packet.pts is not None]
    times = times[times.index(origin) :] if origin in times else times
    if any(said.step_back(*pair) for pair in pairwise(clock)):
        return len(times), None, True
    return len(times) or None, round((max(times, default=origin) - origin) * said.unit * 10**9), False
