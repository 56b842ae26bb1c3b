"""Tracks to write and read back: of the built-in clip, and made up."""

from __future__ import annotations

from dataclasses import fields
from functools import cache

import numpy as np
from hypothesis import strategies as st

from airline.lines import LineSet
from airline.scenes import RenderedClip
from airline.trace import Trace
from frontend import CameraModel, Frame, LineFrontend
from frontend.protocols import FrameResult
from frontend.sources.scene import SceneSource
from frontend.tracks import LineTracks

CAMERA = CameraModel(320, 240, 250.5, 251.25, 159.7, 119.9, "radial-tangential", np.array([-0.28, 0.07, 2e-4, 2e-5]))
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


def made_tracks(
    frame: int,
    stamp_ns: int,
    ids: np.ndarray,
    rng: np.random.Generator,
    *,
    lost: int = 0,
    ended: int = 0,
    camera: CameraModel | None = CAMERA,
    reset: str | None = None,
    length: int = 6,
) -> LineTracks:
    """Random tracks with these ids, in an image of 320 x 240 px."""
    ids = np.sort(np.asarray(ids, np.int64))
    n = len(ids)

    def segments(count: int) -> np.ndarray:
        return (rng.random((count, 2, 2)) * (319, 239)).astype(np.float32)

    root = rng.normal(size=(n, 2, 2))
    covariances = (root @ root.transpose(0, 2, 1)).astype(np.float32)
    covariances[:, 1, 0] = covariances[:, 0, 1]
    descriptors = rng.normal(size=(n, length)).astype(np.float32)
    return LineTracks(
        frame_index=frame,
        stamp_ns=stamp_ns,
        ids=ids,
        segments_px=segments(n),
        observed_px=segments(n),
        covariances=covariances,
        scores=rng.random(n).astype(np.float32),
        descriptors=descriptors,
        states=rng.integers(0, 2, n).astype(np.uint8),
        ages=rng.integers(0, 2**31 - 1, n).astype(np.int32),
        hits=rng.integers(0, 2**31 - 1, n).astype(np.int32),
        line_indices=rng.permutation(n).astype(np.int32),
        fragment_of=np.where(rng.random(n) < 0.2, rng.integers(0, 2**62, n), -1),
        lost_ids=np.sort(rng.integers(0, 2**62, lost)),
        lost_segments_px=segments(lost),
        ended_ids=np.sort(rng.integers(0, 2**62, ended)),
        camera=camera,
        reset=reset,
    )


@st.composite
def streams(draw: st.DrawFn) -> list[LineTracks]:
    """A few frames: empty ones, NaN and other odd numbers, large ids, lost and ended tracks, resets, other cameras."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    frames = []
    index, stamp_ns = draw(st.integers(0, 2**40)), draw(st.integers(0, 2**62))
    for _ in range(draw(st.integers(0, 8))):
        ids = draw(st.sets(st.integers(0, 2**63 - 1), max_size=draw(st.sampled_from([0, 1, 40]))))
        tracks = made_tracks(
            *(index, stamp_ns, np.array(sorted(ids), np.int64), rng),
            lost=draw(st.integers(0, 3)),
            ended=draw(st.integers(0, 3)),
            camera=draw(st.sampled_from([CAMERA, CAMERA, FISHEYE, None])),
            reset=draw(st.none() | st.text(max_size=20)),
            length=draw(st.sampled_from([6, 6, 6, 1])),
        )
        odd = draw(st.lists(st.floats(width=32, allow_infinity=False), max_size=len(tracks)))
        for values in (
            tracks.covariances[:, 0, 0],
            tracks.scores,
            tracks.segments_px[:, 1, 0],
            tracks.descriptors[:, 0],
        ):
            values[: len(odd)] = odd
        frames.append(tracks)
        index += draw(st.integers(1, 1000))
        stamp_ns += draw(st.integers(1, 10**9))
    return frames


def assert_same(found: LineTracks, expected: LineTracks) -> None:
    """Every field is the same: type, shape, and every number."""
    for field in fields(LineTracks):
        a, b = getattr(found, field.name), getattr(expected, field.name)
        if isinstance(b, np.ndarray):
            assert (a.dtype, a.shape) == (b.dtype, b.shape), field.name
            np.testing.assert_array_equal(a, b, err_msg=field.name)
        elif field.name == "camera" and b is not None:
            for part in fields(CameraModel):
                np.testing.assert_array_equal(getattr(a, part.name), getattr(b, part.name), err_msg=part.name)
        else:
            assert (type(a), a) == (type(b), b), field.name


def assert_all_same(found: list[LineTracks], expected: list[LineTracks]) -> None:
    """The same frames in the same order."""
    assert [tracks.frame_index for tracks in found] == [tracks.frame_index for tracks in expected]
    for a, b in zip(found, expected, strict=True):
        assert_same(a, b)
