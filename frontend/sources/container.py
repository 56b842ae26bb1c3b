"""Opening a video by FFmpeg: a file, a recording behind a URL, or a pipe."""

from __future__ import annotations

import re
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import av
from av.container import InputContainer
from av.stream import Disposition
from av.video.stream import VideoStream

from airline.errors import InputError
from frontend.sources import address, kinds
from frontend.sources.motion_jpeg import JPEG
from frontend.sources.pipe import Pipe

MOST_PIXELS = 1 << 26
"""More are refused by FFmpeg before it allocates for them."""
_TIMEOUT_S = 5.0
_RETRY = {"reconnect": "1", "reconnect_on_network_error": "1", "reconnect_delay_max": "5"}
_PROTOCOLS = {"file": "file,crypto,data", "URL": "http,https,tcp,tls,httpproxy,crypto,data", "pipe": "pipe"}
_TEXT_CODECS = ("ansi", "bintext", "xbin", "idf")  # FFmpeg renders text as a video of scrolling terminal output


class VideoInput:
    """What a name stands for, to be opened any number of times; a pipe once.

    Attributes:
        title: for messages.
        name: short.
        kind: for people, without the container's format.
        suffix: of the name.
        way: "file", "URL" or "pipe".
        pipe: where it is one.
        unsized: whether a server does not say how long it is.

    Raises:
        InputError: there is no such thing, or it is no video.
    """

    def __init__(self, spec: str) -> None:
        self._resources = ExitStack()
        self.title, self.suffix = kinds.title_of(spec), Path(spec).suffix.lower()
        self.name, self.way, self.kind = Path(spec).stem, "file", "video file"
        self.pipe: Pipe | None = None
        self.unsized = False
        # Absolute, so that FFmpeg takes no part of the name for a protocol.
        self._place: str | Pipe = str(Path(spec).absolute())
        kind = "URL" if kinds.is_url(spec) else kinds.kind_of(spec)
        if kind == "URL":
            shown = kinds.without_password(spec).split("?")[0].split("://")[-1]
            self.name = re.sub(r"[^\w.]+", "-", shown).strip("-.") or "video"
            self.way, self.kind, self._place = "URL", "recording at a URL", spec
            self._start, self.unsized = address.start_of(spec), address.length_of(spec) == 0
        elif kind == "pipe":
            self.way = "pipe"
            self.kind = "video stream from stdin" if spec == kinds.STDIN else "video stream from a pipe"
            self.pipe = self._place = Pipe(spec)
            self._resources.callback(self.pipe.close)
            self._start = self.pipe.start
        elif kind in ("folder", "device"):
            raise InputError(f"{self.title} is a {kind}, no video file: name one, or send a video through a pipe")
        elif kind in ("missing", "camera"):
            raise InputError(f"there is no video file {self.title}")
        else:
            self._start = kinds.start_of(spec)
            try:
                self._place.encode()
            except UnicodeEncodeError:
                raise InputError(f"the file name {self._place!a} is not UTF-8: rename the file") from None
        try:
            self._check(spec)
        except InputError:
            self.close()
            raise

    def open(self) -> InputContainer:
        """Open it; it is closed with this."""
        limits = {"protocol_whitelist": _PROTOCOLS[self.way], "max_pixels": str(MOST_PIXELS)}
        more, timeout = (_RETRY, (_TIMEOUT_S, _TIMEOUT_S)) if self.way == "URL" else ({}, None)
        form = "mjpeg" if self._start.startswith(JPEG) else None
        place: Any = self._place
        try:
            made: InputContainer = av.open(
                place, "r", form, options={**limits, **more}, metadata_errors="replace", timeout=timeout
            )
        except (av.FFmpegError, OSError, ValueError) as error:
            self.raise_interrupt()
            if self.way == "URL":
                raise InputError(f"cannot open {self.title} ({reason_of(error)}): is the address right?") from None
            what = "text" if kinds.is_text(self._start) else "empty, cut short or of an unknown format"
            says = f"{self.title} is no video that can be read: it is {what}"
            raise InputError(self.unpipeable() or says) from None
        self._resources.callback(made.close)
        return made

    def close(self) -> None:
        self._resources.close()

    def unpipeable(self) -> str:
        """What to say of an MP4 whose index is behind its pictures, in a pipe; else nothing."""
        if self.pipe is None or self._start[4:8] != b"ftyp":
            return ""
        return f"{self.title} sends an MP4 whose index is at its end: name the file, or send Matroska or MPEG-TS"

    def raise_interrupt(self) -> None:
        """Raise the Ctrl-C that has ended a pipe, if one has."""
        if self.pipe is not None and self.pipe.interrupt is not None:
            raise self.pipe.interrupt

    def _check(self, spec: str) -> None:
        """Refuse by its first bytes what FFmpeg would take for something else, or could not name."""
        kind = kinds.kind_of_content(self._start, self.suffix)
        if kind == "packed":
            raise kinds.packed_error(spec, self._start)
        if kind in ("log", "image"):
            what = "a log" if kind == "log" else "an image, no video"
            how = f"open it with {'logs.open_images' if kind == 'log' else 'frontend.open_source'}"
            if self.way != "file":
                how = "only videos come through a pipe" if self.pipe else "only videos come from a URL"
                how += ": save it as a file, and name that"
            raise InputError(f"{self.title} is {what}: {how}")
        if not self._start and self.way != "URL":
            raise InputError(f"{self.title} is empty, or cannot be read: give a video file")


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


def reason_of(error: Exception) -> str:
    """Why, without the address, which may carry a password."""
    return str(getattr(error, "strerror", "") or type(error).__name__)
