"""`frontend.run --publish`: what consumers get of a whole run, however it ends; and the consumers in examples/."""

from __future__ import annotations

import re
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import zmq

from frontend.tracks import LineTracks
from logs import read_tracks, subscribe_tracks
from tests.helpers.command import ROOT, python, refusal
from tests.helpers.foxglove_client import FoxgloveClient
from tests.helpers.made_tracks import assert_all_same
from tests.helpers.videos import write_video


@contextmanager
def run(*arguments: object) -> Iterator[tuple[subprocess.Popen[str], list[str]]]:
    """A run of the command line in a process of its own, and the addresses that it publishes at."""
    addresses = sum(argument == "--publish" for argument in arguments)
    with python(*arguments, "--headless", stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stdout is not None
        lines = [child.stdout.readline() for _ in range(addresses)]
        try:
            yield child, [line.removeprefix("publishing at ").rstrip() for line in lines]
        finally:
            child.kill()


def raw_messages(address: str) -> list[dict[str, Any]]:
    """All messages up to the end, as any program sees them."""
    with zmq.Context() as context, context.socket(zmq.SUB) as raw:
        raw.setsockopt(zmq.RCVTIMEO, 120_000)
        raw.subscribe(b"")
        raw.connect(address)
        messages = [msgspec.msgpack.decode(raw.recv())]
        while messages[-1]["type"] != "end":
            messages.append(msgspec.msgpack.decode(raw.recv()))
    return messages


def test_consumers_get_what_the_file_holds(clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "tracks.parquet"
    with run(clip, "--publish", "tcp://:0", "--publish", f"ipc://{tmp_path}/lines", "--out", out) as (child, addresses):
        subscriptions = [subscribe_tracks(address, timeout_s=120) for address in addresses]
        found = [list(subscription) for subscription in subscriptions]
        text, errors = child.communicate()
    assert (child.returncode, errors) == (0, "")
    assert re.fullmatch(r"tcp://127\.0\.0\.1:\d+", addresses[0])
    assert addresses[1] == f"ipc://{tmp_path}/lines"
    assert "saved" not in text, "--publish says where results go"
    for subscription, stream in zip(subscriptions, found, strict=True):
        assert_all_same(stream, list(read_tracks(out)))
        assert subscription.lost == 0
        assert subscription.latest is not None
        assert subscription.latest.name == "room"


def test_interrupt_tells_consumers_that_it_was_all(clip: Path, tmp_path: Path) -> None:
    path = write_video(tmp_path / "long.avi", [np.zeros((120, 160, 3), np.uint8)] * 3000)
    flags = ["--realtime", "--publish", "tcp://127.0.0.1:0", "--publish", "ws://127.0.0.1:0"]
    with run(path, *flags) as (child, (address, viewers)), subscribe_tracks(address, timeout_s=60) as subscription:
        tracks = iter(subscription)
        for _ in range(20):
            assert isinstance(next(tracks), LineTracks)
        with closing(FoxgloveClient(viewers)) as gone:  # without a word
            gone.subscribe("/camera/image")
            gone.read_message()
        with closing(FoxgloveClient(viewers)) as client:
            client.subscribe("/camera/image", "/lines/tracks")
            assert {client.read_message()[0] for _ in range(4)} == {"/camera/image", "/lines/tracks"}
            begin = time.monotonic()
            child.send_signal(signal.SIGINT)
            rest = list(tracks)
            _, errors = child.communicate(timeout=30)
        assert time.monotonic() - begin < 10
    assert child.returncode == 130
    said = [line for line in errors.splitlines() if "frames come faster" not in line]  # as they do on a busy machine
    assert said == ["WARNING: interrupted: what was done so far is kept"]
    assert len(rest) < 1000
    assert subscription.lost == 0


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1", "ftp://127.0.0.1:5555", "tcp://192.0.2.1:5555", "ws://", "tcp://"]
)
def test_an_address_that_cannot_be_had_is_refused_before_any_work(clip: Path, tmp_path: Path, address: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address += f"127.0.0.1:{taken.getsockname()[1]}" if address.endswith("//") else ""
        flags = ["--publish", "tcp://127.0.0.1:0", "--publish", address, "--out", tmp_path / "tracks.mcap"]
        assert address in refusal(clip, "--headless", *flags)
    assert not list(tmp_path.iterdir())


def test_the_consumer_in_cpp(clip: Path, tmp_path: Path) -> None:
    compiler = shutil.which("c++")
    if compiler is None:
        pytest.skip("there is no C++ compiler")
    source, program = ROOT / "examples" / "receive_live_tracks.cpp", tmp_path / "receive"
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-x", "c++"]
    headers = "#include <zmq.h>\n#include <nlohmann/json.hpp>\nint main() { return zmq_errno(); }\n"
    probe = subprocess.run(
        [compiler, *flags, "-", "-lzmq", "-o", program], input=headers, text=True, capture_output=True
    )
    if probe.returncode:
        pytest.skip("libzmq or nlohmann's json is not installed for C++")
    subprocess.run([compiler, *flags, source, "-lzmq", "-o", program], check=True, timeout=300)
    camera = tmp_path / "camera.json"
    camera.write_text('{"width": 160, "height": 120, "fx": 150, "fy": 151, "cx": 80, "cy": 60, "distortion": "none"}')
    with run(clip, "--calib", camera, "--publish", "tcp://127.0.0.1:0") as (_, (address,)):
        receiver = subprocess.Popen([program, address], stdout=subprocess.PIPE, text=True)
        messages = raw_messages(address)
        text = receiver.communicate(timeout=60)[0]
    assert receiver.returncode == 0
    lines = [line for line in text.splitlines() if not line.startswith("  ")]
    assert lines.pop() == "received up to message 8, lost 0"
    for line, message in zip(lines, messages, strict=False):
        assert line.startswith(f"{message['stamp_ns']}: {message['arrays']['ids']['shape'][0]} tracks, ")
    arrays = {
        name: np.frombuffer(array["data"], array["dtype"]).reshape(array["shape"])
        for name, array in messages[7]["arrays"].items()
    }
    shown = re.findall(r"  (\d+): \((\S+), (\S+)\) - \((\S+), (\S+)\)", text.split(lines[-1])[1])
    assert shown
    for track, *numbers in shown:
        (row,) = np.flatnonzero(arrays["ids"] == int(track))
        np.testing.assert_allclose(np.float32(numbers), arrays["segments_normalized"][row].ravel(), atol=1e-4)
