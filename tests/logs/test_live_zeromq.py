"""Tracks over ZeroMQ: every consumer gets what is sent while it is there, and none can hold up the publisher."""

from __future__ import annotations

import logging
import os
import select
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zmq

from airline.errors import ConfigError, InputError
from frontend.tracks import LineTracks
from logs import subscribe_tracks
from logs.sinks.open import Address, open_publisher, parse_address
from logs.sinks.zeromq import ZmqPublisher
from logs.tracks.message import encode
from tests.helpers.command import ROOT
from tests.helpers.made_tracks import assert_all_same, clip_results, made_tracks, result_of

LOCAL = "tcp://127.0.0.1:0"


@pytest.fixture(autouse=True)
def time_to_connect(monkeypatch: pytest.MonkeyPatch) -> None:
    """More of it than a program needs: the tests' machine may be busy."""
    monkeypatch.setattr("logs.sinks.zeromq.CONNECT_S", 1.0)


def frames(count: int, lines: int = 20) -> list[LineTracks]:
    rng = np.random.default_rng(0)
    return [made_tracks(k, 10**9 + k, np.arange(k, k + lines), rng, lost=2, ended=1) for k in range(count)]


def publish(publisher: ZmqPublisher, stream: list[LineTracks], pause_s: float = 0.0) -> None:
    for tracks in stream:
        publisher.write(result_of(tracks))
        time.sleep(pause_s)


def publisher(address: str = LOCAL) -> ZmqPublisher:
    found = open_publisher(address, "made")
    assert isinstance(found, ZmqPublisher)
    return found


@pytest.fixture
def sender() -> Iterator[tuple[Callable[..., None], str]]:
    """A publisher of anything: what to send a message with, and its address. It waits for one subscriber."""
    with zmq.Context() as context, context.socket(zmq.XPUB) as raw:
        raw.setsockopt(zmq.LINGER, 1000)
        raw.bind(LOCAL)

        def send(*parts: bytes) -> None:
            if not sent:
                assert raw.poll(5000)
            sent.append(parts)
            raw.send_multipart(parts)

        sent: list[tuple[bytes, ...]] = []
        yield send, raw.getsockopt_string(zmq.LAST_ENDPOINT)


@pytest.mark.parametrize("kind", ["tcp", "ipc"])
def test_waiting_consumers_get_every_frame_exactly(kind: str, tmp_path: Path) -> None:
    """Also one that was there before the publisher."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}" if kind == "tcp" else f"ipc://{tmp_path}/lines"
    stream = [result.tracks for result in clip_results()]
    subscriptions = [subscribe_tracks(address) for _ in range(3)]
    with closing(publisher(address)) as source:
        publish(source, stream)
    for subscription in subscriptions:
        assert subscription.latest is None
        found = list(subscription)
        assert_all_same(found, stream)
        for one, sent in zip(found, stream, strict=True):
            assert_all_same(list(one.history), list(sent.history))
        assert subscription.lost == 0
        latest = subscription.latest
        assert latest is not None
        assert (latest.sequence, latest.name, latest.tracks) == (len(stream), "made", None)
        assert list(subscription) == [], "it has closed itself"


def test_who_comes_late_gets_what_comes_from_then_on() -> None:
    stream = frames(60)
    with closing(publisher()) as source:
        publish(source, stream[:10])
        with subscribe_tracks(source.address) as late:
            thread = threading.Thread(target=publish, args=(source, stream[10:], 0.02))
            thread.start()
            found = [next(iter(late)) for _ in range(10)]
            thread.join()
    first = found[0].frame_index
    assert first >= 10
    assert_all_same(found, stream[first : first + 10])
    assert late.lost == 0
    assert late.latest is not None
    assert late.latest.read_ns <= late.latest.sent_ns <= time.time_ns()


def test_one_that_never_reads_stops_nobody() -> None:
    with zmq.Context() as context, context.socket(zmq.SUB) as stuck:
        stuck.setsockopt(zmq.RCVHWM, 1)
        stuck.setsockopt(zmq.LINGER, 0)
        stuck.subscribe(b"")
        source = publisher()
        stuck.connect(source.address)
        publish(source, 100 * frames(30, lines=200))  # a gigabyte would wait for it
        source.close()


READER = """
import sys
from logs import subscribe_tracks
with subscribe_tracks(sys.argv[1]) as subscription:
    for tracks in subscription:
        print(tracks.frame_index, flush=True)
"""


def test_one_that_is_killed_harms_nobody() -> None:
    stream = frames(150)
    with closing(publisher()) as source, subscribe_tracks(source.address) as other:
        command = [sys.executable, "-c", READER, source.address]
        with subprocess.Popen(command, stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(ROOT)}) as victim:
            assert victim.stdout is not None
            while not select.select([victim.stdout], [], [], 0)[0]:  # it needs time to start
                publish(source, stream[:1], 0.05)
            publish(source, stream[1:60], 0.002)
            victim.kill()
        publish(source, stream[60:], 0.002)
        source.close()
        found = [tracks for tracks in other if tracks.frame_index > 0]
    assert_all_same(found, stream[1:])
    assert other.lost == 0


def test_the_stride_arrives() -> None:
    with (
        closing(open_publisher("tcp://127.0.0.1:0", "made", stride=2)) as source,
        subscribe_tracks(source.address) as subscription,
    ):
        thread = threading.Thread(target=publish, args=(source, frames(3)))
        thread.start()
        next(iter(subscription))
        thread.join()
        assert subscription.latest is not None
        assert subscription.latest.stride == 2


def test_gaps_are_counted(sender: tuple[Callable[..., None], str], caplog: pytest.LogCaptureFixture) -> None:
    send, address = sender
    (tracks,) = frames(1)
    with subscribe_tracks(address) as subscription:
        for number in (4, 5, 8, 9):
            send(encode(result_of(tracks), stream=1, sequence=number, name="", sent_ns=0))
        send(encode(None, stream=1, sequence=11, name="", sent_ns=0))
        assert len(list(subscription)) == 4
        assert subscription.lost == 3
    assert [record.levelno for record in caplog.records] == [logging.WARNING]


def test_what_is_no_message_is_an_error_and_the_next_one_can_be_read(sender: tuple[Callable[..., None], str]) -> None:
    send, address = sender
    (tracks,) = frames(1)
    good = encode(result_of(tracks), stream=1, sequence=0, name="", sent_ns=0)
    with subscribe_tracks(address) as subscription:
        for parts, complaint in (([b"noise"], "not a valid message"), ([b"lines", good], "several parts")):
            send(*parts)
            with pytest.raises(InputError, match=complaint) as caught:
                next(iter(subscription))
            assert address in str(caught.value)
        send(good)
        assert_all_same([next(iter(subscription))], [tracks])


def test_a_publisher_that_begins_anew_is_noticed(sender: tuple[Callable[..., None], str]) -> None:
    send, address = sender
    tentative, confirmed = (
        replace(*frames(1), states=np.full(20, state, np.uint8), ended_ids=np.zeros(0, np.int64)) for state in (0, 1)
    )
    with subscribe_tracks(address) as subscription:
        for tracks, stream, number in ((tentative, 1, 5), (tentative, 2, 0), (confirmed, 2, 1), (confirmed, 2, 1)):
            send(encode(result_of(tracks), stream=stream, sequence=number, name="", sent_ns=0))
        next(iter(subscription))
        with pytest.raises(InputError, match="began anew"):
            next(iter(subscription))
        assert next(iter(subscription)).history == (), "the ids are those of other lines"
        with pytest.raises(InputError, match="message 1 behind message 1"):
            next(iter(subscription))


def test_silence_is_an_error_after_a_while() -> None:
    silence = pytest.raises(InputError, match=r"nothing came from tcp://127\.0\.0\.1:\d+ for 0\.2 s")
    with closing(publisher()) as source, subscribe_tracks(source.address, timeout_s=0.2) as subscription, silence:
        next(iter(subscription))


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("tcp://127.0.0.1:5555", Address("tcp", "127.0.0.1", 5555)),
        ("tcp://:5555", Address("tcp", "127.0.0.1", 5555)),
        ("tcp://*:5555", Address("tcp", "*", 5555)),
        ("tcp://[::1]:0", Address("tcp", "::1", 0)),
        ("ws://robot.local:8765", Address("ws", "robot.local", 8765)),
        ("ipc:///tmp/lines", Address("ipc", path="/tmp/lines")),
        ("ipc://@lines", Address("ipc", path="@lines")),
    ],
)
def test_addresses(text: str, address: Address) -> None:
    assert parse_address(text) == address
    assert parse_address(str(address)) == address


BAD = ["", "5555", "127.0.0.1:5555", "tcp://", "tcp://127.0.0.1", "tcp://h:x", "tcp://h:65536", "tcp://h:1/x"]
BAD += ["tcp://[:1", "tcp://me@h:1", "udp://h:1", "ipc://", "ipc://a\nb", "ipc://\udcff", "wss://h:1"]


@pytest.mark.parametrize("text", BAD)
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="is no address"):
        subscribe_tracks(text)


def test_foxglove_is_not_for_subscribers() -> None:
    with pytest.raises(ConfigError, match="is for Foxglove"):
        subscribe_tracks("ws://127.0.0.1:8765")


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:0", "ws://127.0.0.1:0", "ipc://{folder}/lines"])
def test_a_taken_address_is_refused(address: str, tmp_path: Path) -> None:
    refused = pytest.raises(InputError, match=r"cannot publish at .* use\): choose another")
    with closing(open_publisher(address.format(folder=tmp_path), "first")) as first, refused:
        open_publisher(first.address, "second")


@pytest.mark.parametrize(
    "text", ["tcp://192.0.2.1:5555", "ws://192.0.2.1:5555", "ipc:///no/such/folder/lines", "ipc://" + "x" * 200]
)
def test_an_address_of_others_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="cannot publish at"):
        open_publisher(text, "")


def test_a_socket_that_was_left_behind_is_replaced_and_a_file_is_not(tmp_path: Path) -> None:
    left, file = tmp_path / "lines", tmp_path / "notes"
    with socket.socket(socket.AF_UNIX) as old:
        old.bind(str(left))
    assert left.exists()
    publisher(f"ipc://{left}").close()
    file.write_text("mine")
    with pytest.raises(InputError, match="there is a file of this name"):
        publisher(f"ipc://{file}")
    assert file.read_text() == "mine"


@pytest.mark.parametrize(("module", "scheme", "extra"), [("zmq", "tcp", "zeromq"), ("foxglove", "ws", "foxglove")])
def test_without_the_extra_one_sentence_names_it(module, scheme, extra, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, f"logs.sinks.{extra}", raising=False)
    with pytest.raises(ConfigError, match=rf"{module} is not installed: pip install 'airline-frontend\[{extra}\]'"):
        open_publisher(f"{scheme}://127.0.0.1:0", "clip")
