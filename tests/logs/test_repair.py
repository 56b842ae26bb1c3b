"""Clean copies of damaged logs: whatever mcap's own reader finds in them, strictly."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import SeekingReader
from mcap.stream_reader import StreamReader

from logs.files.mcap_file import McapFile
from logs.repair import main
from tests.helpers.command import refusal
from tests.helpers.mcap_logs import Sent, add, messages, start

SENT = messages(60)
ATTACHMENT = {"create_time": 3, "log_time": 4, "name": "c.yaml", "media_type": "text/yaml", "data": b"k: 1" * 999}


def write_all(path: Path, **options: Any) -> Path:
    """A log with everything in it."""
    with path.open("wb") as file:
        writer = start(file, chunk_size=1500, **options)
        add(writer, SENT[:30])
        writer.add_attachment(**ATTACHMENT)
        writer.add_metadata("robot", {"name": "r2", "": "ä"})
        add(writer, SENT[30:])
        writer.finish()
    return path


def repair(path: Path) -> list[Sent]:
    """The messages of the copy, which every reader of mcap reads without an error; ids may be others."""
    out = path.with_name("copy.mcap")
    assert main([str(path), "--out", str(out), "--overwrite"]) == 0
    with out.open("rb") as file:
        for _ in StreamReader(file, validate_crcs=True).records:
            pass
        file.seek(0)
        reader = SeekingReader(file, validate_crcs=True)
        assert reader.get_header().profile == "test"
        summary = reader.get_summary()
        found = [
            (channel.topic, channel.metadata, schema.name if schema else "", message)
            for schema, channel, message in reader.iter_messages()
        ]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(found)
    assert all(metadata == {"note": topic} for topic, metadata, *_ in found)
    ids = {"sensor_msgs/msg/Image": 1, "foxglove.RawImage": 2, "": 3}
    return [Sent(ids[schema], m.log_time, m.publish_time, m.sequence, m.data) for _, _, schema, m in found]


def test_what_is_not_repaired_here_is_said(tmp_path: Path) -> None:
    for name, hint in (("lines.bag", "rosbag reindex"), ("Tracks.CSV", "needs no repair")):
        (tmp_path / name).write_bytes(b"#ROSBAG V2.0\n")
        assert hint in refusal(tmp_path / name, main=main)


@pytest.mark.parametrize("options", [{}, {"use_chunking": False}, {"repeat_channels": False}], ids=str)
def test_everything_is_kept(tmp_path: Path, options: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    path = write_all(tmp_path / "a.mcap", **options)
    assert repair(path) == SENT
    assert capsys.readouterr().out == f"{tmp_path / 'copy.mcap'}: 60 messages; lost: nothing\n"
    with path.open("rb") as first, (tmp_path / "copy.mcap").open("rb") as second:
        before, after = SeekingReader(first), SeekingReader(second)
        assert list(before.iter_attachments()) == list(after.iter_attachments())
        assert list(before.iter_metadata()) == list(after.iter_metadata())


@given(
    changes=st.lists(st.tuples(st.floats(0.1, 1, exclude_max=True), st.binary(min_size=1, max_size=9)), max_size=3),
    cut=st.floats(0.3, 1),
)
@settings(max_examples=60)
def test_copies_of_damaged_logs_are_clean(tmp_path_factory, changes, cut):
    path = tmp_path_factory.getbasetemp() / "mutated.mcap"
    data = bytearray(write_all(path, use_chunking=bool(changes)).read_bytes())  # outside chunks there is no CRC
    for where, new in changes:
        place = int(where * len(data))
        data[place : place + len(new)] = new
    path.write_bytes(data[: int(cut * len(data))])
    with closing(McapFile(path)) as log:
        if not log.topics:
            return
    assert set(repair(path)) <= set(SENT)


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_all(tmp_path / "drive.mcap")
    path.write_bytes(path.read_bytes()[:-6000])
    out = tmp_path / "drive.repaired.mcap"
    assert main([str(path)]) == 0
    with out.open("rb") as file:
        count = sum(1 for _ in SeekingReader(file).iter_messages())
    lost = "lost: {'everything behind a cut or damaged record': 1}"
    assert capsys.readouterr().out == f"{out}: {count} messages; {lost}\n"
    assert sorted(tmp_path.iterdir()) == [path, out]
    before = out.read_bytes()
    assert main([str(path)]) == 2
    assert "exists: choose another name or give --overwrite" in capsys.readouterr().err
    assert main([str(path), "--overwrite"]) == 0
    assert out.read_bytes() == before


def test_errors_of_the_command(tmp_path: Path) -> None:
    path = write_all(tmp_path / "a.mcap")
    (tmp_path / "text.mcap").write_text("hello")
    (tmp_path / "header.mcap").write_bytes(path.read_bytes()[:60])
    for arguments, error in [
        ([tmp_path / "missing.mcap"], "cannot open the log"),
        ([tmp_path], "is no folder of tracks for LIMAP"),
        ([tmp_path / "text.mcap"], "is not an MCAP file"),
        ([tmp_path / "header.mcap"], "has not one readable message"),
        ([path, "--out", tmp_path / "no" / "b.mcap"], "there is no folder"),
        ([path, "--out", tmp_path, "--overwrite"], "it is a folder"),
        ([path, "--out", path], "exists"),
        ([path, "--out", tmp_path / ("x" * 300)], "cannot write"),
    ]:
        assert error in refusal(*arguments, main=main)
    assert len(list(tmp_path.iterdir())) == 3
