"""Frames of an image topic of an MCAP log."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from pathlib import Path

from mcap.records import Message

from airline.errors import InputError
from frontend.frame import Frame
from frontend.sources.skips import Skips
from logs.image_messages import decoder_for
from logs.mcap_contents import DAMAGE, LogMessage, choose_topic, indexed_reader, read_contents, read_unindexed

log = logging.getLogger(__name__)

_MAGIC = b"\x89MCAP0\r\n"


class McapSource:
    """Images of one topic: ROS 2 Image and CompressedImage, Foxglove RawImage and CompressedImage in JSON.

    `Frame.stamp_ns` is the message's own stamp, or the log's time where that is zero. Messages that cannot be decoded
    and messages older than the one before are skipped and keep their number. Of a cut or damaged file all readable
    messages are used, with one warning.

    Args:
        path: the .mcap file.
        topic: the image topic; may be left out if there is only one.

    Raises:
        InputError: no MCAP file, or no such topic; while iterating, when not one message can be decoded.
    """

    def __init__(self, path: str | os.PathLike[str], topic: str | None = None) -> None:
        self._path = Path(path)
        self._skips = Skips(self.name)
        try:
            self._file = self._path.open("rb")
        except (OSError, ValueError) as error:
            raise InputError(f"cannot open the log '{self._path}': {error}") from error
        try:
            if self._file.read(len(_MAGIC)) != _MAGIC:
                raise InputError(f"'{self._path}' is not an MCAP file")
            self._contents = read_contents(self._file)
            self._topic = choose_topic(self._contents.types, topic)
        except InputError:
            self.close()
            raise

    @property
    def name(self) -> str:
        return self._path.stem

    @property
    def frame_count(self) -> int | None:
        """Messages on the topic; None for a log without an index."""
        counts = self._contents.counts
        return None if counts is None else counts[self._topic]

    @property
    def skipped(self) -> int:
        return self._skips.count

    def __iter__(self) -> Iterator[Frame]:
        last_ns = -1
        try:
            for index, (schema, channel, message) in enumerate(self._messages()):
                try:
                    decode = decoder_for(schema.name if schema else "", channel.message_encoding)
                    if decode is None:
                        raise InputError("the topic changes its type")
                    stamp_ns, image = decode(message.data)
                    stamp_ns = stamp_ns or _log_time(message)
                    if stamp_ns <= last_ns:
                        raise InputError("it is not later than the frame before it")
                except InputError as error:
                    self._skips.add(f"message {index} on {self._topic}: {error}")
                    continue
                last_ns = stamp_ns
                yield Frame(index, stamp_ns, image)
        finally:
            self.close()
            self._skips.report(log)
        if last_ns < 0 and self._skips.count:
            raise InputError(f"not one image of '{self._path}' can be read; {self._skips.first}")

    def close(self) -> None:
        self._file.close()

    def _messages(self) -> Iterator[LogMessage]:
        """The topic's messages by log time; from where there is no sound index, in the order of the file."""
        seen = 0
        after_ns = -1
        if self._contents.counts is not None:
            try:
                for message in indexed_reader(self._file).iter_messages(topics=[self._topic]):
                    yield message
                    seen, after_ns = seen + 1, message[2].log_time
                return
            except DAMAGE as error:
                log.debug("%s: the index does not hold (%s): going on in the order of the file", self.name, error)
        readable = read_unindexed(self._file)
        while True:
            try:
                message = next(readable)
            except StopIteration as end:
                intact = end.value
                break
            if message[1].topic == self._topic and message[2].log_time > after_ns:
                seen += 1
                yield message
        if not intact:
            log.warning("%s: the log is cut or damaged; its readable part was used", self.name)
        lost = (self.frame_count or 0) - seen
        if lost > 0:
            self._skips.add(f"a message on {self._topic} in the damaged part", lost)


def _log_time(message: Message) -> int:
    if message.log_time >= 2**63:
        raise InputError("its log time is out of range")
    return message.log_time
