"""Frames of an image topic of a log."""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from functools import cached_property

from airline.errors import InputError
from frontend.camera.model import CameraModel
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.reading import Image, Skips, UndecodableError
from logs.calibration import camera_from_log
from logs.files import LogFile, LogMessage
from logs.files.mcap_file import McapFile
from logs.images.decoder import ImageDecoder, decode_still
from logs.messages.readers import read_message
from logs.messages.types import CameraInfo, EncodedImage, RawImage, VideoPacket, is_key_frame
from logs.stamps import StampClock, TimeSource, own_stamp
from logs.topics import choose_topic, mean_rate_hz, printable

log = logging.getLogger(__name__)

_DECODERS = 2  # threads for JPEG, PNG and WebP
_AHEAD = 4  # images decoded ahead of the one in use
_MARGIN_NS = 10**9  # a seek begins to look for its frame that much earlier

Picture = RawImage | EncodedImage | VideoPacket


class LogImageSource(Source):
    """Images of one topic of a log: ROS 2, ROS 1 and Foxglove messages, raw, compressed or H.264 and H.265 video.

    Frames are uint8, (H, W) grey or (H, W, 3) BGR; 16-bit images are brought to 8 bits on a steady scale.
    `Frame.camera` comes from the topic's calibration messages. Messages that cannot be decoded or repeat a frame are
    skipped, counted by reason, and keep their number.

    Args:
        file: the opened log; the source closes it.
        topic: the image topic; may be left out if there is only one.
        time_source: where stamps come from, "header", "publish" or "log"; see `StampClock`.
        autorotate: turn compressed images upright as their EXIF data say.

    Raises:
        InputError: no such topic; while iterating, when not one message can be decoded.
    """

    name: str

    def __init__(
        self,
        file: LogFile,
        topic: str | None = None,
        *,
        time_source: TimeSource = "header",
        autorotate: bool = True,
    ) -> None:
        self._file = file
        self.name = file.name
        self._time_source = time_source
        self._autorotate = autorotate
        self._skips = Skips(file.name)
        self._start_ns = 0  # since the first frame
        self._seen = 0
        try:
            self._topic = choose_topic(file.topics, topic)
        except InputError:
            self.close()
            raise

    @property
    def frame_count(self) -> int | None:
        """Messages on the topic; None where the log does not say, and behind a seek."""
        return None if self._start_ns else self._file.topics[self._topic].count

    @property
    def skipped(self) -> int:
        return self._skips.count

    @property
    def first_stamp_ns(self) -> int:
        """Stamp of the first readable message, from which `seek` counts."""
        return self._first[1]

    def seek(self, start_s: float) -> None:
        """As in `Source`, by the log's index; `Frame.index` is then the time multiplied by the mean rate."""
        self._start_ns = round(start_s * 1e9)

    def __iter__(self) -> Iterator[Frame]:
        camera: CameraModel | None = None
        frames = 0
        try:
            for number, stamp_ns, image in self._images():
                size = image.shape[1], image.shape[0]
                if not frames or (camera is not None and (camera.width, camera.height) != size):
                    camera = camera_from_log(self._file, self._topic, size)
                yield Frame(number, stamp_ns, image, camera)
                frames += 1
            lost = (self.frame_count or 0) - self._seen
            if lost > 0:
                what = f"a message on {printable(self._topic)} in the damaged part of the log"
                self._skips.add(what, lost, reason="lost in the log's damaged part")
        finally:
            self.close()
            self._skips.report(log)
        if not frames and self._skips.count:
            raise InputError(f"not one image of '{self.name}' can be read; {self._skips.first}")

    def close(self) -> None:
        self._file.close()

    def _images(self) -> Iterator[tuple[int, int, Image]]:
        """Numbers, stamps and images in order; JPEG, PNG and WebP are decoded a few ahead, by threads."""
        decoder = ImageDecoder()
        waiting: deque[tuple[int, Picture, Future[Image] | None]] = deque()
        inside: dict[int, int] = {}  # numbers of the video packets that are still inside the decoder, by stamp

        def oldest() -> Iterator[tuple[int, int, Image]]:
            number, record, still = waiting.popleft()
            inside[record.stamp_ns] = number
            try:
                found: Sequence[tuple[int, Image]]
                if still is None:
                    found = decoder.decode(record)
                else:
                    found = [(record.stamp_ns, decoder.eight_bits(still.result()))]
                for stamp_ns, image in found:
                    yield inside.pop(stamp_ns, number), stamp_ns, image
            except UndecodableError as error:
                inside.pop(record.stamp_ns, None)
                self._skip(number, error)

        with ThreadPoolExecutor(_DECODERS) as pool, closing(self._records()) as records:
            for number, record in records:
                still = pool.submit(decode_still, record) if isinstance(record, EncodedImage) else None
                waiting.append((number, record, still))
                while len(waiting) > (0 if still is None else _AHEAD):
                    yield from oldest()
            while waiting:
                yield from oldest()
            for stamp_ns, image in decoder.flush():
                yield inside.pop(stamp_ns, number), stamp_ns, image

    def _records(self) -> Generator[tuple[int, Picture]]:
        """The topic's messages with their numbers, stamped by the clock."""
        clock = StampClock(self.name, self._time_source)
        start_ns, number = self._landing(clock) if self._start_ns else (None, 0)
        wanted_ns = self.first_stamp_ns + self._start_ns if self._start_ns else 0
        for message in self._file.messages(self._topic, start_ns):
            position, number = number, number + 1
            self._seen += 1
            try:
                record = _picture(message)
                stamp_ns = clock.stamp(record.stamp_ns, message)
            except UndecodableError as error:
                self._skip(position, error)
                continue
            if stamp_ns >= wanted_ns or isinstance(record, VideoPacket):
                yield position, replace(record, stamp_ns=stamp_ns)

    def _landing(self, clock: StampClock) -> tuple[int | None, int]:
        """The log time to read from for a seek, and the number of the message there.

        That is the last image, of a video the last key frame, at or before the start. The log's clock and the stamps'
        may run apart and key frames be rare, so look from farther back until there is one.
        """
        first, first_stamp_ns = self._first
        back_ns = _MARGIN_NS
        while back_ns < self._start_ns:
            landed_ns = None
            for message, record, stamp_ns in self._readable(first.log_ns + self._start_ns - back_ns):
                if stamp_ns - first_stamp_ns > self._start_ns:
                    break
                if not isinstance(record, VideoPacket) or is_key_frame(record):
                    landed_ns = message.log_ns
            if landed_ns == first.log_ns:
                break
            if landed_ns is not None:
                clock.stamp(first_stamp_ns, first)
                rate_hz = mean_rate_hz(self._file, self._topic) or 0
                return landed_ns, round((landed_ns - first.log_ns) * 1e-9 * rate_hz)
            back_ns *= 4
        return None, 0

    def _readable(self, start_ns: int | None = None) -> Iterator[tuple[LogMessage, Picture, int]]:
        """Messages, what they hold, and their stamps, each by itself."""
        for message in self._file.messages(self._topic, start_ns):
            try:
                record = _picture(message)
                yield message, record, own_stamp(self._time_source, record.stamp_ns, message)
            except UndecodableError:
                continue  # counted when it is read in order

    @cached_property
    def _first(self) -> tuple[LogMessage, int]:
        for message, _, stamp_ns in self._readable():
            return message, stamp_ns
        raise InputError(f"not one image of '{self.name}' can be read on {printable(self._topic)}")

    def _skip(self, number: int, error: UndecodableError) -> None:
        self._skips.add(f"message {number} on {printable(self._topic)}: {error}", reason=error.reason)


class McapImageSource(LogImageSource):
    """Images of one topic of the MCAP file `path`; see `LogImageSource`.

    Raises:
        InputError: no MCAP file; and as `LogImageSource`.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        topic: str | None = None,
        *,
        time_source: TimeSource = "header",
        autorotate: bool = True,
    ) -> None:
        super().__init__(McapFile(path), topic, time_source=time_source, autorotate=autorotate)


def _picture(message: LogMessage) -> Picture:
    record = read_message(message)
    if isinstance(record, CameraInfo):
        raise UndecodableError("it is no image", printable(str(message.type)))
    return record
