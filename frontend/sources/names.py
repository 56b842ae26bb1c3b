"""Times in the names of images, exactly: stamps since 1970, dates, and seconds of a clock that starts at zero."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from decimal import Decimal
from functools import partial
from itertools import pairwise
from statistics import median
from typing import NamedTuple

from airline.errors import InputError

SECOND = 10**9  # ns
UNITS = {"nanoseconds": 1, "microseconds": 10**3, "milliseconds": 10**6, "seconds": SECOND}
_EPOCH = 631_152_000 * SECOND, 4_102_444_800 * SECOND  # 1990 and 2100
_MOST_STAMP = 2**63 - 1
_STEPS = SECOND // 2000, 1000 * SECOND  # what may lie between two images, half of them at least
_SHARE = 0.8  # of the names that have times, for those to count
_NUMBER = re.compile(r"(?<!\d)(?<!\d\.)\d+(?:\.\d+)?(?!\.?\d)")
_PAIR = re.compile(r"(?<!\d)(\d{9,10})[-_](\d{1,9})(?!\.?\d)")
_DATE = re.compile(
    r"(?<!\d)(\d{4})[-_.]?(\d\d)[-_.]?(\d\d)[-_ T.]?(\d\d)[-_:.h]?(\d\d)[-_:.m]?(\d\d)"
    r"(?:[-_.,]?(\d{3}|\d{6}|\d{9}))?(?!\d)"
)

_Found = tuple[int, str]  # a stamp in ns, and the rest of the name
_Read = Callable[[str], _Found | None]


class Times(NamedTuple):
    """Stamps in ns by the place of their name, without those of names that have none; how they were read, in words."""

    stamps: dict[int, int]
    words: str


def times_in(names: Sequence[str]) -> Times | None:
    """The times that names without their suffix tell; None where they tell none, or no more than a few do.

    Raises:
        InputError: the images are of several cameras, by what else is in their names.
    """
    if not names:
        return None
    for words, read in _readers(names):
        found = {place: got for place, name in enumerate(names) if (got := read(name)) is not None}
        if len(found) < max(_SHARE * len(names), 1):
            continue
        stamps = {place: stamp for place, (stamp, _) in found.items()}
        distinct = len(set(stamps.values()))
        if distinct == 1 < len(stamps):
            continue  # when the recording began
        if distinct < len(stamps) and not any(stamp % SECOND for stamp in stamps.values()):
            continue  # a counter goes with it
        rests = Counter(rest for _, rest in found.values())
        if 1 < len(rests) <= 8 and min(rests.values()) > 1:
            one, other, *_ = (f"'{name}'" for name in dict.fromkeys(rests))
            raise InputError(
                f"images of several cameras have times in their names ({one.replace('#', '*')}, "
                f"{other.replace('#', '*')}): name those of one by a glob pattern"
            )
        return Times(stamps, words)
    return None


def since_1970(value: int) -> str | None:
    """The unit in which a whole number is a time between 1990 and 2100."""
    return next((unit for unit, ns in UNITS.items() if _EPOCH[0] <= value * ns < _EPOCH[1]), None)


def plausible(stamps: Iterable[int]) -> bool:
    """Whether images may have these times, in ns: by the median of the steps; True where there is no step."""
    steps = [later - earlier for earlier, later in pairwise(sorted(stamps))]
    return not steps or _STEPS[0] <= median(steps) <= _STEPS[1]


def exact_ns(text: str, unit_ns: int) -> int | None:
    """A decimal number of a unit in ns, None where an int64 cannot hold it: a float has too few digits."""
    value = Decimal(text)
    limit = _MOST_STAMP // unit_ns
    if not (value.is_finite() and -limit <= value <= limit):  # before multiplying, which may overflow
        return None
    return int((value * unit_ns).to_integral_value())


def _readers(names: Sequence[str]) -> Iterable[tuple[str, _Read]]:
    """What may be in the names, in words, and how it is read."""
    parts = [found.group(7) or "" for name in names if (found := _DATE.search(name))]
    if not all(parts) or not _counts(parts):
        yield "dates", _date
    pairs = [found.group(2) for name in names if (found := _PAIR.search(name))]
    if pairs and not _counts(pairs):
        widths = {len(text) for text in pairs}
        if len(widths) == 1 and widths <= {3, 6, 9}:
            yield "seconds and their fractions", partial(_pair, part_ns=10 ** (9 - max(widths)))
        elif max(widths) > 4:  # as numbers are printed
            unit = "nanoseconds" if max(widths) > 6 else "microseconds"
            yield f"seconds and {unit}", partial(_pair, part_ns=UNITS[unit])
    for last in (False, True):
        for unit in UNITS:
            read = partial(_number, last=last, unit=unit)
            decimal = unit == "seconds" and any("." in match[0] for name in names for match in _since_1970(name, unit))
            yield f"{'decimal ' * decimal}{unit}", read
        yield from _from_zero(names, last)


def _from_zero(names: Sequence[str], last: bool) -> Iterable[tuple[str, _Read]]:
    """Decimal seconds, or nanoseconds of 16 digits and more, of a clock that starts at zero."""
    texts = [found[-1 if last else 0] for name in names if (found := _NUMBER.findall(name))]
    parts = [text.split(".") for text in texts if "." in text]
    if parts and not (len({whole for whole, _ in parts}) == 1 and _counts([part for _, part in parts])):
        stamps = [exact_ns(text, SECOND) for text in texts]
        if None not in stamps and len(texts) > 1 and plausible(filter(None, stamps)):
            yield "decimal seconds", partial(_any_number, last=last, unit_ns=SECOND)
    elif texts and all(len(text) >= 16 for text in texts):  # four months
        yield "nanoseconds", partial(_any_number, last=last, unit_ns=1)


def _counts(texts: Sequence[str]) -> bool:
    """Whether numbers count the images one by one."""
    return all(b - a == 1 for a, b in pairwise(sorted(map(int, texts))))


def _date(name: str) -> _Found | None:
    found = _DATE.search(name)
    if found is None:
        return None
    *fields, part = found.groups()
    try:
        seconds = int(datetime(*map(int, fields), tzinfo=UTC).timestamp())  # type: ignore[misc, arg-type]
    except ValueError:
        return None
    stamp = seconds * SECOND + int((part or "").ljust(9, "0"))
    return (stamp, _rest(name, found)) if _EPOCH[0] <= stamp < _EPOCH[1] else None


def _pair(name: str, *, part_ns: int) -> _Found | None:
    found = _PAIR.search(name)
    if found is None or since_1970(int(found.group(1))) != "seconds":
        return None
    return int(found.group(1)) * SECOND + int(found.group(2)) * part_ns, _rest(name, found)


def _since_1970(name: str, unit: str) -> list[re.Match[str]]:
    """The numbers of a name that are times since 1970 in a unit; those of seconds may have decimals."""
    found = [
        match for match in _NUMBER.finditer(name) if len(match[0]) < 40 and ("." not in match[0] or unit == "seconds")
    ]
    return [match for match in found if since_1970(int(match[0].split(".")[0])) == unit]


def _number(name: str, *, last: bool, unit: str) -> _Found | None:
    """The first or last time since 1970 of a name in a unit."""
    found = _since_1970(name, unit)
    if not found:
        return None
    match = found[-1 if last else 0]
    stamp = exact_ns(match[0], UNITS[unit])
    return None if stamp is None else (stamp, _rest(name, match))


def _any_number(name: str, *, last: bool, unit_ns: int) -> _Found | None:
    found = list(_NUMBER.finditer(name))
    if not found:
        return None
    match = found[-1 if last else 0]
    stamp = exact_ns(match[0], unit_ns)
    return None if stamp is None else (stamp, _rest(name, match))


def _rest(name: str, match: re.Match[str]) -> str:
    return f"{name[: match.start()]}#{name[match.end() :]}"
