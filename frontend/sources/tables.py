"""Tables of times that lie with images, as text."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime
from decimal import Decimal, InvalidOperation
from pathlib import Path, PurePosixPath, PureWindowsPath

from airline.errors import InputError
from frontend.sources.names import SECOND, UNITS, exact_ns, plausible, since_1970
from frontend.sources.streams import words_of

_MOST_BYTES = 1 << 28
_DATE = re.compile(r"(\d{4}-\d\d-\d\d)[ T](\d\d:\d\d:\d\d)(?:[.,](\d+))?(?:\s?(Z|[-+]\d\d:?\d\d))?(?!\w)")
_UNITS_IN_HEADINGS = {**{unit: unit for unit in UNITS}, "ns": "nanoseconds", "nsec": "nanoseconds"}
_UNITS_IN_HEADINGS |= {"us": "microseconds", "usec": "microseconds", "ms": "milliseconds", "msec": "milliseconds"}
_TIMES = {"time", "times", "timestamp", "timestamps", "stamp", "stamps", "ts", "t", "s", "sec", *_UNITS_IN_HEADINGS}
_SPANS = {"exposure", "exp", "shutter", "integration", "duration"}


def lines_of(table: Path) -> list[str]:
    """Lines that are neither empty nor a comment; raises InputError for what is no text."""
    try:
        if table.stat().st_size > _MOST_BYTES:
            raise InputError(f"'{table}' is too large for a table of times")
        text = table.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"'{table}' is not a text file") from error
    return [line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]


def fields_of(line: str) -> list[str]:
    """What commas, semicolons or tabs separate, else blanks; without quotes, and a date as one."""
    if ":" in line:
        line = _DATE.sub(lambda date: f"{date[1]}T{date[2]}.{date[3] or 0}{date[4] or ''}", line)
    return [field.strip("\"' ") for field in re.split(r"[,;\t]" if re.search(r"[,;\t]", line) else r"\s+", line)]


def is_number(text: str) -> bool:
    try:
        return Decimal(text).is_finite()
    except InvalidOperation:
        return False


def is_time(text: str) -> bool:
    return is_number(text) or _DATE.fullmatch(text) is not None


def split_heading(rows: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """A first row of words, where times follow, and the others."""
    words = len(rows) > 1 and not any(map(is_time, rows[0])) and any(map(is_time, rows[1]))
    return (rows[0], rows[1:]) if words else ([], rows)


def unit_said(heading: str) -> str:
    """The unit in the heading of a column of times, "seconds" where it has none, "" for another column."""
    words = words_of(heading)
    known = next((_UNITS_IN_HEADINGS[word] for word in words if word in _UNITS_IN_HEADINGS), "seconds")
    return known if words & _TIMES and not words & _SPANS else ""


def are_dates_or_since_1970(texts: Sequence[str]) -> bool:
    return all(map(_DATE.fullmatch, texts)) or (all(map(is_number, texts)) and _unit_by_size(texts) is not None)


def _unit_by_size(texts: Sequence[str]) -> str | None:
    """The unit in which all of some numbers are times since 1970."""
    told = {since_1970(int(Decimal(text))) if Decimal(text).copy_abs() < 10**20 else None for text in texts}
    return next(iter(told)) if len(told) == 1 else None


def stamps_of(texts: Sequence[str], table: Path, unit: str, notes: list[str]) -> list[int]:
    """Times in ns of a column: dates, or numbers of a unit; of another where only that makes sense, which is noted.

    Raises:
        InputError: one cannot be read.
    """
    if texts and all(map(_DATE.fullmatch, texts)):
        return [_date(text, table) for text in texts]
    stamps = [_nanoseconds(text, UNITS[unit]) for text in texts]
    known = [stamp for stamp in stamps if stamp is not None]
    if (len(known) < len(stamps) or not plausible(known)) and all(map(is_number, texts)):
        other = _unit_by_size(texts)
        if other is not None and other != unit:
            notes.append(f"the times of '{table.name}' are taken for {other} since 1970, by their size")
            stamps = [_nanoseconds(text, UNITS[other]) for text in texts]
    for text, stamp in zip(texts, stamps, strict=True):
        if stamp is None:
            raise InputError(f"'{table}' has a time that cannot be read: {text[:60]!r}")
    return [stamp for stamp in stamps if stamp is not None]


def inside(name: str, table: Path) -> PurePosixPath:
    """A file name out of a table, which must not lead out of the sequence's folder."""
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or PureWindowsPath(name).drive or ".." in path.parts:
        raise InputError(f"'{table}' names a file outside its folder: {name[:60]!r}")
    return path


def _nanoseconds(text: str, unit_ns: int) -> int | None:
    return exact_ns(text, unit_ns) if is_number(text) else None


def _date(text: str, table: Path) -> int:
    found = _DATE.fullmatch(text)
    assert found is not None
    try:
        whole = datetime.fromisoformat(f"{found[1]}T{found[2]}{found[4] or 'Z'}")
    except ValueError as error:
        raise InputError(f"'{table}' has a time that cannot be read: {text[:60]!r}") from error
    return int(whole.timestamp()) * SECOND + int((found[3] or "")[:9].ljust(9, "0"))
