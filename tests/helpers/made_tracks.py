"""Tracks to write and read back: of the built-in clip, and made up."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
from hypothesis import strategies as st

from airline.lines import LineSet
from airline.scenes import RenderedClip
from airline.trace import Trace
from frontend import CameraModel, Frame, LineFrontend
from frontend.protocols import FrameResult, Sink
from frontend.sources.scene import SceneSource
from frontend.tracks import FIELDS, LineTracks

CAMERA = CameraModel(320, 240, 250.5, 251.25, 159.7, 119.9, "radial-tangential", np.array([-0.28, 0.07, 2e-4, 2e-5]))
PAIR = CameraModel(320, 240, 250.5, 251.25, 159.7, 119.9, baseline_m=0.11, disparity_offset=-1.25)
FISHEYE = CameraModel(320, 240, 200.0, 201.0, 160.1, 120.3, "equidistant", np.array([-0.01, 0.02, -0.01, 0.002]))


@cache
def clip_results() -> list[FrameResult]:
    """A dozen frames of the built-in clip, detected and tracked."""
    frontend = LineFrontend()
    clip = RenderedClip(kind="indoor", motion="handheld", seed=12, frames=12, size=(320, 240))
    return [frontend.process(frame) for frame in SceneSource(clip)]


def result_of(tracks: LineTracks) -> FrameResult:
    """A frame's result with these tracks, for sinks."""
    shape = (240, 320)
    lines = LineSet(tracks.observed_px, tracks.scores, tracks.descriptors)
    none = np.zeros((0, 2), np.int32)
    trace = Trace(
        np.zeros(shape, np.float32), none, none.astype(np.float32), tracks.descriptors[:0], none[:, 0], lines, {}
    )
    image = np.full(shape, tracks.frame_index % 251, np.uint8)
    return FrameResult(Frame(tracks.frame_index, tracks.stamp_ns, image, tracks.camera), trace, tracks, {})


def write_tracks(sink: Sink, results: Iterable[FrameResult]) -> None:
    """Give results to a sink, and close it."""
    for result in results:
        sink.write(result)
    sink.close()


def write_all(sink: Sink, stream: Iterable[LineTracks]) -> None:
    """Write the tracks of some frames, and close."""
    with closing(sink):
        for tracks in stream:
            sink.write(result_of(tracks))


def blank_tracks(count: int, *, frame_index: int = 0, stamp_ns: int = 0, **given: Any) -> LineTracks:
    """Tracks whose arrays are zero but for those given; ids 0, 1, ..., whole lines, descriptors of length 6."""
    arrays = {
        field.name: np.zeros((count, *(6 if n < 0 else n for n in field.shape)), field.dtype)
        for field in FIELDS
        if field.rows == "seen"
    }
    arrays |= {"ids": np.arange(count), "fragment_of": np.full(count, -1), **given}
    return LineTracks(frame_index, stamp_ns, **arrays)


def made_tracks(
    frame: int,
    stamp_ns: int,
    ids: np.ndarray,
    rng: np.random.Generator,
    *,
    lost: int = 0,
    ended: int = 0,
    points: int = 2,
    camera: CameraModel | None = CAMERA,
    reset: str | None = None,
    length: int = 6,
    right: bool = False,
) -> LineTracks:
    """Random tracks with these ids, in an image of 320 x 240 px; every field of the table has numbers.

    With a right image two of three tracks have a partner, most of them with a disparity that tells a depth.
    """
    counts = {"seen": len(ids), "right": len(ids) if right else 0, "lost": lost, "ended": ended, "points": points}
    arrays: dict[str, Any] = {}
    for field in FIELDS:
        shape = (counts[field.rows], *(length if n < 0 else n for n in field.shape))
        if field.dtype.kind == "f":
            values = rng.random(shape) * ((319, 239) if field.shape[-1:] == (2,) else 1)
        else:
            values = rng.integers(0, 2 if field.dtype.itemsize == 1 else np.iinfo(field.dtype).max, shape)
        arrays[field.name] = values.astype(field.dtype)
    arrays["ids"] = np.sort(np.asarray(ids, np.int64))
    for name in ("covariances", "observed_covariances"):
        arrays[name][:, 1, 0] = arrays[name][:, 0, 1]
    if right:
        arrays["observed_covariances"] *= 1e-6
        arrays["right_covariances"] = np.float32(1.25) * arrays["observed_covariances"]
        arrays["right_px"] = arrays["observed_px"] - np.float32([1, 0]) * rng.uniform(2, 40, (len(ids), 1, 1))
        arrays["right_px"] = arrays["right_px"].astype(np.float32)
        alone = np.arange(len(ids)) % 3 == 1
        arrays["right_px"][alone] = arrays["right_covariances"][alone] = np.nan
        arrays["right_hits"][alone] = arrays["right_measured"][alone] = 0
    arrays["line_indices"][arrays["measured"]] = -1
    arrays["fragment_of"][rng.random(len(ids)) < 0.8] = -1
    return LineTracks(frame, stamp_ns, **arrays, camera=camera, reset=reset)


@st.composite
def streams(draw: st.DrawFn) -> list[LineTracks]:
    """A few frames: empty ones, NaN and other odd numbers, large ids, lost and ended tracks, resets, other cameras.

    Some have a right image.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    frames = []
    index, stamp_ns = draw(st.integers(0, 2**40)), draw(st.integers(0, 2**62))
    for _ in range(draw(st.integers(0, 8))):
        ids = draw(st.sets(st.integers(0, 2**63 - 1), max_size=draw(st.sampled_from([0, 1, 40]))))
        tracks = made_tracks(
            *(index, stamp_ns, np.array(sorted(ids), np.int64), rng),
            lost=draw(st.integers(0, 3)),
            ended=draw(st.integers(0, 3)),
            points=draw(st.integers(0, 3)),
            camera=draw(st.sampled_from([CAMERA, PAIR, PAIR, FISHEYE, None])),
            reset=draw(st.none() | st.text(max_size=20)),
            length=draw(st.sampled_from([6, 6, 6, 1])),
            right=draw(st.booleans()),
        )
        odd = draw(st.lists(st.floats(width=32, allow_infinity=False), max_size=len(tracks)))
        places = (tracks.covariances[:, 0, 0], tracks.scores, tracks.segments_px[:, 1, 0], tracks.descriptors[:, 0])
        places += (tracks.observed_px[:, 0, 1], tracks.observed_covariances[:, 1, 1], tracks.right_px[:, 1, 0])
        for values in places:
            values[: len(odd)] = odd[: len(values)]
        frames.append(tracks)
        index += draw(st.integers(1, 1000))
        stamp_ns += draw(st.integers(1, 10**9))
    return frames


def assert_same(found: LineTracks, expected: LineTracks) -> None:
    """Every field that is written is the same: type, shape, and every number."""
    for field in (one for one in fields(expected) if one.compare):
        a, b = getattr(found, field.name), getattr(expected, field.name)
        assert type(a) is type(b), field.name
        if isinstance(b, np.ndarray):
            assert a.dtype == b.dtype, field.name
            np.testing.assert_array_equal(a, b, field.name, strict=True)
        elif isinstance(b, CameraModel):
            for part in fields(b):
                np.testing.assert_array_equal(getattr(a, part.name), getattr(b, part.name), part.name)
        else:
            assert a == b, field.name


def assert_all_same(found: list[LineTracks], expected: list[LineTracks]) -> None:
    """The same frames in the same order."""
    assert [tracks.frame_index for tracks in found] == [tracks.frame_index for tracks in expected]
    for a, b in zip(found, expected, strict=True):
        assert_same(a, b)
