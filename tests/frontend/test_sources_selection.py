"""A part of a stream, compared with slicing a list."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airline.errors import ConfigError
from frontend.camera.model import CameraModel
from frontend.frame import Frame
from frontend.sources.wrapped import Peeked, SelectedFrames
from tests.helpers.sources import Listed, Seekable


def frames_at(stamps: list[int]) -> list[Frame]:
    image = np.zeros((40, 60), np.uint8)
    return [Frame(number, stamp, image) for number, stamp in enumerate(stamps)]


@given(
    steps=st.lists(st.integers(1, 40).map(lambda step: step * 10_000_000 + step % 2), max_size=30),
    first=st.integers(0, 2**60),
    kind=st.sampled_from([Listed, Seekable]),
    start=st.none() | st.integers(0, 40),
    length=st.none() | st.integers(1, 40),
    stride=st.integers(1, 7),
    most=st.none() | st.integers(1, 12),
    endless=st.booleans(),
)
def test_equals_list_slicing(steps, first, kind, start, length, stride, most, endless):
    frames = frames_at(list(np.cumsum([first, *steps])))
    start_s = None if start is None else start / 10
    end_s = None if length is None else ((start or 0) + length) / 10
    after = [f for f in frames if start is None or f.stamp_ns - first >= start * 100_000_000]
    between = [f for f in after if length is None or f.stamp_ns - first < ((start or 0) + length) * 100_000_000]
    expected = between[::stride][:most]

    selection = SelectedFrames(kind(frames, endless), start_s=start_s, end_s=end_s, stride=stride, max_frames=most)
    bound = selection.frame_count
    assert list(selection) == expected
    assert bound is None if endless and most is None else bound is not None and bound >= len(expected)
    if not endless and start is None and length is None:
        assert bound == len(expected)


def test_takes_no_more_than_needed_and_passes_the_rest_on() -> None:
    source = Listed(frames_at(list(range(100))), endless=True, skipped=2)
    selection = SelectedFrames(source, stride=10, max_frames=3)
    assert selection.frame_count == 3
    assert [frame.index for frame in selection] == [0, 10, 20]
    assert source.read == 21
    assert (selection.name, selection.skipped, selection.dropped, selection.live) == ("listed", 2, 0, False)
    selection.close()
    assert source.closed


@pytest.mark.parametrize(
    ("start_s", "missing", "kept"), [(None, [0, 3], [2, 4, 6, 8]), (None, [2], [0, 4, 6, 8]), (3, [4, 5], [3, 7, 9])]
)
def test_a_frame_that_cannot_be_read_moves_no_other(start_s: int | None, missing: list[int], kept: list[int]) -> None:
    source = Listed([frame for frame in frames_at([k * 10**9 for k in range(10)]) if frame.index not in missing])
    assert [frame.index for frame in SelectedFrames(source, start_s=start_s, stride=2)] == kept


def test_the_first_frame_can_be_looked_at() -> None:
    frames = frames_at([1, 2, 3])
    source = Listed(frames)
    peeked = Peeked(source)
    assert (peeked.first, source.read) == (frames[0], 1)
    assert list(peeked) == frames
    assert Peeked(Listed([])).first is None
    assert list(Peeked(Listed([]))) == []


def test_a_seekable_source_is_not_read_from_the_start() -> None:
    source = Seekable(frames_at([second * 10**9 for second in range(100)]))
    assert [frame.index for frame in SelectedFrames(source, start_s=90, end_s=92)] == [90, 91]
    assert source.read == 3


@pytest.mark.parametrize(
    ("resize", "shape"), [((32, 16), (16, 32)), ((32, None), (21, 32)), ((120, None), (80, 120)), ((60, 40), (40, 60))]
)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_resize(resize: tuple[int, int | None], shape: tuple[int, int], dtype: type, channels: tuple[int, ...]) -> None:
    image = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (40, 60, *channels), dtype)
    camera = CameraModel(60, 40, 50.0, 50.0, 29.5, 19.5)
    frame = Frame(4, 7, image, camera)
    (resized,) = SelectedFrames(Listed([frame]), resize=resize)
    assert resized.image.shape == (*shape, *channels)
    assert resized.image.dtype == dtype
    assert resized.image.flags.c_contiguous
    assert (resized.index, resized.stamp_ns) == (4, 7)
    assert resized.image.mean() == pytest.approx(image.mean(), rel=0.02)
    assert resized.camera is not None
    assert (resized.camera.height, resized.camera.width) == shape
    assert resized.camera.cx == pytest.approx((shape[1] - 1) / 2)  # the image's centre stays its centre
    (bare,) = SelectedFrames(Listed([Frame(0, 0, image)]), resize=resize)
    assert bare.camera is None


NAN, INF = float("nan"), float("inf")
WRONG = {
    "start_s": [-1.0, NAN, INF],
    "end_s": [0.0, NAN, INF],
    "stride": [0, -3],
    "max_frames": [0],
    "resize": [(15, 100), (100, 0), (10**9, None)],
}


@pytest.mark.parametrize("name", WRONG)
def test_impossible_values(name: str) -> None:
    for value in WRONG[name]:
        source = Listed([])
        with pytest.raises(ConfigError):
            SelectedFrames(source, **{name: value})  # type: ignore[arg-type]
        assert source.closed
    with pytest.raises(ConfigError):
        SelectedFrames(Listed([]), start_s=2.0, end_s=2.0)
