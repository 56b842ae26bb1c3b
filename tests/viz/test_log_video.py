"""`--log-image video` for logs: their packets in the recording, none encoded again, each at its own frame."""

from __future__ import annotations

import pytest

from tests.helpers.camera_logs import write_log
from tests.helpers.command import command, recorded, refusal
from tests.helpers.log_pictures import logged, number_in, numbered, raw, stamp, video_log, x264, x265
from viz.recording import Recording

FRAMES, LONG = 30, 60
ENCODERS = {"h264": x264, "h265": x265}


def record(log, path, *flags):
    outcome = command(log, "--headless", "--log-image", "video", "--save", path, "--preset", "fast", *flags)
    assert outcome.code == 0, outcome.err
    return recorded(path)["/camera/image"]


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_packets_are_logged_as_they_are_at_their_frames(tmp_path, codec):
    packets = ENCODERS[codec](FRAMES, "bframes=0")
    log = video_log(tmp_path / "log.mcap", packets, codec, rising=True)
    image = record(log, tmp_path / "run.rrd")
    assert [bytes(row[0]) for row in image["VideoStream:sample"] if row] == [data for _, data in packets]
    assert image["frame"] == list(range(FRAMES))
    assert image["sensor_time"] == [stamp(k) for k in range(FRAMES)]
    shown = [number_in(frame.images[0]) for frame in Recording(tmp_path / "run.rrd").frames()]
    assert shown == list(range(FRAMES))


@pytest.mark.parametrize(
    ("flags", "frames", "first"),
    [
        (["--stride", "4"], range(0, LONG, 4), 0),
        (["--log-every", "5"], range(0, LONG, 5), 0),
        (["--start", "1.7", "--end", "1.9"], range(52, 58), 48),  # behind the key frame
    ],
)
def test_frames_that_are_left_out_leave_their_packets(tmp_path, flags, frames, first):
    log = video_log(tmp_path / "log.mcap", x264(LONG, "bframes=0"), "h264", rising=True)
    image = record(log, tmp_path / "run.rrd", *flags)
    assert image["frame"] == list(range(first, max(frames) + 1))
    recording = Recording(tmp_path / "run.rrd")
    assert recording.indices == list(frames)
    assert [number_in(frame.images[0]) for frame in recording.frames()] == list(frames)


def test_parameter_sets_of_their_own_go_with_the_picture_behind_them(tmp_path):
    packets = x264(FRAMES, "bframes=0")
    begin = packets[0][1].index(b"\0\0\1\x65") - 1
    split = [(0, packets[0][1][:begin]), (0, packets[0][1][begin:]), *packets[1:]]
    log = video_log(tmp_path / "log.mcap", split, "h264", rising=True)
    image = record(log, tmp_path / "run.rrd")
    assert image["frame"] == list(range(1, FRAMES + 1))
    assert bytes(image["VideoStream:sample"][0][0]) == packets[0][1]


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_b_frames_are_refused(tmp_path, codec):
    log = video_log(tmp_path / "log.mcap", ENCODERS[codec](FRAMES, "bframes=2:b-adapt=0"), codec, rising=True)
    assert "B-frames" in refusal(log, "--headless", "--log-image", "video", "--save", tmp_path / "run.rrd")


def test_logs_without_a_video_that_can_be_begun_are_refused(tmp_path):
    refreshed = x264(FRAMES, "bframes=0:intra-refresh=1")[5:]
    stills = write_log(tmp_path / "s.mcap", {"/camera": logged([raw(numbered(0), stamp(0), "bgr8")])})
    for log in (video_log(tmp_path / "v.mcap", refreshed, "h264", rising=True), stills):
        error = refusal(log, "--headless", "--log-image", "video", "--save", tmp_path / "run.rrd")
        assert "no video that begins with a whole key frame; use --log-image jpeg" in error
