"""The PL-VINS file, through an independent ROS 1 decoder and PL-VINS's own way of taking messages apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros1.decoder import DecoderFactory

from airline.errors import ConfigError, InputError
from logs.sinks import plvins
from logs.sinks.plvins import PlVinsTrackSink
from tests.helpers.made_tracks import FISHEYE, clip_results, made_tracks, write_all


def write(path, stream) -> None:
    write_all(PlVinsTrackSink(path), stream)


def read(path):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [(channel, schema, message, cloud) for schema, channel, message, cloud in reader.iter_decoded_messages()]


def lines_of(cloud) -> dict[int, tuple[float, float, float, float]]:
    """What the estimator makes of a message: start and end by number, as in its loop over the points."""
    lines = {}
    for i, point in enumerate(cloud.points):
        number = int(cloud.channels[0].values[i] + 0.5)
        assert number not in lines
        lines[number] = (point.x, point.y, cloud.channels[1].values[i], cloud.channels[2].values[i])
        assert point.z == 1
    return lines


def confirmed(*tracks):
    return [replace(one, states=np.ones(len(one), np.uint8)) for one in tracks]


def test_the_clip_arrives_as_it_was_tracked(tmp_path):
    stream = [result.tracks for result in clip_results()]
    write(tmp_path / "plvins.mcap", stream)
    found = read(tmp_path / "plvins.mcap")
    assert len(found) == len(stream)
    ids_of: dict[int, int] = {}
    for tracks, (channel, schema, message, cloud) in zip(stream, found, strict=True):
        assert (channel.topic, channel.message_encoding) == ("/linefeature_tracker/linefeature", "ros1")
        assert (schema.name, schema.encoding) == ("sensor_msgs/PointCloud", "ros1msg")
        assert message.log_time == message.publish_time == tracks.stamp_ns
        assert cloud.header.stamp.secs * 10**9 + cloud.header.stamp.nsecs == tracks.stamp_ns
        assert cloud.header.frame_id == "world"
        lines = lines_of(cloud)
        chosen = tracks.confirmed
        np.testing.assert_array_equal(
            np.array(list(lines.values()), np.float32).reshape(-1, 4), tracks.observed_normalized[chosen].reshape(-1, 4)
        )
        for number, track in zip(lines, tracks.ids[chosen].tolist(), strict=True):
            assert ids_of.setdefault(number, track) == track, "a number never changes its track"
    assert len(lines) > 50
    assert max(ids_of) == len(ids_of) - 1


def test_an_interrupted_track_goes_on_under_a_new_number(tmp_path):
    """PL-VINS takes the k-th observation of a number for that in the k-th frame from its first."""
    rng = np.random.default_rng(0)
    ids = [[2**40, 2**40 + 1], [2**40], [2**40, 2**40 + 1], [], [2**40]]
    stream = confirmed(*(made_tracks(k, k, np.array(some, np.int64), rng) for k, some in enumerate(ids)))
    write(tmp_path / "plvins.mcap", stream)
    assert [list(lines_of(cloud)) for *_, cloud in read(tmp_path / "plvins.mcap")] == [[0, 1], [0], [0, 2], [], [3]]


def test_tentative_tracks_and_lines_out_of_reach_are_left_out(tmp_path):
    (tracks,) = confirmed(made_tracks(0, 0, np.arange(4), np.random.default_rng(0), camera=FISHEYE))
    tracks.states[1] = 0
    tracks.observed_px[2, 1] = 1e5
    write(tmp_path / "plvins.mcap", [tracks])
    ((*_, cloud),) = read(tmp_path / "plvins.mcap")
    np.testing.assert_allclose(
        list(lines_of(cloud).values()), tracks.observed_normalized[[0, 3]].reshape(-1, 4), rtol=1e-6
    )


def test_numbers_stay_exact_in_float32(tmp_path, monkeypatch):
    monkeypatch.setattr(plvins, "_NUMBERS", 5)
    rng = np.random.default_rng(0)
    stream = confirmed(*(made_tracks(k, k, np.arange(3 * k, 3 * k + 3), rng) for k in range(4)))
    write(tmp_path / "plvins.mcap", stream)
    numbers = [list(lines_of(cloud)) for *_, cloud in read(tmp_path / "plvins.mcap")]
    assert numbers == [[0, 1, 2], [3, 4, 0], [1, 2, 3], [4, 0, 1]]


def test_without_a_camera_it_names_the_flag(tmp_path):
    with pytest.raises(ConfigError, match="--calib"):
        write(tmp_path / "p.mcap", [made_tracks(0, 0, np.arange(3), np.random.default_rng(0), camera=None)])


@pytest.mark.parametrize("stamp_ns", [-1, 2**32 * 10**9])
def test_times_that_ros_1_does_not_have(tmp_path, stamp_ns):
    with pytest.raises(InputError, match="ROS 1 has no time"):
        write(tmp_path / "p.mcap", [made_tracks(0, stamp_ns, np.arange(3), np.random.default_rng(0))])
