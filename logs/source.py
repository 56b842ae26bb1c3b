"""Frames of an image topic of a log."""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import replace
from functools import cached_property
from itertools import islice
from math import inf
from typing import TYPE_CHECKING

from airline.errors import InputError
from frontend.camera.model import CameraModel
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.orientation import Turns
from frontend.sources.reading import Image, Skips, UndecodableError
from frontend.sources.stills import Still
from logs.calibration import camera_from_log
from logs.files import LogFile, LogMessage, TopicType
from logs.files.mcap_file import McapFile
from logs.images.decoder import ImageDecoder, decode_still
from logs.messages.readers import check_seen, read_message
from logs.messages.types import (
    BAYER,
    CameraInfo,
    EncodedImage,
    RawImage,
    VideoPacket,
    container,
    has_picture,
    is_key_frame,
)
from logs.order import WINDOW, Entry, Picture, StampOrder
from logs.stamps import StampClock, TimeSource, own_stamp, wanted_time
from logs.topics import choose_seen, image_topics, mean_rate_hz, printable

if TYPE_CHECKING:
    from logs.images.video import Shown

log = logging.getLogger(__name__)

_DECODERS = 2  # threads for JPEG, PNG and WebP
_AHEAD = 4  # images decoded ahead of the one in use
_MARGIN_NS = 10**9  # a seek begins to look for its frame that much earlier
_TAIL_NS = 10**9  # of the log, where the last stamp is looked for first


class LogImageSource(Source):
    """Images of one topic of a log: ROS 2, ROS 1 and Foxglove messages, raw, compressed or video.

    Frames are uint8, (H, W) grey or (H, W, 3) BGR; 16-bit images are brought to 8 bits on a steady scale.
    `Frame.camera` comes from the topic's calibration messages. Messages that cannot be decoded or repeat a frame are
    skipped, counted by reason, and keep their number. Video comes in the order of display, and with header times
    other messages that were logged late in the order of their stamps, see `StampOrder`. Depth is refused.

    Args:
        file: the opened log; the source closes it.
        topic: the image topic; may be left out if there is only one, or only one that is not depth.
        time_source: where stamps come from, "header", "publish" or "log"; see `StampClock`.
        autorotate: turn compressed images upright as their EXIF data say.

    Raises:
        InputError: no such topic, or depth on it; while iterating, when not one message can be decoded.
    """

    name: str
    notes: list[str]

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
        self._first_skipped: float = inf
        self.notes = []
        self._turns = Turns(self.notes, autorotate)
        try:
            self._topic, depth = choose_seen(file, topic)
        except InputError:
            self.close()
            raise
        if depth:
            self.notes.append(
                f"{printable(self._topic)} is the only image topic that is not depth; --topic takes another"
            )

    @property
    def frame_count(self) -> int | None:
        """Messages on the topic; None where the log does not say, and behind a seek."""
        return None if self._start_ns else self._file.topics[self._topic].count

    @property
    def skipped(self) -> int:
        return self._skips.count

    @property
    def orientation(self) -> str:
        return self._turns.words

    @property
    def kind(self) -> str:
        return printable(f"{self._file.kind}, {self._topic} ({self._file.topics[self._topic].type})")

    @cached_property
    def codec(self) -> str:
        """The encoding of the first readable message."""
        record = next((record for _, record, _ in self._readable()), None)
        if not isinstance(record, EncodedImage):
            return "" if record is None else record.encoding if isinstance(record, RawImage) else record.format
        return f"{container(record.data)}{f' ({record.encoding})' if record.encoding else ''}"

    @property
    def first_stamp_ns(self) -> int:
        """Stamp of the first readable message, from which `seek` counts."""
        return self._first[1]

    @cached_property
    def last_stamp_ns(self) -> int | None:
        """The highest stamp of the readable messages at the end; None where the log is too damaged to tell."""
        if self._file.span_ns is None:
            return None
        first_ns, end_ns = self._file.span_ns
        back_ns = _TAIL_NS
        while True:
            start_ns = max(first_ns, end_ns - back_ns)
            last = max((stamp_ns for *_, stamp_ns in self._readable(start_ns)), default=None)
            if last is not None or start_ns == first_ns:
                return last
            back_ns *= 4

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
            if not frames and self._skips.count:
                raise InputError(f"not one image of '{self.name}' can be read; {self._skips.first}{self._advice()}")
        finally:
            self.close()
            self._skips.report(log)

    def close(self) -> None:
        self._file.close()

    def packets(self) -> Iterator[tuple[int, int, VideoPacket]]:
        """Numbers, stamps (ns) and packets of a video in place of frames, from a key frame at or before the start.

        There is one for each picture, with the stamp of its message. Ends where a message is no video.
        """
        start_ns, number = self._landing(StampClock(self.name, self._time_source)) if self._start_ns else (None, 0)
        parameters, begun = b"", False
        for position, message, record in self._ordered(start_ns, number):
            if not isinstance(record, VideoPacket):
                return
            if not has_picture(record):
                parameters += record.data  # of their own message
                continue
            packet = replace(record, data=parameters + bytes(record.data))
            parameters, begun = b"", begun or is_key_frame(packet)
            if begun:
                with suppress(UndecodableError):
                    yield position, own_stamp(self._time_source, record.stamp_ns, message), packet

    def _images(self) -> Iterator[tuple[int, int, Image]]:
        """Numbers, stamps and images in order; JPEG, PNG and WebP are decoded a few ahead, by threads."""
        decoder = ImageDecoder()
        clock = StampClock(self.name, self._time_source, self.notes, lambda: mean_rate_hz(self._file, self._topic))
        start_ns, number = self._landing(clock) if self._start_ns else (None, 0)
        wanted_ns = self.first_stamp_ns + self._start_ns if self._start_ns else 0
        waiting: deque[tuple[int, int, Future[Still]]] = deque()

        def stills(most: int) -> Iterator[tuple[int, int, Image]]:
            while len(waiting) > most:
                number, stamp_ns, still = waiting.popleft()
                try:
                    image, header = still.result()
                    self._turns.add(header.exif)
                    yield number, stamp_ns, decoder.eight_bits(image)
                except UndecodableError as error:
                    self._skip(number, error)

        def video(found: Sequence[Shown]) -> Iterator[tuple[int, int, Image]]:
            for shown in found:
                at = LogMessage(self._topic, TopicType("", ""), shown.log_ns, shown.stamp_ns, b"")
                try:
                    stamp_ns = clock.stamp(shown.stamp_ns, at)
                except UndecodableError as error:
                    self._skip(shown.number, error)
                    continue
                if stamp_ns >= wanted_ns:
                    yield shown.number, stamp_ns, shown.image
            self._note_order(decoder)

        with ThreadPoolExecutor(_DECODERS) as pool, closing(self._ordered(start_ns, number)) as entries:
            for number, message, record in entries:
                try:
                    if isinstance(record, VideoPacket):
                        yield from stills(0)
                        packet = replace(record, stamp_ns=wanted_time(self._time_source, record.stamp_ns, message))
                        yield from video(decoder.video.feed(packet, number, message.log_ns))
                        continue
                    yield from video(decoder.flush())
                    stamp_ns = clock.stamp(record.stamp_ns, message)
                    if stamp_ns < wanted_ns:
                        continue
                    if isinstance(record, EncodedImage):
                        waiting.append((number, stamp_ns, pool.submit(decode_still, record, self._autorotate)))
                        yield from stills(_AHEAD)
                    else:
                        yield from stills(0)
                        yield number, stamp_ns, decoder.eight_bits(decode_still(record).image)
                except UndecodableError as error:
                    self._skip(number, error)
            yield from stills(0)
            yield from video(decoder.flush())

    def _ordered(self, start_ns: int | None, number: int) -> Generator[Entry]:
        """The topic's readable messages with their numbers; with header times in the order of those, but for video."""
        order = StampOrder(lambda entry, reason: self._skip(entry.number, UndecodableError(reason)))
        recent: deque[Entry] = deque(maxlen=WINDOW)  # video packets
        for message in self._file.messages(self._topic, start_ns):
            position, number = number, number + 1
            self._seen += 1
            try:
                entry = Entry(position, message, _picture(message))
                self._note_encoding(entry.record)
            except UndecodableError as error:
                self._skip(position, error)
                continue
            if self._time_source != "header":
                yield entry
            elif isinstance(entry.record, VideoPacket):
                yield from order.flush()
                if any(entry.repeats(other) for other in recent):
                    self._skip(position, UndecodableError("it repeats the frame before it"))
                else:
                    recent.append(entry)
                    yield entry
            else:
                yield from order.add(entry)
        yield from order.flush()
        if order.late:
            what = "1 message that was" if order.late == 1 else f"{order.late} messages that were"
            self._note(f"{what} logged late came in order by header time; --time-source log keeps the log's order")
        if order.ahead:
            what = "1 header time" if order.ahead == 1 else f"{order.ahead} header times"
            self._note(f"{what} ahead of all others gave way to the log's clock (--time-source log uses it throughout)")

    def _note_order(self, decoder: ImageDecoder) -> None:
        if decoder.reorders:
            self._note(
                "the video has B-frames and times that rise in file order, so the earliest time went to the picture "
                "that is shown first"
            )

    def _note_encoding(self, record: Picture) -> None:
        if isinstance(record, RawImage) and record.encoding == "8UC2":
            self._note("of 8UC2 images the first channel was taken, as grey")
        if isinstance(record, EncodedImage) and record.encoding in BAYER:
            self._note(f"compressed images were taken for {record.encoding} mosaics, as their format says")

    def _note(self, note: str) -> None:
        if note not in self.notes:
            self.notes.append(note)

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
        """The message whose frame comes first, and its stamp."""
        order = StampOrder(lambda entry, reason: None)
        for number, (message, record, stamp_ns) in enumerate(islice(self._readable(), 2 * WINDOW + 1)):
            if self._time_source != "header" or isinstance(record, VideoPacket):
                return message, stamp_ns
            for entry in order.add(Entry(number, message, record)):
                return entry.message, own_stamp(self._time_source, entry.stamp_ns, entry.message)
        for entry in order.flush():
            return entry.message, own_stamp(self._time_source, entry.stamp_ns, entry.message)
        raise InputError(f"not one image of '{self.name}' can be read on {printable(self._topic)}{self._advice()}")

    def _advice(self) -> str:
        others = image_topics(self._file, but=self._topic)
        return f"; docs/mcap.md says what can be{f', and --topic takes another topic: {others}' if others else ''}"

    def _skip(self, number: int, error: UndecodableError) -> None:
        what = f"message {number} on {printable(self._topic)}: {error}"
        self._skips.add(what, reason=error.reason)
        if number < self._first_skipped:  # they are not found in order
            self._first_skipped, self._skips.first = number, what


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
    check_seen(record, message.topic)
    return record
