"""H.264 and H.265 streams through FFmpeg (PyAV)."""

from __future__ import annotations

from contextlib import suppress
from typing import cast

import av
import numpy as np
from av.codec.context import Flags
from av.video.codeccontext import VideoCodecContext
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from frontend.sources.reading import UndecodableError
from logs.messages.types import VideoPacket, is_key_frame

_Stamped = tuple[int, NDArray[np.uint8]]
_CODECS = {"h264": "h264", "h265": "hevc"}
# The largest picture of the highest level of either standard (6.2); FFmpeg refuses more before it allocates.
_MOST_PIXELS = 139_264 * 256


class _CorruptPictureError(Exception):
    """FFmpeg has marked a picture as not whole."""


class VideoDecoder:
    """Decodes the packets of one stream in order.

    An image has its own packet's stamp, and comes at once where the stream has no B-frames. After damage nothing is
    decoded up to the next key frame: every picture until then would be predicted from a wrong one. FFmpeg notices cut
    and nearly all damaged H.264 pictures and missing H.265 ones, but few damaged H.265 and no missing H.264 ones.
    """

    def __init__(self) -> None:
        self._format = ""
        self._codec: VideoCodecContext | None = None
        self._reformatter = VideoReformatter()
        self._waits = True
        self._ready: list[_Stamped] = []

    def feed(self, packet: VideoPacket) -> list[_Stamped]:
        """Decode one packet, which holds one picture.

        Returns:
            (stamp in ns, (H, W, 3) BGR image) of this packet, or of earlier ones in a stream with B-frames, or none.

        Raises:
            UndecodableError: no picture comes of this packet; the next may be fed all the same.
        """
        if packet.format != self._format:
            self._open(packet.format)
        if is_key_frame(packet):
            self._waits = False
        elif self._waits:
            raise UndecodableError("waits for a key frame")
        try:
            self._decode(packet)
        except av.error.FFmpegError as error:
            self._drain(damaged_ns=packet.stamp_ns)
            raise UndecodableError("damaged video frame", error.strerror or "") from error
        except _CorruptPictureError as error:  # what is inside may have been predicted from it
            self._start_afresh()
            raise UndecodableError("damaged video frame", "its picture is not whole") from error
        return self._taken()

    def flush(self) -> list[_Stamped]:
        """The images that are still inside; afterwards a new stream may begin."""
        self._drain()
        return self._taken()

    def _taken(self) -> list[_Stamped]:
        ready, self._ready = self._ready, []
        return ready

    def _open(self, name: str) -> None:
        if name not in _CODECS:
            raise UndecodableError("video format is not readable", repr(name[:40]))
        self._drain()
        codec = cast(VideoCodecContext, av.CodecContext.create(_CODECS[name], "r"))
        codec.flags |= Flags.low_delay
        codec.thread_count = 1  # with more, the H.264 decoder does not notice what is missing
        codec.options = {"max_pixels": str(_MOST_PIXELS)}
        if name == "h265":  # its decoder marks no picture as corrupt, and only this makes it report damage
            codec.options = {**codec.options, "err_detect": "explode"}
        self._codec, self._format = codec, name

    def _decode(self, packet: VideoPacket) -> None:
        assert self._codec is not None
        if not packet.data:  # would mean the end of the stream
            raise UndecodableError("damaged video frame", "it is empty")
        # FFmpeg reads beyond the end of its input: it has to be in a buffer of its own with room behind the data.
        unit = av.Packet(len(packet.data))
        unit.update(bytes(packet.data))
        unit.pts = packet.stamp_ns
        for frame in self._codec.decode(unit):
            self._take(frame)

    def _take(self, frame: VideoFrame) -> None:
        if frame.is_corrupt or frame.pts is None:
            raise _CorruptPictureError
        bgr = self._reformatter.reformat(frame, format="bgr24").to_ndarray()
        self._ready.append((frame.pts, np.require(bgr, np.uint8, ("C", "W"))))

    def _drain(self, damaged_ns: int | None = None) -> None:
        """Keep the whole pictures that are inside and start afresh."""
        if self._codec is None:
            return
        frames: list[VideoFrame] = []
        with suppress(av.error.FFmpegError):
            frames = self._codec.decode(None)
        for frame in frames:
            if frame.pts != damaged_ns:
                with suppress(av.error.FFmpegError, _CorruptPictureError):
                    self._take(frame)
        self._start_afresh()

    def _start_afresh(self) -> None:
        self._waits = True
        if self._codec is not None:
            self._codec.flush_buffers()
