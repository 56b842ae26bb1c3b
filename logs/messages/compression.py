"""Messages that a recorder compressed one by one, as rosbag2 does in the compression mode "message"."""

from __future__ import annotations

import zstandard

from frontend.sources.reading import Bytes, UndecodableError

_MAGIC = b"\x28\xb5\x2f\xfd"  # CDR begins with a zero
_MOST_BYTES = 1 << 27
_MAX_RATIO = 1 << 15  # 4 bytes of zstd can become a block of 128 KiB
_PART = 1 << 20


def unzipped(data: Bytes) -> Bytes:
    """The message inside a zstd frame; a message that is none as it is.

    Raises:
        UndecodableError: a damaged frame, or one of more than 128 MB.
    """
    if bytes(data[:4]) != _MAGIC:
        return data
    most = min(_MOST_BYTES, _MAX_RATIO * len(data))
    parts, size = [], 0
    try:
        says = zstandard.frame_content_size(data)  # -1 where it does not
        if says > most:
            raise UndecodableError("compressed message of impossible size")
        reader = zstandard.ZstdDecompressor(max_window_size=_MOST_BYTES).stream_reader(data)
        while part := reader.read(_PART):
            parts.append(part)
            size += len(part)
            if size > most:
                raise UndecodableError("compressed message of impossible size")
    except (zstandard.ZstdError, MemoryError) as error:
        raise UndecodableError("damaged compressed message", str(error)) from error
    if says not in (-1, size):
        raise UndecodableError("damaged compressed message", "it is cut")
    return b"".join(parts)
