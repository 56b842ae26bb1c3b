"""Messages of the live protocol: whole ones come back exactly, all others are refused in one clear error."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airline.errors import InputError
from frontend.fields import Field
from frontend.tracks import DERIVED, LineTracks
from logs.tracks.message import ARRAYS, MAX_BYTES, LiveTracks, decode, encode
from tests.helpers.made_tracks import PAIR, assert_same, clip_results, made_tracks, result_of

ENVELOPE = {"stream": 17, "sequence": 3, "name": "clip", "sent_ns": 2**62}
TRACKS = made_tracks(7, 8, np.array([3, 5, 2**40]), np.random.default_rng(0), lost=2, ended=1, reset="a scene cut")


def encoded(tracks: LineTracks = TRACKS) -> bytes:
    return encode(result_of(tracks), **ENVELOPE)


def unpacked(**changes: Any) -> dict[str, Any]:
    """The message as a receiver in another language sees it."""
    return {**msgspec.msgpack.decode(encoded()), **changes}


def with_array(name: str, **changes: Any) -> dict[str, Any]:
    message = unpacked()
    message["arrays"][name].update(changes)
    return message


def test_a_message_says_where_it_is_from() -> None:
    message = decode(encoded())
    assert (message.stream, message.sequence, message.name, message.sent_ns) == tuple(ENVELOPE.values())
    assert (message.image_size, message.stride) == ((320, 240), 1)
    assert decode(encode(result_of(TRACKS), **ENVELOPE, stride=3)).stride == 3
    assert message.tracks is not None
    message.tracks.segments_px[:] = 0  # it is the receiver's own


def test_arrays_are_what_the_page_says() -> None:
    """By numpy alone, as in the example."""
    tracks = clip_results()[5].tracks
    arrays = msgspec.msgpack.decode(encoded(tracks))["arrays"]
    assert list(arrays) == [field.name for field in ARRAYS]
    for name, array in arrays.items():
        values = np.frombuffer(array["data"], array["dtype"]).reshape(array["shape"])
        np.testing.assert_array_equal(values, getattr(tracks, name))


@pytest.mark.parametrize("field", DERIVED, ids=lambda field: field.name)
def test_what_is_derived_is_nan_without_a_camera(field: Field) -> None:
    """Of lines in space there is a number for each with a depth; disparities need no camera."""
    for camera in (PAIR, None):
        tracks = made_tracks(0, 0, np.arange(99), np.random.default_rng(0), points=4, camera=camera, right=True)
        tracks = tracks.take(np.flatnonzero(tracks.depth_known)[:4])
        message = msgspec.msgpack.decode(encoded(tracks))
        assert (message["camera"] is None) == (camera is None)
        array = message["arrays"][field.name]
        numbers = np.frombuffer(array["data"], array["dtype"]).reshape(4, *field.shape)
        needs_camera = field.rows != "right" or field.name.startswith("segments_m")
        assert (np.isnan(numbers) == (camera is None and needs_camera)).all()


def test_of_programs_before_strides_every_frame_is_taken() -> None:
    message = unpacked(stride=2)
    assert decode(msgspec.msgpack.encode(message)).stride == 2
    del message["stride"]
    assert decode(msgspec.msgpack.encode(message)).stride == 1


def test_the_end() -> None:
    assert decode(encode(None, **ENVELOPE)) == LiveTracks(17, 3, "clip", 2**62)


def test_a_name_that_is_no_text_is_sent_readably() -> None:
    assert decode(encode(None, **{**ENVELOPE, "name": "a\udcffb"})).name == "a?b"


@given(st.binary(max_size=100) | st.builds(lambda n: encoded()[:n], st.integers(0, len(encoded()) - 1)))
def test_what_is_no_message_or_was_cut_is_refused(data: bytes) -> None:
    with pytest.raises(InputError, match="not a valid message"):
        decode(data)


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        (unpacked(version=2, arrays="something new"), "version 2 .* version 1"),
        (unpacked(type="noise"), "noise"),
        (unpacked(stamp_ns=2**63), "stamp_ns"),
        (unpacked(stride=0), "stride"),
        (unpacked(arrays={}), "'ids' is missing"),
        (unpacked(camera={"width": 1}), "camera"),
        (unpacked(camera={**unpacked()["camera"], "fx": 0.0}), "focal lengths"),
        (unpacked(camera={**unpacked()["camera"], "coefficients": [0.0] * 3}), "coefficients"),
        (with_array("ids", dtype="<i4"), "'ids': it is <i4"),
        (with_array("ids", shape=[]), "'ids': it is <i8"),
        (with_array("ids", data=bytes(8)), "'ids': it has 8 bytes"),
        (with_array("ids", shape=[2**31 - 1]), "'ids': it has 24 bytes"),
        (with_array("scores", shape=[4], data=bytes(16)), r"'scores': it is <f4 \[4\], not <f4 \[3\]"),
        (with_array("segments_px", shape=[3, 4]), "'segments_px': it is"),
        (with_array("descriptors", shape=[3, 2**31 - 1]), "'descriptors': it has"),
        (with_array("right_hits", shape=[2], data=bytes(8)), "'right_px': it is|only some of its tracks"),
        (with_array("states", data=b"\0\1\2"), "unknown state"),
        (with_array("lost_segments_px", shape=[1, 2, 2], data=bytes(16)), "'lost_segments_px'"),
        (with_array("ended_ids", shape=[-1]), ">= 0"),
    ],
)
def test_parts_that_do_not_fit_are_named(message: dict[str, Any], complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        decode(msgspec.msgpack.encode(message))


def test_fields_of_later_programs_are_passed_over() -> None:
    message = unpacked(colour="red")
    message["arrays"]["of_a_later_version"] = {"dtype": "<f8", "shape": [3], "data": bytes(24), "unit": "px"}
    found = decode(msgspec.msgpack.encode(message)).tracks
    assert found is not None
    assert_same(found, TRACKS)


@pytest.mark.parametrize(
    "data", [b"\xdd\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff", b"\x91" * 100_000, bytes(MAX_BYTES + 1)]
)
def test_claims_of_size_and_depth_cost_nothing(data: bytes) -> None:
    with pytest.raises(InputError, match="not a valid message"):
        decode(data)
