"""Frames of a video: a file, a recording behind a URL, or what comes through a pipe."""

from __future__ import annotations

import heapq
import logging
import os
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, NamedTuple

import av
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter

from airline.errors import InputError
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources import address, kinds
from frontend.sources.container import MOST_PIXELS, counted, describe, open_container, video_stream
from frontend.sources.motion_jpeg import JPEG
from frontend.sources.orientation import in_words, upright
from frontend.sources.pipe import Pipe
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
        text = kinds.local_name(path)
        self._title = kinds.title_of(text)
        self._autorotate = autorotate
        self._lock, self._closed = threading.Lock(), False
        self._reformatter = VideoReformatter()
        self._pipe: Pipe | None = None
        self._is_url, self._unsized = kinds.is_url(text), False
        self._resources = ExitStack()
        self.notes = []
        try:
            self._open = self._opener(text)
            self._skips = Skips(self.name)
            self._container = self._open()
            self._stream = video_stream(self._container, self._title)
            self._describe(text, fps)
            self._start_ns = 0
            self._shows_damage = self._joined = False
            self._begin()
            first = self._read()
            if first is None and self._damaged and self._pipe is None:
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
        self._origin = first.key if self._said.fps else None
        self._number = self._position - 1  # of the first picture
        exif = self._orientation(first.frame)
        self.orientation = in_words(exif, autorotate=autorotate)
        if autorotate and exif != 1:
            self.notes.append(f"pictures are {self.orientation}, as the file says; --no-autorotate leaves them")

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
            seeks = self._start_ns > 0 and self._pipe is None and not self._joined
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
        if self._pipe is not None:
            self._pipe.stopped.set()

    def close(self) -> None:
        self.stop()
        with self._lock:  # FFmpeg does not survive being closed while it reads
            self._closed = True
            self._resources.close()

    def _opener(self, text: str) -> Callable[[], InputContainer]:
        """How the input is opened, once and for all; also names it."""
        if self._is_url:
            shown = kinds.without_password(text).split("?")[0].split("://")[-1]
            self.name = re.sub(r"[^\w.]+", "-", shown).strip("-.") or "video"
            self.kind = "recording at a URL"
            self._check(text, address.start_of(text), "from a URL")
            self._unsized = address.length_of(text) == 0
            if self._unsized:
                self.notes.append("the server does not say how long the file is: its name says that it is a recording")
            return lambda: self._opened(text, "url")
        kind, self.name = kinds.kind_of(text), Path(text).stem
        if kind == "pipe":
            self.kind = "video stream from stdin" if text == kinds.STDIN else "video stream from a pipe"
            self._pipe = pipe = Pipe(text)
            self._resources.callback(pipe.close)
            self._check(text, pipe.start, "through a pipe")
            return lambda: self._opened(pipe, "pipe")
        if kind == "folder":
            raise InputError(f"{self._title} is a folder, not a video file")
        if kind in ("missing", "camera"):
            raise InputError(f"there is no video file {self._title}")
        if kind == "device":
            raise InputError(f"{self._title} is a device, no video file: name one, or send a video through a pipe")
        self.kind = "video file"
        self._check(text, kinds.start_of(text), "")
        # Absolute, so that FFmpeg takes no part of the name for a protocol.
        name = str(Path(text).absolute())
        try:
            name.encode()
        except UnicodeEncodeError:
            raise InputError(f"the file name {name!a} is not UTF-8: rename the file") from None
        return lambda: self._opened(name, "file")

    def _check(self, text: str, start: bytes, way: str) -> None:
        """Refuse by its first bytes what FFmpeg would take for something else, or could not name."""
        self._start = start
        kind = kinds.kind_of_content(start, Path(text).suffix.lower())
        if kind == "packed":
            raise kinds.packed_error(text, start)
        if kind in ("log", "image"):
            what = "a log" if kind == "log" else "an image, no video"
            how = "logs.open_images" if kind == "log" else "frontend.open_source"
            advice = f"only videos come {way}: save it as a file, and name that" if way else f"open it with {how}"
            raise InputError(f"{self._title} is {what}: {advice}")
        if not start and not self._is_url:
            raise InputError(f"{self._title} is empty, or cannot be read: give a video file")

    def _opened(self, place: Any, way: str) -> InputContainer:
        try:
            made = open_container(place, way, "mjpeg" if self._start.startswith(JPEG) else None)
        except (av.FFmpegError, OSError, ValueError) as error:
            self._raise_interrupt()
            if self._is_url:
                raise InputError(f"cannot open {self._title} ({_reason(error)}): is the address right?") from None
            if self._unpipeable():
                raise InputError(self._unpipeable()) from None
            what = "text" if kinds.is_text(self._start) else "empty, cut short or of an unknown format"
            raise InputError(f"{self._title} is no video that can be read: it is {what}") from None
        self._resources.callback(made.close)
        return made

    def _describe(self, text: str, fps: float) -> None:
        """Set what the container says of the video."""
        self._said = said = describe(self._container, self._stream, Path(text).suffix[1:].lower())
        self.kind, self.codec = f"{self.kind} ({said.format})", said.codec
        self._unit_ns = said.unit.numerator * 10**9, said.unit.denominator
        self._fps = said.fps or fps
        if not said.fps:
            self.notes.append(f"the video holds no times: {fps:g} frames/s are assumed; --fps gives another rate")

    def _count(self) -> None:
        """Set how many frames there are and when the last is, behind the first."""
        count = last_ns = None
        if self._pipe is None and self._said.indexed:
            count, last_ns = self._said.end(float((self._first.key or 0) * self._said.unit))
        elif self._pipe is None and not self._is_url and self._first.key is not None:
            count, last_ns, self._joined = counted(self._open(), self._title, self._said, self._first.key)
        self._stated = count or 0
        self.frame_count, self.last_stamp_ns = count, last_ns

    def _reopen(self) -> None:
        self._container.close()
        self._container = self._open()
        self._stream = video_stream(self._container, self._title)
        self._begin()

    def _begin(self) -> None:
        """Read a container from its begin."""
        self._position = self._stated = 0  # frames passed, damaged ones included
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
                self._error = _reason(error)
                self._damaged += 1
                if failed == _MAX_FAILED_READS:
                    return
                packets = self._container.demux(self._stream)
                continue
            except (av.FFmpegError, OSError) as error:
                broken = _reason(error)
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
                self._error = _reason(error)
                self._damaged += 1
                frames = []
            for frame in frames:
                if frame.is_corrupt and not self._shows_damage:
                    self._error = "its pictures are not whole"
                    self._damaged += 1
                else:
                    yield frame
            if packet is None:
                self._raise_interrupt()
                whole = self._position >= self._stated if self._stated else self._unsized
                if broken and not whole:
                    raise InputError(f"cannot read more of {self._title}: {broken}")
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

    def _unpipeable(self) -> str:
        if self._pipe is None or self._pipe.start[4:8] != b"ftyp":
            return ""
        return f"{self._title} sends an MP4 whose index is at its end: name the file, or send Matroska or MPEG-TS"

    def _nothing(self) -> str:
        if reason := self._unpipeable():
            return reason
        codec = self._stream.codec_context
        if codec.width * codec.height > MOST_PIXELS:
            return f"{self._title} holds pictures of {codec.width}x{codec.height}, more than {MOST_PIXELS} pixels"
        why = f" ({self._error})" if self._error else ""
        return f"{self._title} holds {self.codec} video, but no readable video frame{why}: give a video file"

    def _raise_interrupt(self) -> None:
        if self._pipe is not None and self._pipe.interrupt is not None:
            raise self._pipe.interrupt


def _reason(error: Exception) -> str:
    """Why, without the address, which may carry a password."""
    return str(getattr(error, "strerror", "") or type(error).__name__)
