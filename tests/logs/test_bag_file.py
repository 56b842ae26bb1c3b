"""ROS bags as rosbags writes them, read back message by message, from any time, and after damage."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

from airline.errors import AirLineError, InputError
from logs.files import LogFile, is_log, open_log
from logs.files.bag_file import BagFile

START = 1_403_636_579_763_555_584
STEP = 50_000_000
COUNT = 60
TOPIC, OTHER = "/cam0/image_raw", "/imu0"
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
KINDS = ["none", "bz2", "lz4", "sqlite", "mcap", "sqlite messages", "mcap messages", "sqlite file", "db3"]

PATTERN = bytes(range(251))
Expected = list[tuple[int, bytes]]


def content(number: int) -> bytes:
    return b"\0\1\0\0" + struct.pack("<I", number) + (PATTERN * 161)[number * 7 % 251 :][:40_000]


def stamp(number: int) -> int:
    return START + number * STEP


def fill(writer, typestore, numbers) -> None:
    with writer:
        image = writer.add_connection(TOPIC, "sensor_msgs/msg/Image", typestore=typestore)
        other = writer.add_connection(OTHER, "sensor_msgs/msg/Imu", typestore=typestore)
        for number in numbers:
            writer.write(image, stamp(number), content(number))
            for k in range(5):
                writer.write(other, stamp(number) + 1000 * (k + 1), b"\0\1\0\0imu")


def write(folder: Path, kind: str, numbers: Sequence[int] = range(COUNT)) -> Path:
    """A bag with an image topic and one with five times as many messages."""
    if kind in ("none", "bz2", "lz4"):
        path = folder / "some.bag"
        writer1 = rosbag1.Writer(path)
        if kind != "none":
            writer1.set_compression(rosbag1.Writer.CompressionFormat[kind.upper()])
        fill(writer1, ROS1, numbers)
        return path
    path = folder / "plain"
    storage = StoragePlugin.MCAP if kind.startswith("mcap") else StoragePlugin.SQLITE3
    writer2 = rosbag2.Writer(path, version=9, storage_plugin=storage)
    modes = {"messages": CompressionMode.MESSAGE, "file": CompressionMode.FILE}
    writer2.set_compression(modes.get(kind.partition(" ")[2], CompressionMode.NONE), CompressionFormat.ZSTD)
    fill(writer2, ROS2, numbers)
    if kind == "split":  # rosbags splits nothing: two recordings in one folder
        second = write(folder / "second", "sqlite", range(COUNT, 2 * COUNT))
        next(second.glob("*.db3")).rename(path / "some_1.db3")
    path = path.rename(folder / "some bag")
    return next(path.glob("*.db3")) if kind == "db3" else path


def expected(kind: str = "") -> Expected:
    return [(stamp(number), content(number)) for number in range(2 * COUNT if kind == "split" else COUNT)]


def read(bag: LogFile, start_ns: int | None = None) -> Expected:
    return [(message.log_ns, bytes(message.data)) for message in bag.messages(TOPIC, start_ns)]


@pytest.mark.parametrize("kind", KINDS)
def test_everything_comes_back_and_from_anywhere(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path, kind)
    assert is_log(path)
    bag = open_log(path)
    assert isinstance(bag, BagFile)
    whole = expected(kind)
    assert {name: topic.count for name, topic in bag.topics.items()} == {TOPIC: len(whole), OTHER: 5 * len(whole)}
    ros1 = kind in ("none", "bz2", "lz4")
    assert str(bag.topics[TOPIC].type) == ("sensor_msgs/msg/Image as ros1" if ros1 else "sensor_msgs/msg/Image as cdr")
    assert bag.span_ns == (START, whole[-1][0] + 5000)
    assert read(bag) == whole
    for start_ns in (START + 1, stamp(17), 2**62):
        assert read(bag, start_ns) == [message for message in whole if message[0] >= start_ns]
    assert list(bag.messages("/nowhere")) == []
    assert not bag.lost
    assert bag.name == ("some" if ros1 else path.stem)
    bag.close()
    bag.close()


def without_index(data: bytes) -> bytes:
    """As a recorder that was killed leaves it: the header does not know of an index."""
    place = data.index(b"index_pos=") + 10
    return data[:place] + bytes(8) + data[place + 8 :]


@pytest.mark.parametrize("kind", ["none", "bz2", "lz4"])
def test_a_bag_without_an_index_is_read_whole(tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture) -> None:
    path = write(tmp_path, kind)
    whole = path.read_bytes()
    (tmp_path / "killed.bag.active").write_bytes(without_index(whole))
    with closing(open_log(tmp_path / "killed.bag.active")) as bag, closing(open_log(path)) as sound:
        assert {name: topic.count for name, topic in bag.topics.items()} == {TOPIC: COUNT, OTHER: 5 * COUNT}
        assert str(bag.topics[TOPIC].type) == "sensor_msgs/Image as ros1"
        assert (bag.kind, sound.kind) == ("ROS 1 bag without an index", "ROS 1 bag")
        assert bag.span_ns == sound.span_ns
        for start_ns in (None, START + 1, stamp(17), 2**62):
            assert read(bag, start_ns) == read(sound, start_ns)
        assert list(bag.messages("/nowhere")) == []
        assert not bag.lost
    assert len(caplog.records) == 1


@pytest.mark.parametrize("kind", ["none", "bz2", "lz4"])
@pytest.mark.parametrize("indexed", [False, True])
def test_a_cut_bag_is_read_as_far_as_it_goes(
    tmp_path: Path, kind: str, indexed: bool, caplog: pytest.LogCaptureFixture
) -> None:
    whole = write(tmp_path, kind).read_bytes()
    data = whole if indexed else without_index(whole)
    found = []
    for percent in range(0, 100, 3):
        caplog.clear()
        (tmp_path / "cut.bag").write_bytes(data[: len(data) * percent // 100])
        if percent == 0:
            with pytest.raises(InputError):
                open_log(tmp_path / "cut.bag")
            continue
        with closing(open_log(tmp_path / "cut.bag")) as bag:
            messages = read(bag)
        assert messages == expected()[: len(messages)]
        assert len(caplog.records) == 1
        found.append(len(messages))
    assert found == sorted(found)
    assert found[-1] >= COUNT - 8
    assert len(set(found)) > (2 if kind == "bz2" else 15)


def test_a_chunk_that_was_never_closed_is_read(tmp_path: Path) -> None:
    """A recorder writes a chunk's sizes when it is full, until then zeros."""
    data = write(tmp_path, "none").read_bytes()
    place = data.rindex(b"op=\5")
    size = data.index(b"size=", place) + 5
    (length,) = struct.unpack_from("<I", data, size)
    end = data.index(struct.pack("<I", length), size + 4)
    open_chunk = data[:size] + bytes(4) + data[size + 4 : end] + bytes(4) + data[end + 4 : end + 4 + length]
    (tmp_path / "killed.bag").write_bytes(without_index(open_chunk))
    with closing(open_log(tmp_path / "killed.bag")) as bag:
        assert read(bag) == expected()


@pytest.mark.parametrize(("kind", "magic"), [("bz2", b"BZh9"), ("lz4", b"\x04\x22\x4d\x18")])
def test_messages_before_damage_are_read(tmp_path: Path, kind: str, magic: bytes) -> None:
    path = write(tmp_path, kind)
    data = bytearray(path.read_bytes())
    place = data.index(magic, data.index(magic) + 4) + 1000  # inside the second chunk
    data[place : place + 300] = bytes(range(50)) * 6
    path.write_bytes(data)
    with closing(BagFile(path)) as bag:
        found = read(bag)
        (reason,) = bag.lost
    assert 20 <= len(found) < COUNT
    assert found == expected()[: len(found)]
    assert reason.startswith("everything behind a damaged place of the bag")


@pytest.mark.parametrize("percent", [20, 50, 80, 99])
def test_a_cut_database_gives_what_is_left_or_a_clear_error(tmp_path: Path, percent: int) -> None:
    path = write(tmp_path, "db3")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * percent // 100])
    try:
        bag = BagFile(path)
    except InputError as error:
        assert "cannot read the bag" in str(error)  # noqa: PT017
        return
    with closing(bag):
        found = read(bag)
    assert set(found) <= set(expected())
    assert len(found) >= COUNT * percent // 100 - 5
    assert sum(bag.lost.values()) >= 1


def test_a_recording_that_was_killed_is_read(tmp_path: Path) -> None:
    path = write(tmp_path, "split")
    (path / "metadata.yaml").unlink()
    for number, file in enumerate(sorted(path.glob("*.db3"))):
        file.rename(path / f"run_{number}.db3")
    assert is_log(path)
    with closing(open_log(path)) as bag:
        assert read(bag) == expected("split")


@pytest.mark.parametrize("name", ["a.txt", "a.bag", "a.db3", "empty", "missing.bag", "nul\0.bag"])
def test_what_is_no_log_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name.startswith("a."):
        path.write_bytes(b"neither one nor the other")
    elif name == "empty":
        path.mkdir()
    with pytest.raises(InputError):
        open_log(path)
    with pytest.raises(InputError):
        BagFile(path)
    assert is_log(path) == name.endswith((".bag", ".db3"))


@given(place=st.floats(0, 1), noise=st.binary(min_size=1, max_size=60), cut=st.booleans())
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_arbitrary_damage_never_raises_anything_else(tmp_path, place, noise, cut, small_bags):
    for number, whole in enumerate(small_bags):
        data = bytearray(whole)
        at = int(place * (len(data) - 1))
        data[at : at + len(noise)] = noise
        path = tmp_path / f"damaged{number}{'.bag' if whole.startswith(b'#ROSBAG') else '.db3'}"
        path.write_bytes(data[: len(data) // 2] if cut else data)
        try:
            with closing(BagFile(path)) as bag:
                assert len(read(bag)) <= 100
                assert bag.span_ns is None or len(bag.span_ns) == 2
        except AirLineError:
            continue


@pytest.fixture(scope="module")
def small_bags(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    kinds = ("none", "lz4", "db3")
    return [write(tmp_path_factory.mktemp("small"), kind, range(2)).read_bytes() for kind in kinds]


def test_messages_that_sqlite_has_not_put_into_the_file(tmp_path: Path) -> None:
    folder = write(tmp_path, "sqlite", range(30))
    (path,) = folder.glob("*.db3")
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("PRAGMA wal_autocheckpoint=0")
    database.execute("UPDATE messages SET timestamp = timestamp + 1")
    database.commit()
    for log in (folder, path):
        with pytest.raises(InputError, match=r"-wal' beside it.*PRAGMA wal_checkpoint"):
            open_log(log)
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    with closing(open_log(path)) as file:
        assert [message.log_ns for message in file.messages(TOPIC)] == [stamp(number) + 1 for number in range(30)]
    database.close()


@pytest.mark.parametrize("gone", [0, 1, None])
def test_the_parts_of_a_bag_that_are_there(tmp_path: Path, gone: int | None, caplog: pytest.LogCaptureFixture) -> None:
    """One of two parts is missing, or one is renamed."""
    folder = write(tmp_path, "sqlite", range(20))
    (first,) = folder.glob("*.db3")
    (tmp_path / "second").mkdir()
    (second,) = write(tmp_path / "second", "sqlite", range(20, 40)).glob("*.db3")
    parts = [first, second.rename(folder / "plain_1.db3")]
    metadata = folder / "metadata.yaml"
    text = metadata.read_text()
    line = next(line for line in text.splitlines() if line.strip() == f"- {first.name}")
    metadata.write_text(text.replace(line, f"{line}\n{line.replace(first.name, 'plain_1.db3')}", 1))
    if gone is None:
        parts[0].rename(folder / "0_other.db3")
    else:
        parts[gone].unlink()
    with closing(open_log(folder)) as file:
        found = [message.log_ns for message in file.messages(TOPIC)]
        assert file.lost
    left = {0: range(20, 40), 1: range(20), None: range(40)}[gone]
    assert found == [stamp(number) for number in left]
    assert "the files that are there were read" in caplog.text
