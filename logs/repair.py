"""Make a clean copy of a log that was cut or damaged: `python -m logs.repair FILE`."""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Header

from airline.command import Parser, exit_code
from airline.errors import InputError
from logs.files.mcap_chunks import DamageError
from logs.files.mcap_index import listed_messages, read_summary
from logs.files.mcap_records import MAGIC, Definitions, RecordFile, parse
from logs.files.mcap_rewrite import Rewriter
from logs.files.mcap_scan import Batch, Loss, scan

_JOURNAL_SUFFIX = ".unfinished"


@dataclass(frozen=True)
class Repaired:
    """What is in the clean copy.

    Attributes:
        messages: by topic.
        chunks, attachments, metadata: how many.
        lost: what could not be read: how many times, by reason.
    """

    messages: Mapping[str, int]
    chunks: int
    attachments: int
    metadata: int
    lost: Mapping[str, int]


def build_parser() -> Parser:
    """All arguments."""
    parser = Parser(prog="python -m logs.repair", description="Make a clean copy of a log that was cut or damaged.")
    parser.add_argument(
        "log", type=Path, metavar="FILE", help="an MCAP file, NAME.parquet.unfinished or a LIMAP folder"
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="the copy; else NAME.repaired.mcap, or NAME.parquet")
    parser.add_argument("--overwrite", action="store_true", help="replace the copy if there is one")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    return exit_code(run, build_parser().parse_args(arguments))


def run(options: argparse.Namespace) -> None:
    """Repair and print what was kept and what was lost.

    Raises:
        AirLineError: an argument or file cannot be used.
    """
    if options.log.is_dir():
        from logs.sinks.limap import repair_folder

        print(f"{options.log}: finished, {repair_folder(options.log)} images")
        return
    journal = options.log.suffix == _JOURNAL_SUFFIX
    default = options.log.with_suffix("") if journal else options.log.with_name(f"{options.log.stem}.repaired.mcap")
    out: Path = options.out or default
    _check_place(options.log, out, options.overwrite)
    if journal:
        # what the Parquet sink writes until it is finished; all other files are taken for MCAP
        from logs.sinks.parquet import finish_journal

        rows = finish_journal(options.log, out, options.overwrite)
        print(f"{out}: finished, {rows} rows")
        return
    repaired = repair_mcap(options.log, out)
    kept = {
        "messages": sum(repaired.messages.values()),
        "chunks": repaired.chunks,
        "attachments": repaired.attachments,
        "metadata records": repaired.metadata,
    }
    print(f"{out}: {_listed(kept)}")
    for topic, count in sorted(repaired.messages.items()):
        printable = "".join(character if character.isprintable() else "?" for character in topic)
        print(f"  {printable}: {count}")
    print(f"lost: {_listed(repaired.lost) or 'nothing'}")


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name}: {count}" for name, count in counts.items())


def _check_place(log: Path, out: Path, overwrite: bool) -> None:
    if not out.parent.is_dir():
        raise InputError(f"no folder {out.parent}: create it, or give another --out file")
    try:
        if not out.exists():
            return
        if log.exists() and out.samefile(log):
            raise InputError(f"'{out}' is the log itself: give another --out file")
        if not overwrite or out.is_dir():
            raise InputError(f"'{out}' exists: give another --out file, or replace it with --overwrite")
    except OSError as error:
        raise InputError(f"cannot write '{out}': {error}") from error


def repair_mcap(path: Path, out: Path) -> Repaired:
    """Write everything readable of an MCAP file as a clean, chunked and indexed one; holds one chunk at a time.

    Sound chunks keep their bytes; ids, times, sequence numbers, attachments and metadata stay as they are. `out`
    appears when it is complete, and replaces what was there.

    Raises:
        InputError: the log cannot be opened, is no MCAP file or has no readable message; `out` cannot be written.
    """
    part = out.with_name(f".{out.name}.{os.getpid()}.part")
    try:
        with closing(RecordFile(path)) as source, part.open("xb") as file:
            try:
                repaired = _copy(source, file)
                os.fsync(file.fileno())
                file.close()
                if not repaired.messages:
                    raise InputError(f"'{path}' has not one readable message, so there is nothing to repair")
                part.replace(out)
            finally:
                part.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"cannot write '{out}': {error}") from error
    return repaired


def _copy(source: RecordFile, file: BinaryIO) -> Repaired:
    summary = read_summary(source)
    definitions = summary.definitions if summary else Definitions()
    copy = Rewriter(file, _header(source), definitions)
    lost: Counter[str] = Counter()
    damaged_chunk = False
    for part in scan(source, [entry.offset for entry in summary.entries] if summary else ()):
        try:
            if isinstance(part, Loss):
                lost[part.reason] += 1
            elif isinstance(part, Batch):
                lost += copy.add_batch(part)
            elif part.opcode == Opcode.ATTACHMENT:
                copy.add_attachment(source, part)
            elif part.opcode == Opcode.METADATA:
                copy.add_metadata(source, part)
            elif part.opcode == Opcode.MESSAGE_INDEX and damaged_chunk:
                lost["messages in damaged chunks"] += listed_messages(source, part)[1]
                continue
        except DamageError as error:
            lost[error.reason] += 1
        damaged_chunk = isinstance(part, Loss) and part.chunk
    copy.finish()
    messages: Counter[str] = Counter()
    for channel, count in copy.counts.items():
        messages[definitions.channels[channel].topic] += count
    return Repaired(messages, copy.chunks, copy.attachments, copy.metadata, lost)


def _header(source: RecordFile) -> Header:
    """The first record; an empty one where it is damaged."""
    empty = Header(profile="", library="")
    record = source.record(len(MAGIC))
    if record is None or record.opcode != Opcode.HEADER:
        return empty
    try:
        return parse(Header, source.body(record))
    except DamageError:
        return empty


if __name__ == "__main__":
    sys.exit(main())
