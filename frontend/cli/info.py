"""What an input is taken for, in words."""

from __future__ import annotations

from datetime import UTC, datetime

from airline.errors import InputError
from frontend.protocols import Source
from frontend.sources.wrapped import Peeked

_DATES_NS = 631_152_000 * 10**9, 4_102_444_800 * 10**9  # 1990 and 2100: between them a time is since 1970


def describe(source: Source) -> str:
    """Lines "what: value", after the first frame of a source has been read; "?" where nobody knows.

    Raises:
        InputError: the source has no frame.
    """
    first = Peeked(source).first
    if first is None:
        raise InputError(f"{source.name} yields no frame: check the input and --start, --end, --stride")
    height, width = first.image.shape[:2]
    begin_ns, end_ns, count = first.stamp_ns, source.last_stamp_ns, source.frame_count
    rate = None
    if count is not None and count > 1 and end_ns is not None and end_ns > begin_ns:
        rate = (count - 1) * 1e9 / (end_ns - begin_ns)
    grey, bits = "grey" if first.image.ndim == 2 else "colour", 8 * first.image.itemsize
    rows = {
        "kind": source.kind,
        "size": f"{width}x{height}, {grey}, {bits} bits",
        "frames": f"{count}" if count is not None else "live, no end" if source.live else "?",
        "first time": _time(begin_ns),
        "last time": "?" if end_ns is None else _time(end_ns),
        "rate": "?" if rate is None else f"{rate:.4g} frames/s",
        "orientation": source.orientation,
        "codec": source.codec or "?",
        "calibration": source.calibration or ("none" if first.camera is None else "the input's own"),
    }
    if (camera := first.camera) is not None:
        lens = "no distortion" if camera.distortion == "none" else camera.distortion
        rows["camera"] = f"fx {camera.fx:.6g}, fy {camera.fy:.6g}, cx {camera.cx:.6g}, cy {camera.cy:.6g} px, {lens}"
    lines = [f"{name + ':':<13}{value}" for name, value in rows.items()]
    return "\n".join([*lines, *(f"note: {note}" for note in source.notes)])


def _time(stamp_ns: int) -> str:
    seconds = f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} s"
    if not _DATES_NS[0] <= stamp_ns < _DATES_NS[1]:
        return seconds
    return f"{seconds} ({datetime.fromtimestamp(stamp_ns // 10**9, UTC):%Y-%m-%d %H:%M:%S} UTC)"
