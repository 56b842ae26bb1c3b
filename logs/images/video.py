"""H.264, H.265, VP9 and AV1 streams through FFmpeg (PyAV)."""

from __future__ import annotations

from bisect import insort
from collections.abc import Container, Iterable
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple, cast

import av
import numpy as np
from av.codec.context import Flags
from av.video.codeccontext import VideoCodecContext
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from frontend.sources.reading import UndecodableError
from logs.images.numbering import FrameNumbers
from logs.messages.types import (
    VideoPacket,
    ends_the_past,
    has_lengths,
    has_only_parameters,
    has_picture,
    is_b_picture,
    is_key_frame,
    is_leading,
)

_CODECS = {"h264": ("h264",), "h265": ("hevc",), "vp9": ("vp9",), "av1": ("libdav1d", "libaom-av1")}
# The largest picture of the highest level of H.264 and H.265 (6.2); FFmpeg refuses more before it allocates.
_MOST_PIXELS = 139_264 * 256
_MOST_PARAMETERS = 1 << 16  # bytes
_LONGEST_DELAY = 32  # packets; H.264 and H.265 allow 16


class Shown(NamedTuple):
    """A picture, (H, W, 3) BGR, with the number, stamp and log time (ns) of its place in the order of display."""

    number: int
    stamp_ns: int
    log_ns: int
    image: NDArray[np.uint8]


def in_order(packets: Iterable[VideoPacket]) -> bool:
    """Whether the pictures of packets, which begin with a key frame, are shown in the order in which they come."""
    codec: VideoCodecContext | None = None
    shown: list[int] = []
    for number, packet in enumerate(packets):
        if codec is None:
            codec = _codec(packet.format)
        unit = av.Packet(bytes(packet.data))
        unit.pts = number
        with suppress(av.error.FFmpegError):
            shown += [frame.pts or 0 for frame in codec.decode(unit)]
    if codec is not None:
        with suppress(av.error.FFmpegError):
            shown += [frame.pts or 0 for frame in codec.decode(None)]
    return shown == sorted(shown)


class VideoDecoder:
    """Decodes the packets of one stream in their order, and gives the pictures out in the order of display.

    FFmpeg decides on that order and holds back no more pictures than the stream says it needs; if it does not say, as
    many as it may need. Nothing is decoded before a key frame, and after damage nothing up to the next one: every
    picture until then would be predicted from a wrong one. FFmpeg notices cut and nearly all damaged H.264 pictures and
    missing H.265 ones, but few damaged H.265 ones, and of VP9 and AV1 what makes no sense. `FrameNumbers` notices
    missing H.264 ones, and those out of order.

    Attributes:
        reorders: whether stamps that rise in file order were given to pictures in another order, see `feed`.
    """

    def __init__(self) -> None:
        self.reorders = False
        self._format = ""
        self._codec: VideoCodecContext | None = None
        self._reformatter = VideoReformatter()
        self._waits = True  # for a key frame
        self._recovers = False  # began between key frames: pictures are not whole yet
        self._has_b = False  # pictures are known to be out of order
        self._leads = False  # no picture of before the key frame is there
        self._fed = self._began = 0  # packets so far, and which of them recovery began with
        self._numbers = FrameNumbers()
        self._parameters = b""  # sets that came in packets of their own
        self._inside = _Inside()
        self._held: list[tuple[int, Shown]] = []  # pictures behind one that has not come, and may be damaged
        self._ready: list[Shown] = []

    def feed(self, packet: VideoPacket, number: int = 0, log_ns: int = 0) -> list[Shown]:
        """Decode one packet, which holds one picture, with its number and log time.

        Returns:
            The pictures that are complete now, of this packet or earlier ones, or none. Their numbers and log times
            rise. So do stamps that do in file order: they say when packets were made, and the earliest goes to the
            picture that is shown first. Other stamps stay with their pictures (presentation stamps).

        Raises:
            UndecodableError: no picture comes of this packet; the next may be fed all the same.
        """
        if packet.format != self._format:
            self._open(packet.format)
        if not packet.data:  # would mean the end of the stream
            raise UndecodableError("damaged video frame", "it is empty")
        if has_lengths(packet):
            raise UndecodableError(
                "video with lengths in place of start codes (AVCC) is not readable",
                "FFmpeg's h264_mp4toannexb mends it",
            )
        if has_only_parameters(packet):  # they belong to the next picture
            self._parameters += bytes(packet.data[: _MOST_PARAMETERS - len(self._parameters)])
            return []
        if self._parameters:
            packet, self._parameters = replace(packet, data=self._parameters + bytes(packet.data)), b""
        if self._numbers.misses(packet):
            self._drain()
        if is_key_frame(packet):
            whole = ends_the_past(packet)
            if whole:
                self._drain()
            self._leads = self._waits
            if self._waits and not whole and packet.format == "h264":
                self._recovers, self._began = True, self._fed + 1
            self._waits = False
        elif self._waits or (self._leads and is_leading(packet)):
            raise UndecodableError("waits for a key frame")
        self._fed += 1
        self._has_b |= self.reorders or is_b_picture(packet)
        if has_picture(packet):
            self._inside.add(self._fed, _Place(number, packet.stamp_ns, log_ns))
        try:
            frames = self._decode(packet)
        except av.error.FFmpegError as error:
            if self._recovers and is_b_picture(packet):  # shown before the picture that decoding began with
                self._inside.drop(self._fed)
                raise UndecodableError("waits for a key frame") from error
            self._drain(damaged=self._fed)
            raise UndecodableError("damaged video frame", error.strerror or "") from error
        damaged = self._take(frames)
        if damaged is not None:  # what is inside may have been predicted from it
            self._start_afresh(damaged)
            raise UndecodableError("damaged video frame", "its picture is not whole")
        if frames and self._recovers:
            raise UndecodableError("waits for a key frame")
        return self._taken()

    def flush(self) -> list[Shown]:
        """The pictures that are still inside; afterwards a new stream may begin."""
        self._drain()
        return self._taken()

    def _taken(self) -> list[Shown]:
        """The pictures that were complete before a packet failed."""
        ready, self._ready = self._ready, []
        return ready

    def _open(self, name: str) -> None:
        context = _codec(name)
        self._drain()
        context.flags |= Flags.output_corrupt  # one picture for each packet, marked where it is not whole
        # Damage is to be an error at once, before a picture is predicted from it. `strict`: a stream that does not say
        # how far its pictures are out of order may do as its level allows.
        context.options = {**context.options, "err_detect": "explode", "strict": "1"}
        self._codec, self._format = context, name

    def _decode(self, packet: VideoPacket) -> list[VideoFrame]:
        assert self._codec is not None
        # FFmpeg reads beyond the end of its input: it has to be in a buffer of its own with room behind the data.
        unit = av.Packet(len(packet.data))
        unit.update(bytes(packet.data))
        unit.pts = self._fed
        return self._codec.decode(unit)

    def _take(self, frames: list[VideoFrame]) -> int | None:
        """Take the whole pictures; returns the packet of the first that is not."""
        for frame in frames:
            count = frame.pts
            if count is None or count not in self._inside:
                continue
            if count != self._began and self._began in self._inside:  # shown before what decoding began with
                self._inside.drop(count)
            elif not frame.is_corrupt:
                self._recovers = False
                place, moved = self._inside.take(count)
                self.reorders |= moved
                bgr = self._reformatter.reformat(frame, format="bgr24").to_ndarray()
                self._held.append((count, Shown(*place, np.require(bgr, np.uint8, ("C", "W")))))
            elif self._recovers:
                self._inside.drop(count)
            else:
                return count
        self._release(self._inside.first)
        return None

    def _release(self, before: int | None) -> None:
        """Let go the pictures that were decoded before a packet, all of them for None; others stay held."""
        self._ready += [shown for count, shown in self._held if before is None or count < before]
        self._held = [] if before is None else [held for held in self._held if held[0] > before]

    def _drain(self, damaged: int | None = None) -> None:
        """Keep the whole pictures that are inside, but for those decoded from a damaged packet on, and start afresh."""
        if self._codec is None:
            return
        frames: list[VideoFrame] = []
        with suppress(av.error.FFmpegError):
            frames = self._codec.decode(None)
        corrupt = [frame.pts for frame in frames if frame.is_corrupt and frame.pts is not None and not self._recovers]
        worst = min(corrupt if damaged is None else [damaged, *corrupt], default=self._fed + 1)
        if damaged is not None:
            # FFmpeg has lost the picture whose turn it was. Whose turn comes when is not known where a damaged picture
            # may have been between them and times rise in file order.
            frames = [] if self._inside.rising and self._has_b else frames
            for count in self._inside.without({damaged, *(frame.pts for frame in frames)}):
                self._inside.take(count)
        with suppress(av.error.FFmpegError):
            self._take([frame for frame in frames if frame.pts is not None and frame.pts < worst])
        self._start_afresh(worst)

    def _start_afresh(self, damaged: int) -> None:
        self._release(damaged)
        self._held, self._inside = [], _Inside()
        self._waits, self._recovers = True, False
        if self._codec is not None:
            self._codec.flush_buffers()


def _codec(name: str) -> VideoCodecContext:
    codec = next((codec for codec in _CODECS.get(name, ()) if codec in av.codecs_available), None)
    if codec is None:
        raise UndecodableError("video format is not readable", repr(name[:40]))
    context = cast(VideoCodecContext, av.CodecContext.create(codec, "r"))
    context.thread_count = 1  # with more, the H.264 decoder does not notice what is missing
    context.options = {"max_pixels": str(_MOST_PIXELS)}
    return context


class _Place(NamedTuple):
    number: int
    stamp_ns: int
    log_ns: int


class _Inside:
    """The packets whose pictures have not come out yet, by their count, and the places that are left."""

    def __init__(self) -> None:
        self._packets: dict[int, _Place] = {}
        self._left: tuple[list[int], list[int], list[int]] = [], [], []  # numbers, stamps and log times, in order
        self._highest_ns: int | None = None
        self.rising = True

    def __contains__(self, count: int) -> bool:
        return count in self._packets

    @property
    def first(self) -> int | None:
        return min(self._packets, default=None)

    def add(self, count: int, place: _Place) -> None:
        if self._highest_ns is not None and place.stamp_ns < self._highest_ns:
            self.rising = False
        self._highest_ns = place.stamp_ns
        self._packets[count] = place
        for values, value in zip(self._left, place, strict=True):
            insort(values, value)
        if count - _LONGEST_DELAY in self._packets:  # no picture came of it
            self.drop(count - _LONGEST_DELAY)

    def without(self, counts: Container[int | None]) -> list[int]:
        return [count for count in self._packets if count not in counts]

    def drop(self, count: int) -> None:
        """No picture comes of a packet."""
        for values, value in zip(self._left, self._packets.pop(count), strict=True):
            with suppress(ValueError):  # another picture has it
                values.remove(value)

    def take(self, count: int) -> tuple[_Place, bool]:
        """The place of the picture that comes next, a packet's; and whether that has got another's stamp."""
        own = self._packets.pop(count)
        numbers, stamps, logs = self._left
        stamp_ns = stamps[0] if self.rising else own.stamp_ns
        with suppress(ValueError):
            stamps.remove(stamp_ns)
        return _Place(numbers.pop(0), stamp_ns, logs.pop(0)), stamp_ns != own.stamp_ns
