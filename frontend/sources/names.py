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
_NUMBER = re.compile(r"(?:(?<![^_ =])[-+])?(?<!\d)(?<!\d\.)\d+(?:\.\d+)?(?!\.?\d)")
_PAIR = re.compile(r"(?<![\d.])(\d{9,10})([-_.])(\d{1,9})(?!\.?\d)")
_DATE = re.compile(
    r"(?<!\d)(\d{4})[-_.]?(\d\d)[-_.]?(\d\d)(?: at |[-_ T.])?(\d\d)[-_:.h]?(\d\d)[-_:.m]?(\d\d)"
    r"(?:(?:[.,s]|[-_]?(?=\d{3}(?!\d)|\d{5,9}(?!\d)))(?P<part>\d+))?(?!\d)"
)
_HALF_DAY = re.compile(r"[\s_.-]*[ap]\.?m(?![a-z])", re.IGNORECASE)  # of clocks of twelve hours, which are not read
_CLOCK = re.compile(r"(?<!\d)[0-5]\d[-_:.m][0-5]\d[.,]\d")  # whose seconds alone are no time

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
    dates = [("".join(found.groups()[:6]), found["part"] or "") for name in names if (found := _DATE.search(name))]
    yield "dates", partial(_date, whole=all(len(part) > 2 for _, part in dates) and _counts(dates))
    pairs = [found.groups() for name in names if (found := _PAIR.search(name))]
    if pairs and not _counts([(whole, part) for whole, _, part in pairs]):
        point = any(between == "." for _, between, _ in pairs)
        widths = {len(part) for *_, part in pairs}
        if len(widths) == 1 and widths <= {3, 6, 9} and not point:
            yield "seconds and their fractions", partial(_pair, part_ns=10 ** (9 - max(widths)))
        elif max(widths) > 4:  # as numbers are printed, without the zeros before them
            unit = "nanoseconds" if max(widths) > 6 else "microseconds"
            read = partial(_pair, part_ns=UNITS[unit])
            zeros = any(part[0] == "0" < part for *_, part in pairs)
            if not point or (not zeros and _longest_step(names, read) < _longest_step(names, _number)):
                yield f"seconds and {unit}", read
    for last in (False, True):
        for unit in UNITS:
            decimal = any("." in match[0] for name in names for match in _numbers(name, unit))
            yield f"{'decimal ' * decimal}{unit}", partial(_number, last=last, unit=unit)
        texts = [numbers[-1 if last else 0] for name in names if (numbers := _NUMBER.findall(name))]
        parts = [text.split(".") for text in texts if "." in text and not any(map(_CLOCK.search, names))]
        if parts and not (len({whole for whole, _ in parts}) == 1 and _counts([("", part) for _, part in parts])):
            stamps = [exact_ns(text, SECOND) for text in texts]
            if None not in stamps and len(texts) > 1 and plausible(filter(None, stamps)):
                yield "decimal seconds", partial(_number, last=last, since=False)


def _counts(parts: Sequence[tuple[str, str]]) -> bool:
    """Whether the numbers after those of seconds count the images one by one, as a whole or in each second."""
    order = sorted((whole, int(part)) for whole, part in parts)
    steps = [later - earlier for (_, earlier), (_, later) in pairwise(order) if later > earlier]
    return bool(steps) and median(steps) == 1


def _longest_step(names: Sequence[str], read: _Read) -> int:
    """Between images, ns; as long as can be where not all names have a time, or these make no sense."""
    stamps = sorted(found[0] for name in names if (found := read(name)))
    known = len(stamps) == len(names) > 1 and plausible(stamps)
    return max(later - earlier for earlier, later in pairwise(stamps)) if known else _MOST_STAMP


def _date(name: str, *, whole: bool) -> _Found | None:
    """A date, without the number after its seconds where these are to be whole."""
    found = _DATE.search(name)
    if found is None or _HALF_DAY.match(name, found.end()):
        return None
    try:
        day = datetime(*map(int, found.groups()[:6]), tzinfo=UTC)  # type: ignore[misc,arg-type]
    except ValueError:
        return None
    stamp = int(day.timestamp()) * SECOND + (0 if whole else int((found["part"] or "")[:9].ljust(9, "0")))
    return (stamp, _rest(name, found)) if _EPOCH[0] <= stamp < _EPOCH[1] else None


def _pair(name: str, *, part_ns: int) -> _Found | None:
    found = _PAIR.search(name)
    if found is None or since_1970(int(found[1])) != "seconds":
        return None
    return int(found[1]) * SECOND + int(found[3]) * part_ns, _rest(name, found)


def _numbers(name: str, unit: str) -> list[re.Match[str]]:
    """The numbers of a name that are times since 1970 in a unit."""
    found = [match for match in _NUMBER.finditer(name) if len(match[0]) < 40]
    return [match for match in found if since_1970(int(match[0].split(".")[0])) == unit]


def _number(name: str, *, last: bool = False, unit: str = "seconds", since: bool = True) -> _Found | None:
    """The first or last time since 1970 of a name in a unit, or any number of that unit."""
    found = _numbers(name, unit) if since else list(_NUMBER.finditer(name))
    stamp = exact_ns(found[-1 if last else 0][0], UNITS[unit]) if found else None
    return None if stamp is None else (stamp, _rest(name, found[-1 if last else 0]))


def _rest(name: str, match: re.Match[str]) -> str:
    return f"{name[: match.start()]}#{name[match.end() :]}"
