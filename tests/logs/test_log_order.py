"""Late messages and clocks that step back: what is sorted, what keeps its order, what is left out."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from logs.files import LogMessage, TopicType
from logs.messages.types import EncodedImage
from logs.order import WINDOW, Entry, StampOrder

EPOCH = 1_700_000_000 * 10**9
STEP = 10**8
LOGGED = [EPOCH + k * STEP for k in range(100)]


def ordered(stamps: list[int], logged: list[int], data: list[bytes] | None = None):
    """What came out, what was refused by number, and the order itself."""
    refused: dict[int, str] = {}
    order = StampOrder(lambda entry, reason: refused.update({entry.number: reason}))
    found = []
    for number, (stamp_ns, log_ns) in enumerate(zip(stamps, logged, strict=True)):
        message = LogMessage("/camera", TopicType("", ""), log_ns, log_ns, b"")
        content = b"%d" % number if data is None else data[number]
        found += order.add(Entry(number, message, EncodedImage(stamp_ns, "", content)))
        assert len(order._held) <= 2 * WINDOW
    return [*found, *order.flush()], refused, order


def test_late_messages_are_put_where_they_belong() -> None:
    arrival = [0, 2, 1, 3, 4, 6, 7, 8, 5, 9, 11, 10]
    true = [EPOCH + number * STEP for number in arrival]
    logged = [max(true[: k + 1]) + 1000 + k for k in range(12)]
    found, refused, order = ordered(true, logged)
    assert [entry.stamp_ns for entry in found] == sorted(true)
    assert [entry.number for entry in found] == list(range(12))
    assert [int(entry.record.data) for entry in found] == [arrival.index(number) for number in range(12)]
    assert order.late == 3
    assert not refused


@pytest.mark.parametrize(
    "logged", [[EPOCH + k * STEP for k in range(60)], [EPOCH + (k + (20 <= k < 45)) * STEP for k in range(60)]]
)
def test_what_is_later_than_the_window_is_left_out(logged: list[int]) -> None:
    arrival = [number for number in range(60) if number != 20]
    arrival.insert(45, 20)
    true = [EPOCH + number * STEP for number in arrival]
    found, refused, _ = ordered(true, logged)
    assert [entry.stamp_ns for entry in found] == [EPOCH + number * STEP for number in range(60) if number != 20]
    assert refused == {45: "it was logged too late for its time"}


def test_the_same_message_again_is_left_out() -> None:
    arrival = [0, 1, 1, 2, 3, 1, 4]
    stamps = [EPOCH + number * STEP for number in arrival]
    found, refused, _ = ordered(stamps, [EPOCH + k for k in range(7)], [b"%d" % number for number in arrival])
    assert [entry.stamp_ns for entry in found] == [EPOCH + number * STEP for number in range(5)]
    assert list(refused.values()) == ["it repeats the frame before it"] * 2


@pytest.mark.parametrize("ahead_s", [0.5, 3600, 2 * 86_400])
@pytest.mark.parametrize("places", [[0], [1], [20], [20, 21, 22], [38]])
def test_stamps_that_lie_ahead_are_mended_by_the_log(ahead_s: float, places: list[int]) -> None:
    true = [EPOCH + k * STEP for k in range(40)]
    stamps = [time + (int(ahead_s * 1e9) * 2 if k in places else 0) for k, time in enumerate(true)]
    found, refused, order = ordered(stamps, [time + 10**7 + k * 7919 % 11 for k, time in enumerate(true)])
    assert [int(entry.record.data) for entry in found] == list(range(40))
    assert max(abs(entry.stamp_ns - time) for entry, time in zip(found, true, strict=True)) < 11
    assert order.ahead == len(places)
    assert not refused


def test_one_stamp_far_back_is_left_out() -> None:
    stamps = [EPOCH + k * STEP for k in range(40)]
    stamps[25] -= 3600 * 10**9
    found, refused, _ = ordered(stamps, [EPOCH + k * STEP + 5 for k in range(40)])
    assert [entry.stamp_ns for entry in found] == stamps[:25] + stamps[26:]
    assert list(refused) == [25]


def test_no_more_than_a_window_is_left_out_where_a_step_cannot_be_told() -> None:
    """Of a simulation at half speed, so that delays climb; one late message is sorted there all the same."""
    stamps = [EPOCH + k * STEP // 2 - (3600 * 10**9 if k >= 100 else 0) for k in range(200)]
    found, refused, _ = ordered(stamps, [EPOCH + k * STEP for k in range(200)])
    assert len(found) >= 200 - 2 * WINDOW
    found, refused, order = ordered([*stamps[:50], *stamps[51:54], stamps[50], *stamps[54:100]], LOGGED)
    assert [entry.stamp_ns for entry in found] == stamps[:100]
    assert (order.late, refused) == (1, {})


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("delay", ["pool", "many late", "two publishers"])
def test_delays_of_all_sorts_are_sorted(seed: int, delay: str) -> None:
    random = Random(seed)
    delays = {
        "pool": lambda k: 2 * STEP * random.random(),
        "many late": lambda k: 3 * STEP * (random.random() < 0.25) + random.random() * STEP / 10,
        "two publishers": lambda k: (k % 2) * (5 + seed % 4) * STEP,
    }[delay]
    sent = [EPOCH + k * STEP + (k % 2) * (seed % 5) * STEP // 5 for k in range(100)]
    rows = sorted((stamp_ns + int(delays(k)), stamp_ns) for k, stamp_ns in enumerate(sent))
    found, refused, _ = ordered([stamp_ns for _, stamp_ns in rows], [log_ns for log_ns, _ in rows])
    assert [entry.stamp_ns for entry in found] == sorted(sent)
    assert not refused


@given(
    late=st.lists(st.integers(0, WINDOW), min_size=1, max_size=50),
    dropped=st.sets(st.integers(3, 49)),
    uniform=st.booleans(),
    random=st.randoms(use_true_random=False),
)
@settings(max_examples=400)
def test_any_order_within_the_window_comes_out_sorted(
    late: list[int], dropped: set[int], uniform: bool, random: Random
) -> None:
    there = [k for k in range(len(late)) if k not in dropped]
    arrival = sorted(there, key=lambda k: (k + late[k], random.random()))
    jitter = [random.randint(-STEP // 20, STEP // 20) for _ in late]
    stamps = [EPOCH + number * STEP + jitter[number] for number in arrival]
    logged = [EPOCH + k * STEP for k in range(len(arrival))]  # arrivals at a steady rate, or as they were sent
    if not uniform:
        logged = [max(stamps[: k + 1]) + 10**6 + k for k in range(len(arrival))]
    found, refused, _ = ordered(stamps, logged)
    assert [entry.stamp_ns for entry in found] == sorted(stamps)
    assert [entry.number for entry in found] == list(range(len(arrival)))
    assert not refused


@given(
    before=st.integers(WINDOW + 1, 50),
    behind=st.integers(1, 50),
    back=st.floats(1.05, 80),
    random=st.randoms(use_true_random=False),
)
@settings(max_examples=400)
def test_a_clock_that_steps_back_keeps_the_order(before: int, behind: int, back: float, random: Random) -> None:
    true = [EPOCH + k * STEP for k in range(before + behind)]
    stamps = [time - (int(back * STEP) if k >= before else 0) for k, time in enumerate(true)]
    stamps = [stamp_ns + random.randint(-STEP // 50, STEP // 50) for stamp_ns in stamps]
    found, refused, _ = ordered(stamps, [time + 10**7 + random.randint(0, STEP // 4) for time in true])
    assert [entry.stamp_ns for entry in found] == stamps
    assert not refused


@given(st.lists(st.integers(-(2**62), 2**64) | st.integers(EPOCH, EPOCH + 30 * STEP), max_size=60))
@settings(max_examples=200)
def test_no_message_is_lost_or_made(stamps: list[int]) -> None:
    found, refused, _ = ordered(stamps, [EPOCH + k for k in range(len(stamps))])
    assert sorted([*(int(entry.record.data) for entry in found), *refused]) == list(range(len(stamps)))
    assert [entry.number for entry in found] == sorted({entry.number for entry in found})
