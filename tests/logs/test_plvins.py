"""PL-VINS's messages, through independent readers of ROS 1, and PL-VINS's own way of taking them."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from airline.errors import ConfigError, InputError
from frontend.tracks import LineTracks
from logs.files import open_log
from logs.sinks import output, plvins
from logs.sinks.open import open_track_sink
from logs.tracks.message import encode
from tests.helpers.made_tracks import FISHEYE, clip_results, made_tracks, result_of, write_all
from tests.helpers.plvins import (
    ROS1,
    TOPIC,
    Clouds,
    clouds_of,
    has_rosbag,
    landmarks,
    published,
    read_bag,
    read_mcap,
    read_rosbag,
)
from tests.helpers.ros2 import load_node

FORMATS = [
    ("plvins.mcap", read_mcap),
    ("lines.bag", read_bag),
    pytest.param("lines.bag", read_rosbag, marks=has_rosbag),
]
in_every_format = pytest.mark.parametrize(("name", "read"), FORMATS)
EPOCH_NS = 1_403_636_579_763_555_584


def written(path: Path, stream: list[LineTracks], read: Callable[[Path], Clouds], stride: int = 1) -> Clouds:
    write_all(open_track_sink(str(path), stride=stride), stream)
    return read(path)


def confirmed(*tracks: LineTracks) -> list[LineTracks]:
    return [replace(one, states=np.ones(len(one), np.uint8)) for one in tracks]


def drive(indices: list[int], stamps_ns: list[int]) -> list[LineTracks]:
    """Frames in which each of forty tracks is seen for a while, lost for a while, and seen again."""
    rng = np.random.default_rng(0)
    seen = (np.arange(40)[:, None] + 3 * np.arange(indices[-1] + 1)) % 50 < 35
    return confirmed(*(made_tracks(k, stamps_ns[k], np.flatnonzero(seen[:, k]), rng) for k in indices))


@in_every_format
def test_the_clip_arrives_as_it_was_tracked(tmp_path, name, read):
    stream = [result.tracks for result in clip_results()]
    found = written(tmp_path / name, stream, read)
    ids_of: dict[int, int] = {}
    for tracks, (stamp_ns, lines) in zip(stream[1:], found, strict=True):
        assert stamp_ns == tracks.stamp_ns
        chosen = tracks.confirmed
        observed = tracks.observed_normalized[chosen].reshape(-1, 4)
        np.testing.assert_array_equal(np.array(list(lines.values()), np.float32).reshape(-1, 4), observed)
        for number, track in zip(lines, tracks.ids[chosen].tolist(), strict=True):
            assert ids_of.setdefault(number, track) == track, "a number never changes its track"
    assert len(lines) > 50
    assert (observed != tracks.segments_normalized[chosen].reshape(-1, 4)).any(1).mean() > 0.9, "fused lines are others"
    assert max(ids_of) == len(ids_of) - 1


JITTER_NS = 4_000_000
RATES = [(10, 0, 1), (20, 0, 1), (30, 0, 1), (20, 10, 2), (30, 15, 2), (30, 10, 3)]
MISSING = {
    "all": [],
    "some missing": [5, 12, 13],
    "the first missing": [0],
    "some missing behind the first": [1, 2, 3],
    "a live camera, which warms up": list(range(1, 15)),
    "late": list(range(15)),
    "every second missing": list(range(1, 61, 2)),
}


CASES = [*((rate, "some missing") for rate in RATES), *((rate, one) for rate in RATES[-2:] for one in MISSING)]


@pytest.mark.parametrize(("rates", "which"), dict.fromkeys(CASES))
@pytest.mark.parametrize("route", ["lines.bag", "node"])
def test_every_line_meets_the_points_of_its_own_frame(route, rates, which, tmp_path, monkeypatch):
    """Points that PL-VINS's tracker makes of all images, with the lines that we make of those that we got."""
    (rate, freq, stride), missing = rates, MISSING[which]
    jitter_ns = JITTER_NS if freq == 0 else JITTER_NS // 10  # a camera's stamps are not even
    shifts_ns = np.random.default_rng(0).integers(-jitter_ns, jitter_ns, 91).tolist()
    stamps_ns = [EPOCH_NS + k * 10**9 // rate + shift_ns for k, shift_ns in enumerate(shifts_ns)]
    stream = drive([k for k in range(0, 91, stride) if k // stride not in missing], stamps_ns)
    if route == "node":
        clouds = sent_by(load_node(monkeypatch), stream, stride)
    else:
        clouds = written(tmp_path / route, stream, read_bag, stride)

    points = [k for k in published(stamps_ns, freq) if k <= stream[-1].frame_index]
    frames = {tracks.frame_index: tracks for tracks in stream}
    assert points == [k * stride for k in range(1, len(clouds) + 1)], "as many as there are clouds, none of the first"
    for index, (stamp_ns, lines) in zip(points, clouds, strict=True):
        assert (stamp_ns == stamps_ns[index]) == (index in frames)
        assert len(lines) == (len(frames[index]) if index in frames else 0)
    assert all(before < after for (before, _), (after, _) in pairwise(clouds))
    found = landmarks(lines for _, lines in clouds)
    assert len(found) > 60
    for first, observations in found:
        whose = set()
        for position, line in enumerate(observations, first):
            tracks = frames[points[position]]
            (row,) = np.flatnonzero((tracks.observed_normalized.reshape(-1, 4) == line).all(1))
            whose.add(int(tracks.ids[row]))
        assert len(whose) == 1


@pytest.mark.parametrize(("rate", "freq"), [(20, 10), (30, 20)])
def test_a_tracker_that_leaves_out_frames_is_no_match(rate, freq):
    """Why the page says `freq: 0`."""
    assert published([EPOCH_NS + k * 10**9 // rate for k in range(30)], freq)[:3] != [1, 2, 3]


def sent_by(node, stream: list[LineTracks], stride: int = 1) -> Clouds:
    """What the ROS 2 node publishes for these frames."""
    lines = node["PlVinsClouds"]()
    clouds = []
    for tracks in stream:
        data = encode(result_of(tracks), stream=1, sequence=0, name="", sent_ns=0, stride=stride)
        clouds += lines.of_frame(node["frame_of"](data))[0]
    return clouds_of(clouds)


@in_every_format
def test_before_a_first_frame_at_time_zero_stamps_repeat_and_the_order_is_kept(tmp_path, name, read, monkeypatch):
    """A video's time begins with its first frame that can be read, and ROS has none before 1970."""
    stream = drive([3, 5], [0, 0, 0, 0, 0, 5])
    clouds = written(tmp_path / name, stream, read)
    assert [stamp_ns for stamp_ns, _ in clouds] == [0, 0, 0, 2, 5]
    assert [len(lines) for _, lines in clouds] == [0, 0, len(stream[0]), 0, len(stream[1])]
    assert sent_by(load_node(monkeypatch), stream) == clouds


def test_a_number_that_comes_again_has_no_second_message(tmp_path):
    stream = drive([0, 1, 2], [0, 1, 2])
    assert written(tmp_path / "a.bag", [*stream[:2], *stream[1:]], read_bag) == written(
        tmp_path / "b.bag", stream, read_bag
    )


def test_too_many_missing_images_are_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr(plvins, "MOST_MISSING", 1000)  # the node's
    rng = np.random.default_rng(0)
    for first in ([], [made_tracks(0, 0, np.arange(3), rng)]):
        enough, many, absurd = (made_tracks(k, 10**9, np.arange(3), rng) for k in (1001, 1002, 2**63 - 1))
        node = load_node(monkeypatch)
        assert len(written(tmp_path / f"{len(first)}.bag", [*first, enough], read_bag)) == 1001
        assert len(sent_by(node, [*first, enough])) == 1001
        for tracks in (many, absurd):
            with pytest.raises(InputError, match=f"{tracks.frame_index - 1} images are missing"):
                written(tmp_path / "many.bag", [*first, tracks], read_bag)
            with pytest.raises(SystemExit, match=f"{tracks.frame_index - 1} images are missing"):
                sent_by(node, [*first, tracks])
            (tmp_path / "many.bag").unlink()


def test_a_frame_between_those_that_pl_vins_publishes_is_an_error(tmp_path, monkeypatch):
    stream = drive([3, 5, 7], list(range(8)))
    with pytest.raises(ConfigError, match=r"frame 3 .*--start"):
        written(tmp_path / "lines.bag", stream, read_bag, stride=2)
    with pytest.raises(SystemExit, match=r"frame 3 .*--start"):
        sent_by(load_node(monkeypatch), stream, stride=2)


@in_every_format
def test_an_interrupted_track_goes_on_under_a_new_number(tmp_path, name, read):
    """PL-VINS takes the k-th observation of a number for that in the k-th message from its first."""
    rng = np.random.default_rng(0)
    ids = [[2**40, 2**40 + 1], [2**40, 2**40 + 1], [2**40], [2**40, 2**40 + 1], [], [2**40]]
    stream = confirmed(*(made_tracks(k, k, np.array(some, np.int64), rng) for k, some in enumerate(ids)))
    clouds = written(tmp_path / name, stream, read)
    assert [list(lines) for _, lines in clouds] == [[0, 1], [0], [0, 2], [], [3]]


def test_tentative_tracks_and_lines_out_of_reach_are_left_out(tmp_path):
    rng = np.random.default_rng(0)
    first, tracks = confirmed(*(made_tracks(k, k, np.arange(4), rng, camera=FISHEYE) for k in range(2)))
    tracks.states[1] = 0
    tracks.observed_px[2, 1] = 1e5
    ((_, lines),) = written(tmp_path / "lines.bag", [first, tracks], read_bag)
    np.testing.assert_allclose(list(lines.values()), tracks.observed_normalized[[0, 3]].reshape(-1, 4), rtol=1e-6)


def test_numbers_stay_exact_in_float32(tmp_path, monkeypatch):
    monkeypatch.setattr(plvins, "_NUMBERS", 5)
    rng = np.random.default_rng(0)
    stream = confirmed(*(made_tracks(k, k, np.arange(3 * k, 3 * k + 3), rng) for k in range(5)))
    numbers = [list(lines) for _, lines in written(tmp_path / "lines.bag", stream, read_bag)]
    assert numbers == [[0, 1, 2], [3, 4, 0], [1, 2, 3], [4, 0, 1]]


@pytest.mark.parametrize("name", ["plvins.mcap", "lines.bag"])
def test_without_a_camera_it_names_the_flag(tmp_path, name):
    with pytest.raises(ConfigError, match="--calib"):
        written(tmp_path / name, [made_tracks(0, 0, np.arange(3), np.random.default_rng(0), camera=None)], read_bag)


@pytest.mark.parametrize("stamp_ns", [-1, 2**32 * 10**9])
def test_times_that_ros_1_does_not_have(tmp_path, stamp_ns):
    with pytest.raises(InputError, match="ROS 1 has no time"):
        written(tmp_path / "p.bag", [made_tracks(0, stamp_ns, np.arange(3), np.random.default_rng(0))], read_bag)


@has_rosbag
@pytest.mark.parametrize("frames", [0, 1, 2])
def test_the_shortest_bags_can_be_played(tmp_path, frames, monkeypatch):
    monkeypatch.setattr(output, "FLUSH_S", 0.0)
    stream = drive(list(range(3)), [EPOCH_NS + k for k in range(3)])[:frames]
    assert len(written(tmp_path / "lines.bag", stream, read_rosbag)) == max(0, frames - 1)


@has_rosbag
def test_what_a_killed_run_leaves_is_whole_when_ros_has_reindexed_it(tmp_path, monkeypatch):
    monkeypatch.setattr(output, "FLUSH_S", 0.0)
    stream = drive(list(range(30)), [EPOCH_NS + k * 10**8 for k in range(30)])
    sink, path = open_track_sink(str(tmp_path / "lines.bag")), tmp_path / "killed.bag"
    sizes = []
    for tracks in stream:
        sink.write(result_of(tracks))
        sizes.append((tmp_path / "lines.bag").stat().st_size)
    left = (tmp_path / "lines.bag").read_bytes()
    sink.close()
    whole = read_rosbag(tmp_path / "lines.bag")
    assert len(whole) == 29
    for size in [sizes[1], sizes[20] - 10, sizes[20] + 300, len(left)]:
        path.write_bytes(left[:size])
        count = sum(end <= size for end in sizes[1:])
        with closing(open_log(path)) as log:
            found = log.topics[TOPIC].count if TOPIC in log.topics else 0
            assert found in (count, count + 1), "readable as it is, a cut chunk too"
        done = subprocess.run([*ROS1, shutil.which("rosbag"), "reindex", "-q", "-f", path], capture_output=True)
        assert (done.returncode, done.stderr) == (0, b"")
        assert read_rosbag(path) == read_bag(path) == whole[:count]
        with closing(open_log(path)) as log:
            assert log.topics[TOPIC].count == count


@has_rosbag
def test_ros_adds_to_a_bag_of_ours(tmp_path):
    stream = drive(list(range(5)), [EPOCH_NS + k * 10**8 for k in range(5)])
    before = written(tmp_path / "lines.bag", stream, read_rosbag)
    add = """
import sys, rosbag
with rosbag.Bag(sys.argv[1], "a") as bag:
    topic, cloud, time = next(bag.read_messages())
    bag.write(topic, cloud, time)
"""
    subprocess.run([*ROS1, "-c", add, tmp_path / "lines.bag"], check=True)
    assert read_rosbag(tmp_path / "lines.bag") == [before[0], *before]
