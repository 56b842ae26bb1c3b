"""Stamps of a log's frames: one rising clock, whatever the messages' clocks do."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from frontend.sources.reading import UndecodableError
from logs.files import LogMessage, TopicType
from logs.stamps import StampClock, TimeSource

SECOND = 10**9
DAY = 86_400 * SECOND
EPOCH = 1_700_000_000 * SECOND


def message(log_ns: int, publish_ns: int = 0) -> LogMessage:
    return LogMessage("/camera", TopicType("", ""), log_ns, publish_ns, b"")


def stamps(headers: list[int], logged: list[int], source: TimeSource = "header") -> tuple[list[int | None], StampClock]:
    """The stamp of each message, None for those that are refused."""
    clock = StampClock("drive", source)
    found: list[int | None] = []
    for header_ns, log_ns in zip(headers, logged, strict=True):
        try:
            found.append(clock.stamp(header_ns, message(log_ns, publish_ns=log_ns + 7)))
        except UndecodableError:
            found.append(None)
    return found, clock


@pytest.mark.parametrize(
    ("broken", "fault"),
    [
        (0, "are zero"),
        (-5, "are out of range"),
        (2**63, "are out of range"),
        (EPOCH - SECOND, "run backwards"),
        (EPOCH + 2 * DAY, "jump by more than a day"),
    ],
)
def test_one_broken_header_is_bridged_by_the_log(broken: int, fault: str, caplog: pytest.LogCaptureFixture) -> None:
    headers = [EPOCH, EPOCH + 100, broken, EPOCH + 300]
    found, clock = stamps(headers, [5000, 5100, 5210, 5300])
    assert found == [EPOCH, EPOCH + 100, EPOCH + 210, EPOCH + 300]
    assert clock.faults == {fault: 1}
    assert len(caplog.records) == 1


@pytest.mark.parametrize("restarted", [SECOND, EPOCH - 3 * DAY, EPOCH + 30 * DAY])
def test_a_clock_that_is_set_anew_goes_on_by_the_log(restarted: int, caplog: pytest.LogCaptureFixture) -> None:
    headers = [EPOCH, EPOCH + 100, restarted, restarted + 90]
    assert stamps(headers, [1000, 1100, 1200, 1300])[0] == [EPOCH, EPOCH + 100, EPOCH + 200, EPOCH + 300]
    assert len(caplog.records) == 1


def test_a_pause_of_days_that_the_log_saw_too_is_no_fault() -> None:
    headers = [EPOCH, EPOCH + 2 * DAY]
    found, clock = stamps(headers, [0, 2 * DAY])
    assert found == headers
    assert not clock.faults


@pytest.mark.parametrize("unit", [SECOND, SECOND // 10, SECOND // 100])
@pytest.mark.parametrize("begin", [0, 400_000_000, 987_654_321])
def test_headers_that_count_coarsely_are_spread_by_the_log(unit: int, begin: int) -> None:
    """30 Hz or twice the unit, whichever is faster, from anywhere within the unit, cut off or rounded."""
    step = min(SECOND // 30, unit // 2 + 1)
    true = [EPOCH + begin + k * step for k in range(100)]
    for shift in (0, unit // 2):
        notes: list[str] = []
        clock = StampClock("drive", "header", notes)
        found = [clock.stamp((time + shift) // unit * unit, message(time + 77)) for time in true]
        assert all(0 <= second - first - step < unit or second - first == step for first, second in pairwise(found))
        after = next(k for k in range(1, 100) if (true[k] + shift) // unit == (true[k - 1] + shift) // unit)
        assert all(second - first == step for first, second in pairwise(found[after - 1 :]))
        assert all(abs(stamp - time) <= unit for stamp, time in zip(found, true, strict=True))
        assert len(notes) == 1
        assert not clock.faults


def test_one_header_that_comes_twice_changes_nothing_else() -> None:
    headers = [EPOCH + 1234567 * k for k in (0, 1, 1, 3, 4)]
    assert stamps(headers, [100 * k for k in range(5)])[0] == [*headers[:2], headers[1] + 100, *headers[3:]]


@pytest.mark.parametrize(
    ("period", "slower"), [(SECOND // 10, 1), (SECOND // 20, 1), (33 * SECOND // 1000, 1), (SECOND // 10, 2)]
)
@pytest.mark.parametrize("twice", [10, 11, 13])
def test_one_round_header_that_comes_twice_changes_nothing_else(period: int, slower: int, twice: int) -> None:
    """At exact rates, and in a simulation at half the speed."""
    true = [EPOCH + k * period for k in range(60)]
    headers = [*true[: twice + 1], true[twice], *true[twice + 2 :]]
    found, _ = stamps(headers, [EPOCH + k * period * slower + k * 7919 % 5 * period // 20 for k in range(60)])
    assert [a for a, b in zip(found, true, strict=True) if a != b] == [found[twice + 1]]
    assert abs((found[twice + 1] or 0) - true[twice + 1]) <= period // 4


@pytest.mark.parametrize("logged", ["as headers", "still"])
@pytest.mark.parametrize("headers", ["seconds", "zero"])
def test_frames_are_spread_where_the_log_counts_no_finer(headers: str, logged: str) -> None:
    true = [EPOCH + 300_000_000 + k * SECOND // 20 for k in range(100)]
    seconds = [time // SECOND * SECOND for time in true]
    notes: list[str] = []
    clock = StampClock("drive", "header", notes, lambda: 20.0)
    found = [
        clock.stamp(0 if headers == "zero" else time, message(EPOCH if logged == "still" else time)) for time in seconds
    ]
    assert {b - a for a, b in pairwise(found)} == {SECOND // 20}
    assert abs(found[0] - true[0]) < SECOND
    assert any("spread evenly, at 20 Hz" in note for note in notes)


def test_repeated_frames_and_stopped_clocks_are_refused() -> None:
    assert stamps([0, 0, 0], [1, 1, 3], "log")[0] == [1, None, 3]
    assert stamps([0, 0, 0], [1, 1, 3], "publish")[0] == [8, None, 10]
    assert stamps([0, 0], [2**64 - 1, 3])[0] == [None, 3]


times = st.one_of(st.integers(0, 2**64 - 1), st.integers(EPOCH, EPOCH + 100), st.just(0), st.integers(-(2**40), -1))


@given(
    messages=st.lists(st.tuples(times, st.integers(0, 2**64 - 1) | st.integers(0, 1000)), max_size=30),
    source=st.sampled_from(["header", "publish", "log"]),
)
def test_stamps_always_rise(messages: list[tuple[int, int]], source: TimeSource) -> None:
    found, _ = stamps([header for header, _ in messages], [logged for _, logged in messages], source)
    kept = [stamp for stamp in found if stamp is not None]
    assert all(0 <= stamp < 2**63 for stamp in kept)
    assert all(first < second for first, second in pairwise(kept))
