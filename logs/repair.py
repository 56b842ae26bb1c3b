"""Finishes what a crash cut off: `python -m logs.repair FILE`."""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from contextlib import closing, suppress
from pathlib import Path
from typing import BinaryIO

from mcap.records import Attachment, Header, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from airline.command import Parser, exit_code
from airline.errors import InputError
from logs.files.mcap_chunks import CHUNK_LIMIT, UNREADABLE
from logs.files.mcap_file import McapFile
from logs.sinks.output import check_new, errors_of
from logs.topics import printable


def run(options: argparse.Namespace) -> None:
    """Repair and print what there is now; raises AirLineError."""
    path: Path = options.log
    if path.is_dir():
        from logs.sinks.limap import repair_folder

        print(f"{path}: finished, {repair_folder(path)} images")
        return
    journal = path.suffix == ".unfinished"
    out: Path = options.out or (path.with_suffix("") if journal else path.with_name(f"{path.stem}.repaired.mcap"))
    if out == path:
        raise InputError(f"'{out}' is the log itself: give another --out file")
    if journal:
        from logs.sinks.parquet import finish_journal

        print(f"{out}: finished, {finish_journal(path, out, options.overwrite)} rows")
        return
    with closing(McapFile(path)) as log, closing(path.open("rb")) as source:
        if not log.topics:
            raise InputError(f"'{path}' has not one readable message, so there is nothing to repair")
        check_new(out, options.overwrite)
        part = out.with_name(f".{out.name}.{os.getpid()}.part")
        try:
            with errors_of(out), part.open("xb") as file:
                counts = copy(log, source, file)
                os.fsync(file.fileno())
                part.replace(out)
        finally:
            part.unlink(missing_ok=True)
    print(f"{out}: {', '.join(f'{printable(topic)}: {count}' for topic, count in sorted(counts.items()))}")
    print(f"lost: {', '.join(f'{reason}: {count}' for reason, count in log.lost.items()) or 'nothing'}")


def copy(log: McapFile, source: BinaryIO, file: BinaryIO) -> Counter[str]:
    """Write all readable messages, and the attachments and metadata before the first damage; messages by topic."""
    writer, header = Writer(file), None
    records = StreamReader(source, emit_chunks=True, record_size_limit=CHUNK_LIMIT).records
    with suppress(*UNREADABLE):
        header = next(records)
    writer.start(header.profile, header.library) if isinstance(header, Header) else writer.start()
    with suppress(*UNREADABLE):
        for extra in records:
            if isinstance(extra, Attachment):
                writer.add_attachment(extra.create_time, extra.log_time, extra.name, extra.media_type, extra.data)
            elif isinstance(extra, Metadata):
                writer.add_metadata(extra.name, extra.metadata)
    schemas, channels = {0: 0}, {}
    counts: Counter[str] = Counter()
    for schema, channel, message in log.raw_messages():
        if schema is not None and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            number = writer.register_channel(
                channel.topic, channel.message_encoding, schemas[channel.schema_id], channel.metadata
            )
            channels[channel.id] = number
        number = channels[channel.id]
        writer.add_message(number, message.log_time, message.data, message.publish_time, message.sequence)
        counts[channel.topic] += 1
    writer.finish()
    return counts


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = Parser(prog="python -m logs.repair", description=__doc__)
    parser.add_argument("log", type=Path, metavar="FILE", help="MCAP file, NAME.parquet.unfinished or LIMAP folder")
    parser.add_argument("--out", type=Path, metavar="FILE", help="else NAME.repaired.mcap, or NAME.parquet")
    parser.add_argument("--overwrite", action="store_true", help="replace that file if there is one")
    return exit_code(run, parser.parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
