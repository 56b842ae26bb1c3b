"""The camera's image as a reference into the video file it came from, or as a log's packets; nothing is encoded."""

from __future__ import annotations

import io
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from airline.errors import ConfigError
from frontend.frame import Frame
from viz.figures import Clock

if TYPE_CHECKING:
    from av import Packet
    from av.video.stream import VideoStream

CODECS = ("h264", "hevc", "av1")  # what Rerun plays out of mp4
OTHERWISE = "use --log-image jpeg"


class VideoReferences:
    """Logs which picture of a video file a frame is; the frames must come as they are in the file.

    Raises:
        ConfigError: Rerun cannot play the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        import av

        codec, self._size, hidden = _examined(path)
        # Rerun shows what an edit list hides, and so has to be told what comes before the first picture
        ways: list[Callable[[], bytes]] = [path.read_bytes, lambda: _remuxed(path, codec)]
        for contents in ways[1:] if hidden else ways:
            with suppress(RuntimeError, av.FFmpegError):
                self._asset = rr.AssetVideo(contents=contents(), media_type="video/mp4")
                self._stamps = np.sort(self._asset.read_frame_timestamps_nanos())[hidden:]
                if len(self._stamps):
                    return
        raise ConfigError(f"Rerun cannot play {path}: {OTHERWISE}")

    def start(self, stream: rr.RecordingStream) -> None:
        """Log the file itself, once."""
        stream.log("/camera/image", self._asset, static=True)

    def log(self, stream: rr.RecordingStream, clock: Clock, frame: Frame) -> None:
        """Refer to the picture nearest in time to the frame; ConfigError where the frame has another size."""
        if (frame.image.shape[1], frame.image.shape[0]) != self._size:
            raise ConfigError(f"{self._path} cannot stand for frames of another size: {OTHERWISE}")
        wanted = self._stamps[0] + frame.stamp_ns  # a frame's time counts from the first picture
        clock.set(frame.index, frame.stamp_ns)
        nearest = self._stamps[np.argmin(np.abs(self._stamps - wanted))]
        stream.log("/camera/image", rr.VideoFrameReference(nanoseconds=int(nearest)))


class VideoPackets:
    """Logs the packets of a video as they are, one for each picture, with what a decoder needs between frames.

    Args:
        codec: "h264", "h265", "vp9" or "av1".
        packets: frame numbers, stamps (ns) and data in ascending order, the first a key frame; H.264 and H.265 in
            Annex B, without pictures that are shown in another order. Closed when the recording is.
    """

    def __init__(self, codec: str, packets: Generator[tuple[int, int, bytes]]) -> None:
        self._codec = rr.VideoCodec.auto(codec)
        self._packets = packets
        self._next = next(packets, None)

    def start(self, stream: rr.RecordingStream) -> None:
        """Log the codec, once."""
        stream.log("/camera/image", rr.VideoStream(self._codec), static=True)

    def log(self, stream: rr.RecordingStream, clock: Clock, frame: Frame) -> None:
        """Log the packets up to the frame's, each at its own frame and time."""
        while self._next is not None and self._next[0] <= frame.index:
            number, stamp_ns, data = self._next
            clock.set(number, frame.stamp_ns if number == frame.index else min(stamp_ns, frame.stamp_ns))
            stream.log("/camera/image", rr.VideoStream.from_fields(sample=np.frombuffer(data, np.uint8)))
            self._next = next(self._packets, None)

    def close(self) -> None:
        """Let go of the log; safe to call twice."""
        self._packets.close()


def _examined(path: Path) -> tuple[str, tuple[int, int], int]:
    """Codec and size of a video, and how many pictures are hidden before the first."""
    import av  # FFmpeg takes time to import

    if not path.is_file():
        raise ConfigError(f"--log-image video needs a video file as its input, not {path}: {OTHERWISE}")
    try:
        with av.open(str(path)) as container:
            video = container.streams.video[0].codec_context
            codec, size = video.codec.canonical_name, (video.width, video.height)
            hidden = _hidden(container.demux(video=0))
    except (av.FFmpegError, OSError, IndexError) as reason:
        raise ConfigError(f"{path} is no video that Rerun can play ({reason}): {OTHERWISE}") from None
    if codec not in CODECS:
        raise ConfigError(f"Rerun plays {', '.join(CODECS)}, and {path} is {codec}: {OTHERWISE}")
    return codec, size, hidden


def _hidden(packets: Iterator[Packet[VideoStream]]) -> int:
    first = next(packets, None)
    if first is None or not first.is_discard:
        return 0
    rest = [packet for packet in packets if packet.pts is not None]
    begin = min((packet.pts or 0 for packet in rest if not packet.is_discard), default=0)
    return 1 + sum(packet.is_discard and (packet.pts or 0) < begin for packet in rest)


def _remuxed(path: Path, codec: str) -> bytes:
    """The same pictures in a fresh .mp4: from another container, or with headers that Rerun's parser trips over.

    They begin at zero, hidden ones too, as they do for Rerun, which heeds no edit list.
    """
    import av
    from av.bitstream import BitStreamFilterContext

    file = io.BytesIO()
    with av.open(str(path)) as source, av.open(file, "w", format="mp4") as target:
        read = source.streams.video[0]
        written = target.add_stream_from_template(read)
        headers = BitStreamFilterContext(f"{codec}_metadata", read, written)
        packets = list(source.demux(read))
        begin = min((packet.pts for packet in packets if packet.pts is not None), default=0)
        for packet in packets:
            if packet.pts is not None and packet.dts is not None:
                packet.pts, packet.dts = packet.pts - begin, packet.dts - begin
            for clean in headers.filter(packet):
                clean.stream = written
                target.mux(clean)
    return file.getvalue()
