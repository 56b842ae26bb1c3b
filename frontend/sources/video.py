"""Frames of a video: a file, a recording behind a URL, or what comes through a pipe."""

from __future__ import annotations

import heapq
import logging
import os
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, NamedTuple

import av
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter

from airline.errors import InputError
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources import kinds
from frontend.sources.container import MOST_PIXELS, VideoInput, reason_of, video_stream
from frontend.sources.described import counted, describe, last_stamp
from frontend.sources.orientation import Turns, upright
from frontend.sources.pixels import image_of, orientation_of
from frontend.sources.reading import Skips, UndecodableError
from frontend.sources.stills import read_header

log = logging.getLogger(__name__)

_DEFAULT_FPS = 30.0
_MAX_FAILED_READS = 100  # in a row, of the container


class _Picture(NamedTuple):
    key: int | None  # its time in the stream's unit
    frame: VideoFrame


class VideoSource(Source):
    """Frames of a video, by FFmpeg.

    `Frame.stamp_ns` counts from the first readable frame and follows the container's times; where it has none, its
    frame rate. A damaged frame is skipped and keeps its number; a cut file yields what is readable. Pictures that an
    edit list hides are no frames. Grey video of 8 and 16 bits stays so, all other becomes BGR of 8 bits.

    Args:
        path: a file, the URL of a recording, a named pipe, or "-" for the standard input.
        autorotate: turn the pictures upright as the container says.
        fps: frames per second of raw streams that hold neither times nor a rate.

    Raises:
        InputError: it is missing, no video, of a codec that cannot be decoded, or has no readable frame; while
            iterating, when the rest cannot be read.
    """

    name: str
    kind: str
    codec: str
    orientation: str
    frame_count: int | None
    first_stamp_ns = 0
    last_stamp_ns: int | None
    notes: list[str]

    def __init__(self, path: str | os.PathLike[str], *, autorotate: bool = True, fps: float = _DEFAULT_FPS) -> None:
        self._autorotate = autorotate
        self._lock, self._closed = threading.Lock(), False
        self._reformatter = VideoReformatter()
        self._start_ns = self._stated = 0
        self._input = VideoInput(kinds.local_name(path))
        self.name, self.notes = self._input.name, []
        self._skips = Skips(self.name)
        try:
            self._container = self._input.open()
            self._stream = video_stream(self._container, self._input.title)
            self._describe(fps)
            self._shows_damage = self._joined = False
            self._begin()
            first = self._read()
            if first is None and self._damaged and self._input.pipe is None:
                self._shows_damage = True  # better than nothing
                self._reopen()
                first = self._read()
            if first is None:
                raise InputError(self._nothing())
            self._first = first
            self._count()
        except BaseException:
            self.close()
            raise
        self._origin = first.key if self._said.timed else None
        self._number = self._position - 1  # of the first picture
        turns = Turns(self.notes, autorotate)
        turns.add(self._orientation(first.frame))
        self.orientation = turns.words

    @property
    def skipped(self) -> int:
        return self._skips.count

    def seek(self, start_s: float) -> None:
        """See `Source`. Behind it `Frame.index` is the time multiplied by the frame rate: exact for a constant rate."""
        self._start_ns = round(start_s * 1e9)
        if self._start_ns > 0:
            self.frame_count = None

    def __iter__(self) -> Iterator[Frame]:
        try:
            seeks = self._start_ns > 0 and self._input.pipe is None and not self._joined
            found = self._read_near(self._start_ns) if seeks else self._first
            while found is not None:
                index, stamp_ns = self._place(found)
                if stamp_ns >= self._start_ns:
                    image = image_of(found.frame, self._reformatter)
                    if self._autorotate:
                        image = upright(image, self._orientation(found.frame))
                    yield Frame(index, stamp_ns, image)
                found = self._read()
            self._count_lost_tail()
        finally:
            self._skips.report(log)

    def stop(self) -> None:
        if self._input.pipe is not None:
            self._input.pipe.stopped.set()

    def close(self) -> None:
        self.stop()
        with self._lock:  # FFmpeg does not survive being closed while it reads
            self._closed = True
            self._input.close()

    def _describe(self, fps: float) -> None:
        """Set what the container says of the video."""
        self._said = said = describe(self._container, self._stream, self._input.suffix[1:])
        self.kind, self.codec = f"{self._input.kind} ({said.format})", said.codec
        self._unit_ns = said.unit.numerator * 10**9, said.unit.denominator
        self._fps = said.fps or fps
        if not said.timed and not said.fps:
            self.notes.append(f"the video holds no times: {fps:g} frames/s are assumed; --fps gives another rate")
        if self._input.unsized:
            self.notes.append("the server does not say how long the file is: its name says that it is a recording")

    def _count(self) -> None:
        """Set how many frames there are and when the last is, behind the first."""
        count = last_ns = None
        if self._input.pipe is None and self._said.indexed:
            count, last_ns = self._said.end(float((self._first.key or 0) * self._said.unit))
            if last_ns is not None and self._input.way == "file" and self._first.key is not None and self._said.timed:
                last_ns = last_stamp(self._input.open(), self._stream.index, self._said, self._first.key)
        elif self._input.way == "file" and self._first.key is not None:
            count, last_ns, self._joined = counted(self._input.open(), self._stream.index, self._said, self._first.key)
        self._stated = count or 0
        self.frame_count, self.last_stamp_ns = count, last_ns

    def _reopen(self) -> None:
        self._container.close()
        self._container = self._input.open()
        self._stream = video_stream(self._container, self._input.title)
        self._begin()

    def _begin(self) -> None:
        """Read a container from its begin."""
        self._position = 0  # frames passed, damaged ones included
        self._jpeg_orientation = 1
        self._last: tuple[int, int] | None = None  # index and stamp of the latest frame
        self._restart()

    def _restart(self) -> None:
        self._waiting: list[int] = []  # times of the packets whose pictures have not come, a heap
        self._newest: int | None = None
        self._clock: int | None = None  # of the latest packet
        self._shift = 0  # of the times behind where it stepped back
        self._damaged = 0  # packets whose pictures will not come
        self._error = ""
        self._pictures = self._decoded()

    def _decoded(self) -> Iterator[VideoFrame]:
        """The pictures that are whole."""
        failed = 0
        packets = self._container.demux(self._stream)
        broken = ""
        while True:
            packet: Any = None
            try:
                with self._lock:
                    if self._closed:
                        return
                    packet = next(packets, None)
                failed = 0
            except av.error.InvalidDataError as error:
                failed += 1
                self._error = reason_of(error)
                self._damaged += 1
                if failed == _MAX_FAILED_READS:
                    return
                packets = self._container.demux(self._stream)
                continue
            except (av.FFmpegError, OSError) as error:
                broken = reason_of(error)
            if packet is not None and not packet.size:  # which a decoder would take for the end
                continue
            if packet is not None:
                self._continue(packet)
            if packet is not None and not packet.is_discard:
                self._damaged += packet.is_corrupt
                key = packet.dts if packet.pts is None or self._said.coded_order else packet.pts
                if key is None and self._newest is not None:  # damage has taken its time
                    key = self._newest + 1
                if key is not None:
                    heapq.heappush(self._waiting, key)
                self._newest = key
                if self._stream.codec_context.name == "mjpeg":
                    with suppress(UndecodableError):
                        self._jpeg_orientation = read_header(bytes(packet)).exif
            try:
                frames = self._stream.codec_context.decode(packet)
            except av.error.EOFError:
                return
            except av.FFmpegError as error:
                self._error = reason_of(error)
                self._damaged += 1
                frames = []
            for frame in frames:
                if frame.is_corrupt and not self._shows_damage:
                    self._error = "its pictures are not whole"
                    self._damaged += 1
                else:
                    yield frame
            if packet is None:
                self._input.raise_interrupt()
                whole = self._position >= self._stated if self._stated else self._input.unsized
                if broken and not whole:
                    raise InputError(f"cannot read more of {self._input.title}: {broken}")
                return

    def _read(self) -> _Picture | None:
        """The next whole picture; what was damaged before it is counted."""
        frame = next(self._pictures, None)
        if frame is None:
            return None
        key: int | None = frame.dts if frame.pts is None or self._said.coded_order else frame.pts
        passed = 0
        while key is not None and self._waiting and self._waiting[0] <= key:
            passed += heapq.heappop(self._waiting) < key
        if passed and not (self._position or self._damaged or self._said.coded_order):
            note = f"the video begins between key frames: its first {passed} pictures cannot be decoded"
            self.notes += [note] if note not in self.notes else []
        # without damage these were no frames: the other halves of interlaced ones, or pictures to predict from
        self._skip(self._damaged if key is None else passed if self._damaged else 0)
        self._position += 1
        return _Picture(key, frame)

    def _continue(self, packet: Any) -> None:
        """Move a packet's times to where they would be if the stream's clock had not stepped back before."""
        if packet.dts is None:
            return
        dts = packet.dts + self._shift
        if self._clock is not None and (seconds := self._said.step_back(self._clock, dts)):
            step = self._clock - dts + max(round(1 / (self._fps * self._said.unit)), 1)
            self._shift, dts = self._shift + step, dts + step
            self.notes.append(
                f"times step back by {seconds:.3g} s, as where videos are joined: they are taken to go on"
            )
        packet.dts = self._clock = dts
        if packet.pts is not None:
            packet.pts += self._shift

    def _skip(self, lost: int) -> None:
        if lost:
            self._skips.add(f"frame {self._position}", lost)
            self._damaged = max(self._damaged - lost, 0)
            self._position += lost

    def _place(self, found: _Picture) -> tuple[int, int]:
        """Number and stamp of a picture; a time that does not advance is replaced by the frame rate's."""
        index = self._position - 1
        stamp = self._elapsed_ns(found)
        if stamp is None:
            stamp = round((index - self._number) * 1e9 / self._fps)
        if self._last is not None and stamp <= self._last[1]:
            stamp = self._last[1] + round((index - self._last[0]) * 1e9 / self._fps)
        self._last = index, stamp
        return index, stamp

    def _elapsed_ns(self, found: _Picture) -> int | None:
        if found.key is None or self._origin is None:
            return None
        ns, unit = self._unit_ns
        return (2 * (found.key - self._origin) * ns + unit) // (2 * unit)

    def _orientation(self, frame: VideoFrame) -> int:
        return orientation_of(frame, self._jpeg_orientation)

    def _read_near(self, start_ns: int) -> _Picture | None:
        """A picture at or shortly before start_ns, in the last resort the first."""
        back_ns = 0
        ns, unit = self._unit_ns
        while self._origin is not None and (target_ns := start_ns - back_ns) > 0:
            try:
                self._container.seek(self._origin + target_ns * unit // ns, stream=self._stream)
            except (av.FFmpegError, OSError, OverflowError):
                break
            self._restart()
            found = self._read()
            if found is not None and 0 < (elapsed_ns := self._elapsed_ns(found) or 0) <= start_ns:
                self._position = round(elapsed_ns * self._fps / 1e9) + 1
                self._skips = Skips(self.name)  # what was damaged lies before
                return found
            back_ns = 2 * back_ns + 10**9
        self._reopen()
        return self._read()

    def _count_lost_tail(self) -> None:
        """Count the frames behind the last readable one, as far as their packets came or the container states them.

        With a slack, for some containers count the delay of B-frames, and only where time is missing too, for some
        state their duration times the highest frame rate.
        """
        if self._damaged:
            self._skip(len(self._waiting))
        stated = self._stated
        seconds = 0.0 if self._last is None else self._last[1] / 1e9
        lost = min(stated - self._position, round(stated - 1 - seconds * self._fps))
        if lost > (3 if self._stream.codec_context.has_b_frames else 1) + 0.02 * stated:
            self._skips.add(f"frame {self._position}, where the file ends", lost)

    def _nothing(self) -> str:
        if reason := self._input.unpipeable():
            return reason
        codec = self._stream.codec_context
        if codec.width * codec.height > MOST_PIXELS:
            return f"{self._input.title} holds pictures of {codec.width}x{codec.height}, more than {MOST_PIXELS} pixels"
        why = f" ({self._error})" if self._error else ""
        return f"{self._input.title} holds {self.codec} video, but no readable video frame{why}: give a video file"
