"""Frames of a video: a file, a recording behind a URL, or what comes through a pipe."""

from __future__ import annotations

import heapq
import logging
import os
import re
import select
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np
from av.container import InputContainer
from av.stream import Disposition
from av.video.frame import VideoFrame
from av.video.reformatter import Interpolation, VideoReformatter
from av.video.stream import VideoStream

from airline.errors import InputError
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources import kinds
from frontend.sources.orientation import in_words, upright
from frontend.sources.reading import Image, Skips

log = logging.getLogger(__name__)

MOST_PIXELS = 1 << 26
"""More are refused by FFmpeg before it allocates for them."""
_DEFAULT_FPS = 30.0
_MAX_FAILED_READS = 100  # in a row, of the container
_TIMEOUT_S = 5.0
_RETRY = {"reconnect": "1", "reconnect_on_network_error": "1", "reconnect_delay_max": "5"}
_PROTOCOLS = {"file": "file,crypto,data", "url": "http,https,tcp,tls,httpproxy,crypto,data"}
_POLL_S = 0.2
_TEXT_CODECS = ("ansi", "bintext", "xbin", "idf")  # FFmpeg renders text as a video of scrolling terminal output


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
        self._title = "the standard input" if text == kinds.STDIN else f"'{kinds.without_password(text)}'"
        self._autorotate = autorotate
        self._lock, self._closed = threading.Lock(), False
        self._reformatter = VideoReformatter()
        self._pipe: _Pipe | None = None
        self._is_url = kinds.is_url(text)
        self._resources = ExitStack()
        self.notes = []
        try:
            self._open = self._opener(text)
            self._skips = Skips(self.name)
            self._container = self._open()
            self._stream = self._video_stream()
            self._describe(text, fps)
            self._start_ns = 0
            self._shows_damage = False
            self._begin()
            first = self._read()
            if first is None and self._damaged and self._pipe is None:
                self._shows_damage = True  # better than nothing
                self._reopen()
                first = self._read()
            if first is None:
                raise InputError(self._nothing())
        except BaseException:
            self.close()
            raise
        self._first = first
        self._origin = first.key if self._times else None
        self._number = self._position - 1  # of the first picture
        self.orientation = in_words(self._exif(first.frame), autorotate=autorotate)
        if autorotate and self._exif(first.frame) != 1:
            self.notes.append(f"pictures are {self.orientation}, as the file says; --no-autorotate leaves them")

    @property
    def skipped(self) -> int:
        return self._skips.count

    def seek(self, start_s: float) -> None:
        """See `Source`. Behind it `Frame.index` is the time multiplied by the frame rate: exact for a constant rate."""
        self._start_ns = round(start_s * 1e9)

    def __iter__(self) -> Iterator[Frame]:
        try:
            seeks = self._start_ns > 0 and self._pipe is None
            found = self._read_near(self._start_ns) if seeks else self._first
            while found is not None:
                index, stamp_ns = self._place(found)
                if stamp_ns >= self._start_ns:
                    yield Frame(index, stamp_ns, self._image(found.frame))
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
            return lambda: self._opened(text, _PROTOCOLS["url"], _RETRY, (_TIMEOUT_S, _TIMEOUT_S))
        kind = kinds.kind_of(text)
        if kind == "pipe":
            self.name, self.kind = Path(text).stem, "video stream from a pipe"
            if text == kinds.STDIN:
                self.kind = "video stream from stdin"
            self._pipe = pipe = _Pipe(text)
            self._resources.callback(pipe.close)
            self._check(text, pipe.start)
            return lambda: self._opened(pipe, "pipe", {}, None)
        if kind == "folder":
            raise InputError(f"{self._title} is a folder, not a video file")
        if kind in ("missing", "camera"):
            raise InputError(f"there is no video file {self._title}")
        if kind == "device":
            raise InputError(f"{self._title} is a device, no video file: name one, or send a video through a pipe")
        self._check(text, kinds.start_of(text))
        path = Path(text)
        # Absolute, so that FFmpeg takes no part of the name for a protocol.
        name = str(path.absolute())
        try:
            name.encode()
        except UnicodeEncodeError:
            raise InputError(f"the file name {name!a} is not UTF-8: rename the file") from None
        self.name, self.kind = path.stem, "video file"
        return lambda: self._opened(name, _PROTOCOLS["file"], {}, None)

    def _check(self, text: str, start: bytes) -> None:
        """Refuse by its first bytes what FFmpeg would take for something else, or could not name."""
        kind = kinds.kind_of_content(start, Path(text).suffix.lower())
        if kind == "log":
            raise InputError(f"{self._title} is a log: open it with logs.open_images")
        if kind == "packed":
            raise kinds.packed_error(text, start)
        if kind == "image":
            raise InputError(f"{self._title} is an image, no video: open it with frontend.open_source")
        if not start:
            raise InputError(f"{self._title} is empty, or cannot be read: give a video file")

    def _opened(self, place: Any, protocols: str, more: dict[str, str], timeout: Any) -> InputContainer:
        limits = {"protocol_whitelist": protocols, "max_pixels": str(MOST_PIXELS), **more}
        try:
            made: InputContainer = av.open(place, "r", options=limits, metadata_errors="replace", timeout=timeout)
        except (av.FFmpegError, OSError, ValueError) as error:
            self._raise_interrupt()
            if self._is_url:
                raise InputError(f"cannot open {self._title} ({_reason(error)}): is the address right?") from None
            if self._unpipeable():
                raise InputError(self._unpipeable()) from None
            start = self._pipe.start if self._pipe is not None else kinds.start_of(place)
            what = "text" if kinds.is_text(start) else "empty, cut short or of an unknown format"
            raise InputError(f"{self._title} is no video that can be read: it is {what}") from None
        self._resources.callback(made.close)
        return made

    def _video_stream(self) -> VideoStream:
        """The container's first video that is no cover picture."""
        streams = self._container.streams
        form = self._container.format.name
        if any(stream.codec_context and stream.codec_context.name in _TEXT_CODECS for stream in streams.video):
            raise InputError(f"{self._title} holds text, no readable video frame: give a video file")
        if form.endswith("_pipe") or form in ("image2", "ico"):
            raise InputError(f"{self._title} is a single picture, no video: convert it to PNG")
        for stream in streams.video:
            if not stream.disposition & Disposition.attached_pic:
                if stream.codec_context is None:
                    raise InputError(f"{self._title} holds video of a codec that this FFmpeg cannot decode: convert it")
                return stream
        held = sorted({str(stream.type) for stream in streams})
        cover = " and a cover picture" if streams.video else ""
        what = " and ".join(kind for kind in held if kind != "video") or "nothing"
        raise InputError(f"{self._title} holds {what}{cover}, no readable video frame: give a video file")

    def _describe(self, text: str, fps: float) -> None:
        """Set what the container says of the video."""
        stream, container = self._stream, self._container
        suffix, names = Path(text).suffix[1:].lower(), container.format.name.split(",")
        self.kind = f"{self.kind} ({suffix if suffix in names else 'mp4' if 'mp4' in names else names[0]})"
        self.codec = stream.codec_context.codec.canonical_name
        pixels = stream.codec_context.format
        if pixels is not None and any(part.bits > 8 for part in pixels.components):
            self.codec += f" ({pixels.name})"
        unit = stream.time_base or Fraction(1, av.time_base)
        self._unit_ns = unit.numerator * 10**9, unit.denominator
        rate = stream.average_rate or stream.guessed_rate
        self._fps = float(rate) if rate and 0 < rate < 10_000 else fps
        self._coded_order = "avi" in names  # of its times
        self._times = True
        no_times: Any = av.format.Flags.no_timestamps
        if container.format.flags & no_times.value and not stream.codec_context.framerate:
            self._times, self._fps = False, fps
            self.notes.append(f"the video holds no times: {fps:g} frames/s are assumed; --fps gives another rate")
        duration_s = None
        if stream.duration:
            duration_s = float(stream.duration * unit)
        elif container.duration and container.duration > 0:
            duration_s = container.duration / av.time_base
        stated = stream.frames
        timed = None if duration_s is None else round(duration_s * self._fps)
        if timed is not None and (stated <= 0 or ("mp4" in names and timed < stated)):  # hidden pictures count there
            stated = timed
        self.frame_count = stated if 0 < stated < 1e9 and self._pipe is None else None
        self.last_stamp_ns = None
        if self.frame_count is not None and duration_s is not None:
            self.last_stamp_ns = max(round((duration_s - 1 / self._fps) * 1e9), 0)

    def _reopen(self) -> None:
        self._container.close()
        self._container = self._open()
        self._stream = self._video_stream()
        self._begin()

    def _begin(self) -> None:
        """Read a container from its begin."""
        self._stream.thread_type = "AUTO"
        self._stream.codec_context.options = {"max_pixels": str(MOST_PIXELS)}
        self._position = 0  # frames passed, damaged ones included
        self._last: tuple[int, int] | None = None  # index and stamp of the latest frame
        self._restart()

    def _restart(self) -> None:
        self._waiting: list[int] = []  # times of the packets whose pictures have not come, a heap
        self._newest: int | None = None
        self._damaged = 0  # packets whose pictures will not come
        self._error = ""
        self._pictures = self._decoded()

    def _decoded(self) -> Iterator[VideoFrame]:
        """The pictures that are whole."""
        failed = 0
        packets = self._container.demux(self._stream)
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
                self._raise_interrupt()
                raise InputError(f"cannot read more of {self._title}: {_reason(error)}") from None
            if packet is not None and not packet.size:  # which a decoder would take for the end
                continue
            if packet is not None and not packet.is_discard:
                self._damaged += packet.is_corrupt
                key = packet.dts if packet.pts is None or self._coded_order else packet.pts
                if key is None and self._newest is not None:  # damage has taken its time
                    key = self._newest + 1
                if key is not None:
                    heapq.heappush(self._waiting, key)
                self._newest = key
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
                return

    def _read(self) -> _Picture | None:
        """The next whole picture; what was damaged before it is counted."""
        frame = next(self._pictures, None)
        if frame is None:
            return None
        key: int | None = frame.dts if frame.pts is None or self._coded_order else frame.pts
        passed = 0
        while key is not None and self._waiting and self._waiting[0] <= key:
            passed += heapq.heappop(self._waiting) < key
        # without damage these were no frames: the other halves of interlaced ones, or pictures to predict from
        self._skip(self._damaged if key is None else passed if self._damaged else 0)
        self._position += 1
        return _Picture(key, frame)

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

    def _image(self, frame: VideoFrame) -> Image:
        name = frame.format.name
        if name.startswith("gray") and "f" not in name:
            target = "gray" if frame.format.components[0].bits == 8 else "gray16le"
        else:
            target = "bgr24"
        # the interpolation is that of chroma, for pixels like those of OpenCV
        made = self._reformatter.reformat(frame, format=target, interpolation=Interpolation.BICUBIC)
        plane: Any = made.planes[0]
        depth = np.uint16 if target == "gray16le" else np.uint8
        rows = np.frombuffer(plane, depth).reshape(frame.height, -1)
        channels = 3 if target == "bgr24" else 1
        image: Any = np.ascontiguousarray(rows[:, : frame.width * channels])
        if made is frame and image.base is not None:  # the decoder's own memory
            image = image.copy()
        if channels == 3:
            image = image.reshape(frame.height, frame.width, 3)
        return upright(image, self._exif(frame)) if self._autorotate else image

    def _exif(self, frame: VideoFrame) -> int:
        """How the picture is to be turned, as EXIF numbers it."""
        data: Any = frame.side_data.get("DISPLAYMATRIX")
        if data is None:
            return 1
        across, down, to_across, to_down = np.frombuffer(bytes(data), np.int32)[[0, 1, 3, 4]].tolist()
        if abs(across) >= abs(down):
            return {(False, False): 1, (True, False): 2, (True, True): 3, (False, True): 4}[across < 0, to_down < 0]
        return {(False, False): 5, (False, True): 6, (True, True): 7, (True, False): 8}[down < 0, to_across < 0]

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
        stated = self.frame_count or 0
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


class _Pipe:
    """A pipe as FFmpeg reads it: `stopped` ends it, from any thread, and so does Ctrl-C."""

    def __init__(self, path: str) -> None:
        self.stopped = threading.Event()
        self.interrupt: KeyboardInterrupt | None = None  # no exception passes through FFmpeg
        try:
            self._file = open(path, "rb", buffering=0)  # noqa: PTH123, SIM115  closed with the pipe
        except OSError as error:
            raise InputError(f"cannot read from '{path}': {error.strerror}") from None
        self.start = self._ahead = self._take(1 << 12)

    def read(self, size: int) -> bytes:
        try:
            if self._ahead:
                data, self._ahead = self._ahead[:size], self._ahead[size:]
                return data
            return self._take(size)
        except KeyboardInterrupt as interrupt:
            self.interrupt = interrupt
            return b""

    def close(self) -> None:
        self._file.close()

    def _take(self, size: int) -> bytes:
        """What there is, up to so many bytes, as soon as there is any; none at the end."""
        while not self.stopped.is_set():
            if select.select([self._file], [], [], _POLL_S)[0]:
                return self._file.read(size) or b""
        return b""


def _reason(error: Exception) -> str:
    """Why, without the address, which may carry a password."""
    return str(getattr(error, "strerror", "") or type(error).__name__)
