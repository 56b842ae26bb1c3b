"""The NAL units of H.264 and H.265 in Annex B form, as far as one looks at them without decoding.

ITU-T H.264 and H.265, Annex B (start codes), table 7-1 of each (types of NAL units).
"""

from __future__ import annotations

import re

from logs.messages.types import Bytes, VideoPacket

_START = b"\x00\x00\x01"
_H264_SEI = 6


def video_format(declared: str) -> str | None:
    """ "h264" or "h265" if the text names one of them, as in "h264", "video/hevc" or "H.265"."""
    name = declared.lower().replace(".", "")
    if re.search(r"h264|avc", name):
        return "h264"
    return "h265" if re.search(r"h265|hevc", name) else None


def sniffed_video_format(data: Bytes) -> str | None:
    """ "h264" or "h265" if the bytes begin with a start code, told apart by the first unit's header."""
    head = bytes(data[:6])
    start = head.find(_START)
    if start not in (0, 1) or head[:start].strip(b"\x00") or len(head) < start + 5:
        return None
    first, second = head[start + 3], head[start + 4]
    # In H.265 with one spatial layer the first header byte is even, and the second is 1 to 7 (the temporal layer). In
    # H.264, even first bytes begin SEI (6), whose second byte is small as well, and PPS, whose second byte is large.
    return "h265" if first & 0x81 == 0 and first != _H264_SEI and 1 <= second <= 7 else "h264"


def is_key_frame(packet: VideoPacket) -> bool:
    """Whether decoding can begin with this packet: it has a picture coded without others, or parameter sets.

    H.264: IDR (5) or sequence parameter set (7). H.265: random access pictures (16 to 21), video or sequence parameter
    set (32, 33). Only units up to the first picture are looked at.
    """
    h264 = packet.format == "h264"
    for unit in re.finditer(b"\0\0\1(?=(.))", packet.data, re.DOTALL):
        kind = unit[1][0] & 31 if h264 else unit[1][0] >> 1 & 63
        if kind in ((5, 7) if h264 else (*range(16, 22), 32, 33)):
            return True
        if 1 <= kind < 5 if h264 else kind < 16:
            return False
    return False
