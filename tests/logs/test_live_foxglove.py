"""The server for Foxglove's viewers, through a viewer's own protocol."""

from __future__ import annotations

import base64
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from logs.sinks.foxglove import RIGHT_TOPICS, TOPICS, FoxgloveServer, message_for
from logs.sinks.open import open_publisher
from logs.tracks.json import decode_tracks
from tests.helpers.foxglove_client import FoxgloveClient
from tests.helpers.made_tracks import PAIR, assert_same, clip_results, made_tracks, result_of


@pytest.fixture
def server() -> Iterator[FoxgloveServer]:
    found = open_publisher("ws://127.0.0.1:0", "clip", labels=True)
    assert isinstance(found, FoxgloveServer)
    with closing(found):
        yield found
    found.close()


def write_until_seen(server: FoxgloveServer, client: FoxgloveClient, result, messages: int) -> dict[str, tuple]:
    """Write a frame, again while the subscription is on its way; the messages by topic."""
    for _ in range(50):
        server.write(result)
        time.sleep(0.02)
    found = {}
    while len(found) < messages:
        topic, *rest = client.read_message()
        found[topic] = rest
    return found


def test_channels_are_those_of_the_file(server: FoxgloveServer) -> None:
    with closing(FoxgloveClient(server.address)) as client:
        assert client.info["name"] == "clip"
        assert client.channels.keys() == TOPICS.keys()
        for name, channel in client.channels.items():
            topic = TOPICS[name]
            assert (channel["schemaName"], channel["encoding"]) == (topic.schema_name, topic.encoding)
        assert base64.b64decode(client.channels["/camera/image"]["schema"]) == TOPICS["/camera/image"].schema


def test_channels_of_a_right_image_come_with_the_first(server: FoxgloveServer) -> None:
    result = result_of(made_tracks(0, 5, np.arange(9), np.random.default_rng(0), camera=PAIR, right=True))
    result = replace(result, frame=replace(result.frame, right=result.frame.image))
    server.write(result)
    with closing(FoxgloveClient(server.address)) as client:
        assert client.channels.keys() == TOPICS.keys() | RIGHT_TOPICS.keys()
        client.subscribe(*RIGHT_TOPICS)
        found = write_until_seen(server, client, result, len(RIGHT_TOPICS))
    for topic, (log_ns, data) in found.items():
        assert (log_ns, data) == (5, message_for(topic, result, labels=True))


def test_a_viewer_gets_lines_image_and_camera(server: FoxgloveServer) -> None:
    result = clip_results()[4]
    tracks = result.tracks
    with closing(FoxgloveClient(server.address)) as client:
        client.subscribe(*TOPICS)
        found = write_until_seen(server, client, result, len(TOPICS))
    assert {log_ns for log_ns, _ in found.values()} == {tracks.stamp_ns}
    contents = {topic: data for topic, (_, data) in found.items()}
    assert_same(decode_tracks(contents["/lines/tracks"]), tracks)
    for topic in TOPICS:  # what the file would hold, whose content test_track_mcap looks at
        assert contents[topic] == message_for(topic, result, labels=True)


def test_only_what_is_looked_at_is_sent(server: FoxgloveServer) -> None:
    with closing(FoxgloveClient(server.address)) as client:
        client.subscribe("/lines/tracks")
        for result in clip_results():
            server.write(result)
            time.sleep(0.02)
        assert {client.read_message()[0] for _ in range(3)} == {"/lines/tracks"}


def test_frames_without_a_camera_or_before_the_epoch(server: FoxgloveServer) -> None:
    tracks = made_tracks(0, -5, np.arange(3), np.random.default_rng(0), camera=None)
    with closing(FoxgloveClient(server.address)) as client:
        client.subscribe(*TOPICS)
        found = write_until_seen(server, client, result_of(tracks), len(TOPICS) - 1)
        assert "/camera/calibration" not in found
        assert_same(decode_tracks(found["/lines/tracks"][1]), tracks)


def test_a_viewer_that_never_reads_or_is_gone_stops_nothing(server: FoxgloveServer) -> None:
    result = clip_results()[4]
    noise = np.random.default_rng(0).integers(0, 256, (960, 1280, 3), np.uint8)
    result = replace(result, frame=replace(result.frame, image=noise))  # a megabyte as JPEG
    client = FoxgloveClient(server.address)
    client.subscribe(*TOPICS)
    gone = FoxgloveClient(server.address)
    gone.subscribe(*TOPICS)
    time.sleep(0.2)
    gone.close()
    for _ in range(100):
        server.write(result)
    server.close()
    client.close()
