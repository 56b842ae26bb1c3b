"""What an input is taken for, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

from airline import __version__
from airline.errors import InputError
from airline.network.weights import sha256_of
from frontend.cli.settings import NO_CALIBRATION, RunConfig, dump
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.kinds import without_password
from frontend.sources.wrapped import Peeked

Properties = dict[str, str | list[str] | list[int] | list[float]]

_DATES_NS = 631_152_000 * 10**9, 4_102_444_800 * 10**9  # 1990 and 2100: between them a time is since 1970


def describe(source: Source) -> str:
    """Lines "what: value", after the first frame of a source has been read; "?" where nobody knows.

    Raises:
        InputError: the source has no frame.
    """
    peeked = Peeked(source)  # to be kept: a source may close with its iteration
    first = peeked.first
    if first is None:
        raise InputError(f"{source.name} yields no frame: check the input and --start, --end, --stride")
    end_ns, rate = source.last_stamp_ns, _rate_hz(source, first)
    rows = {
        "kind": source.kind,
        "size": _size(first),
        "frames": _count(source) or ("live, no end" if source.live else "?"),
        "first time": _time(first.stamp_ns),
        "last time": "?" if end_ns is None else _time(end_ns),
        "rate": "?" if rate is None else f"{rate:.4g} frames/s",
        "orientation": source.orientation,
        "codec": source.codec or "?",
        "calibration": _calibration(source, first),
    }
    if (camera := first.camera) is not None:
        lens = "no distortion" if camera.distortion == "none" else camera.distortion
        rows["camera"] = f"fx {camera.fx:.6g}, fy {camera.fy:.6g}, cx {camera.cx:.6g}, cy {camera.cy:.6g} px, {lens}"
    return _lines(rows | _pair(first), source.notes)


def introduce(source: Source, first: Frame, notes: Sequence[str], results: Sequence[str], *, found: bool) -> str:
    """What a run begins with: its input, the camera or what it costs to have none, its results, what was guessed.

    `found` says that the calibration was looked for, and not given.
    """
    count, rate = _count(source), _rate_hz(source, first)
    known = source.kind, _size(first), f"{count} frames" if count else "", f"{rate:.4g} frames/s" if rate else ""
    calibration = _calibration(source, first)
    if first.camera is None:
        calibration += ", so lines are in pixels alone: --calib FILE gives one"
    elif source.calibration is not None and found:
        calibration += f"; --calib {NO_CALIBRATION} leaves it out"
    rows = {"input": ", ".join(filter(None, known)), "calibration": calibration}
    return _lines(rows | _pair(first), notes, results)


def properties(spec: str | None, source: Source, first: Frame, config: RunConfig, notes: Sequence[str]) -> Properties:
    """The facts of a run that recordings are chosen by, by name; those that nobody knows are missing."""
    height, width = first.image.shape[:2]
    facts: Properties = {
        "version": __version__,
        "input": "built-in clip" if spec is None else without_password(spec),
        "kind": source.kind,
        "size": [width, height],
        "calibration": _calibration(source, first),
        "preset": config.preset,
        "settings": dump(config),
    }
    if (edges := config.detector.edges).detector == "unet":
        facts |= {"weights": edges.weights, "weights_sha256": sha256_of(edges.weights)}
    if notes:
        facts["notes"] = list(notes)
    if (camera := first.camera) is not None:
        facts["camera"] = [camera.fx, camera.fy, camera.cx, camera.cy]
        facts["distortion"] = camera.distortion
        if len(camera.coefficients):
            facts["distortion_coefficients"] = camera.coefficients.tolist()
    return facts


def _lines(rows: Mapping[str, str], notes: Sequence[str], results: Sequence[str] = ()) -> str:
    pairs = [*rows.items(), *(("writing", result) for result in results)]
    return "\n".join([*(f"{name + ':':<12} {value}" for name, value in pairs), *(f"note: {note}" for note in notes)])


def _pair(first: Frame) -> dict[str, str]:
    if first.right is None:
        return {}
    baseline = 0.0 if first.camera is None else first.camera.baseline_m
    return {"stereo": f"baseline {baseline:.4g} m" if baseline else "no baseline is known, so there are no metres"}


def _calibration(source: Source, first: Frame) -> str:
    return source.calibration or ("none" if first.camera is None else "from the input itself")


def _size(frame: Frame) -> str:
    height, width = frame.image.shape[:2]
    return f"{width}x{height} {'grey' if frame.image.ndim == 2 else 'colour'}, {8 * frame.image.itemsize} bits"


def _count(source: Source) -> str:
    """How many frames there are; where nobody knows when the last is, that is a bound."""
    if source.frame_count is None:
        return ""
    return f"{'at most ' if source.last_stamp_ns is None else ''}{source.frame_count}"


def _rate_hz(source: Source, first: Frame) -> float | None:
    count, end_ns = source.frame_count, source.last_stamp_ns
    if count is None or count < 2 or end_ns is None or end_ns <= first.stamp_ns:
        return None
    return (count - 1) * 1e9 / (end_ns - first.stamp_ns)


def _time(stamp_ns: int) -> str:
    seconds = f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} s"
    if not _DATES_NS[0] <= stamp_ns < _DATES_NS[1]:
        return seconds
    return f"{seconds} ({datetime.fromtimestamp(stamp_ns // 10**9, UTC):%Y-%m-%d %H:%M:%S} UTC)"
