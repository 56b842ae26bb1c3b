"""Finish what a crash cut off, MCAP file, NAME.parquet.unfinished or LIMAP folder: `python -m logs.repair FILE`."""

from __future__ import annotations

import argparse
import sys
from contextlib import closing, suppress
from pathlib import Path
from typing import BinaryIO

from mcap.records import Attachment, Header, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from airline.command import Parser, exit_code
from airline.errors import InputError, errors_of
from logs.files.mcap_file import McapFile
from logs.files.mcap_records import CHUNK_LIMIT, UNREADABLE
from logs.sinks.output import check_new, whole_file

_NO_REPAIR = {
    ".bag": "'{0}' is a ROS 1 bag: mend it with rosbag reindex {0}",
    ".csv": "'{0}' needs no repair: what a CSV file has can be read as it is",
}


def run(options: argparse.Namespace) -> None:
    """Repair, and print what there is now; raises AirLineError."""
    path, journal = options.log, options.log.suffix == ".unfinished"
    out = options.out or (path.with_suffix("") if journal else path.with_name(f"{path.stem}.repaired.mcap"))
    if path.is_dir():
        from logs.sinks.limap import repair_folder

        return print(f"{path}: finished, {repair_folder(path)} images")
    if journal:
        from logs.sinks.tables import finish_journal

        return print(f"{out}: finished, {finish_journal(path, out, options.overwrite)} rows")
    if path.is_file() and path.suffix.lower() in _NO_REPAIR:
        raise InputError(_NO_REPAIR[path.suffix.lower()].format(path))
    with closing(McapFile(path)) as log, errors_of(out), path.open("rb") as source:
        if not log.topics:
            raise InputError(f"'{path}' has not one readable message, so there is nothing to repair")
        check_new(out, options.overwrite)
        with whole_file(out) as file:
            count = copy_mcap(log, source, file)
    print(f"{out}: {count} messages; lost: {dict(log.lost) or 'nothing'}")


def copy_mcap(log: McapFile, source: BinaryIO, file: BinaryIO) -> int:
    """Write the readable messages, and the attachments and metadata before the first damage; returns messages."""
    writer, header, count = Writer(file), None, 0
    records = StreamReader(source, emit_chunks=True, record_size_limit=CHUNK_LIMIT).records
    with suppress(*UNREADABLE):
        header = next(records)
    writer.start(header.profile, header.library) if isinstance(header, Header) else writer.start()
    with suppress(*UNREADABLE):
        for record in records:
            if isinstance(record, Attachment):
                writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
    schemas, channels = {0: 0}, dict[int, int]()
    for schema, channel, message in log.raw_messages():
        if schema is not None and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            topic, encoding, schema_id = channel.topic, channel.message_encoding, schemas[channel.schema_id]
            channels[channel.id] = writer.register_channel(topic, encoding, schema_id, channel.metadata)
        message.channel_id = channels[channel.id]
        writer.add_message(**vars(message))
        count += 1
    writer.finish()
    return count


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = Parser(prog="python -m logs.repair", description=__doc__)
    parser.add_argument("log", type=Path, metavar="FILE")
    parser.add_argument("--out", type=Path, metavar="FILE", help="else NAME.repaired.mcap or NAME.parquet")
    parser.add_argument("--overwrite", action="store_true", help="replace that file if there is one")
    return exit_code(run, parser.parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
