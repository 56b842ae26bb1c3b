"""The evaluation's figures on cases with known answers, and the trackers to compare with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from frontend.evaluation.accuracy import accuracy, jitter
from frontend.evaluation.baselines import FlowTracker, NearestTracker
from frontend.evaluation.coverage import coverage
from frontend.evaluation.metrics import changes, identity_scores, idf1, links, track_lengths
from frontend.evaluation.truth import AMBIGUOUS, UNKNOWN, Record, Tracked, Truth, owners
from frontend.tracks import LineTracks
from tests.helpers.made_tracks import blank_tracks
from tests.helpers.tracking_frames import frame as frame_of
from tests.helpers.tracking_frames import line_set

SIZE = (200, 160)
KNOWN_WHEN_EMPTY = {"wrong_links", "switches_per_100", "fragments_per_100", "tracks", "ms"}


def lines(*rows: tuple[float, float, float, float]) -> NDArray[np.float32]:
    return np.array(rows, np.float32).reshape(-1, 2, 2)


def truth(ids: list[int], *rows: tuple[float, float, float, float]) -> Truth:
    return Truth(lines(*rows), np.array(ids, np.int64))


@pytest.mark.parametrize(
    ("detected", "owner"),
    [
        ((10, 20, 110, 20), 5),
        ((110, 20, 10, 20), 5),  # either direction
        ((10, 21.2, 110, 21.2), 5),
        ((10, 21.3, 110, 21.3), UNKNOWN),
        ((10, 18, 110, 22), 5),  # 2.3 degrees; 1 px away in the mean
        ((60, 15, 61, 25), UNKNOWN),
        ((62, 20, 160, 20), UNKNOWN),  # 48 of 98 px are covered
        ((50, 20, 160, 20), 5),  # 60 of 110
        ((150, 20, 190, 20), UNKNOWN),
    ],
)
def test_owner_of_one_line(detected: tuple[float, float, float, float], owner: int) -> None:
    assert owners(lines(detected), truth([5], (10, 20, 110, 20))).tolist() == [owner]


@pytest.mark.parametrize(
    ("true", "found", "expected"),
    [
        (  # pieces of a line count together
            truth([3, 3, 8], (10, 20, 40, 20), (60, 20, 90, 20), (10, 60, 90, 60)),
            lines((10, 20, 90, 20), (62, 20, 88, 20), (10, 60, 50, 60)),
            [3, 3, 8],
        ),
        (  # two lines side by side are ambiguous between them
            truth([3, 8], (10, 20, 90, 20), (10, 21.8, 90, 21.8)),
            lines((10, 20, 90, 20), (10, 20.5, 90, 20.5), (10, 21.1, 90, 21.1), (10, 22.2, 90, 22.2)),
            [3, AMBIGUOUS, AMBIGUOUS, 8],
        ),
        (  # so is a line over two lines end to end
            truth([3, 8], (10, 20, 60, 20), (60, 20, 110, 20)),
            lines((10, 20, 110, 20), (10, 20, 70, 20), (10, 20, 90, 20)),
            [AMBIGUOUS, 3, AMBIGUOUS],
        ),
        (truth([]), lines((0, 0, 9, 9)), [UNKNOWN]),
        (truth([1], (0, 0, 9, 9)), lines(), []),
        (truth([1], (0, 0, 9, 9)), lines((5, 5, 5, 5)), [UNKNOWN]),
    ],
)
def test_owners_among_several_lines(true: Truth, found: NDArray[np.float32], expected: list[int]) -> None:
    assert owners(found, true).tolist() == expected


def run(*frames, fragments=None, also=None):
    """Records in which every track's line lies on its true line, line k at y = 10 k; `also` are lines without track."""
    records = []
    for frame in frames:
        true = [*frame.values(), *(also or [])]
        ids = sorted({line for line in true if line >= 0})
        tracked = Tracked(
            np.array(list(frame), np.int64),
            np.arange(len(frame), dtype=np.int32),
            lines(*((10, 10 * line, 100 - k, 10 * line) for k, line in enumerate(frame.values()))),
            np.array([(fragments or {}).get(track, -1) for track in frame], np.int64),
        )
        visible = truth(ids, *((10, 10 * line, 100, 10 * line) for line in ids))
        records.append(Record(tracked, np.array(true, np.int64), visible, SIZE, 1.0))
    return records


def test_a_perfect_run() -> None:
    records = run(*[{7: 1, 9: 2, 11: 5}] * 10)
    figures = identity_scores(records)
    assert (figures["link_precision"], figures["link_recall"], figures["idf1"]) == (1, 1, 1)
    assert (figures["wrong_links"], figures["switches_per_100"], figures["fragments_per_100"]) == (0, 0, 0)
    assert (figures["tracks"], figures["track_length_mean"]) == (3, 10)
    assert (figures["visible_length_mean"], figures["alive_3"], figures["alive_10"]) == (10, 1, 1)
    assert jitter(records) == {"jitter_across_px": 0, "jitter_along_px": 0}


def test_links() -> None:
    two_swap = links(run({0: 1, 1: 2, 2: 3}, {0: 2, 1: 1, 2: 3}))
    assert (two_swap.right, two_swap.wrong, two_swap.possible, two_swap.found) == (1, 2, 3, 1)
    new_id = links(run({0: 1}, {1: 1}))
    assert (new_id.right, new_id.wrong, new_id.possible, new_id.found) == (0, 0, 1, 0)
    unknown = links(run({0: UNKNOWN, 1: AMBIGUOUS, 2: 4}, {0: 1, 1: 2, 2: UNKNOWN}))
    assert (unknown.right, unknown.wrong, unknown.possible) == (0, 0, 0)
    broken = links(run({0: 1, 1: 1}, {0: 1, 1: 1}))
    assert (broken.right, broken.possible, broken.found) == (2, 1, 1), "both pieces are linked, the line is found once"
    untracked = links(run({0: 1}, {0: 1}, also=[2]))
    assert (untracked.possible, untracked.found) == (2, 1)
    assert links(run({0: 1}, {}, {0: 1})).right == 0, "links are between consecutive frames"


def test_idf1() -> None:
    assert idf1(run({0: 1}, {0: 1}, {1: 1}, {1: 1})) == pytest.approx(0.5), "half of the line's life has the wrong id"
    assert idf1(run(*[{0: 1}] * 3, {0: 2})) == pytest.approx(2 * 3 / (4 + 4))
    assert idf1(run(*[{0: 1, 1: 2}] * 3, *[{0: 2, 1: 1}] * 2)) == pytest.approx(2 * 6 / (10 + 10))
    assert idf1(run(*[{0: 1}] * 4, also=[2])) == pytest.approx(2 * 4 / (8 + 4), abs=1e-4)
    assert idf1(run({0: UNKNOWN})) is None


def test_a_known_fragment_is_no_second_claim() -> None:
    broken = [{0: 1, 1: 1}] * 4
    assert idf1(run(*broken)) == pytest.approx(2 * 4 / (4 + 8), abs=1e-4)
    assert idf1(run(*broken, fragments={1: 0})) == 1
    assert idf1(run({0: 1}, {1: 1}, {1: 1}, fragments={1: 0})) == 1, "a piece alone still is the line"
    assert track_lengths(run(*broken, fragments={1: 0})).tolist() == [4]
    wrong = run(*[{0: 1, 1: 2}] * 4, fragments={1: 0})
    assert idf1(wrong) == pytest.approx(2 * 4 / (8 + 8)), "a piece of another line is a wrong claim"


def test_changes() -> None:
    def counts(*frames: dict[int, int]) -> tuple[int, int]:
        return changes(run(*frames))

    assert counts({0: 1}, {0: 1}, {5: 1}, {5: 1}) == (1, 0)
    assert counts({0: 1}, {}, {5: 1}) == (1, 1), "lost and found again under another id"
    assert counts({0: 1}, {}, {0: 1}) == (0, 0), "found again under its id"
    assert counts({0: 1, 1: 2}, {0: 2, 1: 1}) == (2, 0)
    assert counts({0: 1}, {0: 1, 1: 1}, {0: 1}) == (0, 0), "a second piece takes nothing away"
    assert counts({0: 1, 1: 1}, {1: 1}, {1: 1}) == (1, 0), "the longest piece had the line"
    assert counts({0: 1}, {1: UNKNOWN}, {0: 1}) == (0, 0)


def test_lengths() -> None:
    records = run({0: 1, 1: 2}, {0: 1}, {0: 2, 3: UNKNOWN}, {3: UNKNOWN})
    assert track_lengths(records).tolist() == [3, 1, 2]
    figures = identity_scores(records)
    assert (figures["tracks"], figures["track_length_median"], figures["visible_length_mean"]) == (3, 2, 2)
    assert figures["alive_3"] == pytest.approx(1 / 3, abs=1e-4)
    empty = identity_scores(run({}, {}))
    assert {key for key, value in empty.items() if value is not None} <= KNOWN_WHEN_EMPTY


def jittered(segments: NDArray[np.float64], true: NDArray[np.float64]) -> tuple[float | None, float | None]:
    """Of one track: its (F, 2, 2) segments beside its (F, 2, 2) true line."""
    one, row = np.zeros(1, np.int64), np.zeros(1, np.int32)
    records = [
        Record(
            Tracked(one, row, s[None].astype(np.float32), one - 1), one, Truth(t[None].astype(np.float32), one), SIZE, 1
        )
        for s, t in zip(segments, true, strict=True)
    ]
    figures = jitter(records)
    return figures["jitter_across_px"], figures["jitter_along_px"]


def turning(frames: int) -> NDArray[np.float64]:
    angles = np.linspace(0, 1, frames)
    arm = 30 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    centre = np.stack([np.linspace(60, 120, frames), np.linspace(90, 60, frames)], axis=1)
    return np.stack([centre - arm, centre + arm], axis=1)


def test_jitter_is_the_noise_without_the_motion() -> None:
    rng = np.random.default_rng(0)
    true = turning(2000)
    unit = (true[:, 1] - true[:, 0])[:, None] / 60
    normal = unit[:, :, ::-1] * (-1, 1)
    noisy = true + 0.3 * rng.standard_normal((2000, 2, 1)) * normal + 1.5 * rng.standard_normal((2000, 2, 1)) * unit
    across, along = jittered(noisy, true)
    assert across == pytest.approx(0.3, rel=0.05)
    assert along == pytest.approx(1.5, rel=0.05)
    assert jittered(noisy[:, ::-1], true) == pytest.approx((across, along), rel=1e-3), "whichever end comes first"


def test_a_constant_error_is_no_jitter() -> None:
    true = turning(50)
    unit = (true[:, 1] - true[:, 0])[:, None] / 60
    assert jittered(true + 5 * unit, true) == pytest.approx((0, 0), abs=1e-4)
    flipped = true.copy()
    flipped[25:] = flipped[25:, ::-1]
    assert (jittered(flipped, true)[1] or 0) > 4, "ends that change places are seen"


def test_ends_at_the_border_have_no_place_along() -> None:
    true = np.tile(np.array([[0.0, 50.0], [90.0, 50.0]]), (4, 1, 1))
    moved = true.copy()
    moved[:, 0, 0] += [0, 9, 0, 9]
    assert jittered(moved, true) == (0, 0), "the end at the border may jump"
    moved[:, 1, 0] += [0, 2, 0, 2]
    assert jittered(moved, true)[1] == pytest.approx(np.sqrt(0.5) * 2, abs=1e-4)


def of_ours(tracks: list[LineTracks], owners_of: list[list[int]], true: Truth) -> list[Record]:
    """Records of frames in which the same can be seen."""
    return [Record(t, np.array(of, np.int64), true, SIZE, 1.0) for t, of in zip(tracks, owners_of, strict=True)]


def test_what_was_measured_has_an_owner_of_its_own() -> None:
    true = truth([4, 7], (10, 20, 90, 20), (10, 60, 90, 60))
    observed = lines((10, 20, 90, 20), (10, 60.4, 90, 60.2), (10, 90, 90, 90))
    tracks = blank_tracks(
        3, observed_px=observed, line_indices=np.array([0, -1, -1]), measured=np.array([False, True, True])
    )
    record = of_ours([tracks], [[4]], true)[0]
    assert record.owners.tolist() == [4, 7, UNKNOWN]
    none_detected = of_ours([tracks.take(np.array([1]))], [[]], true)[0]
    assert none_detected.owners.tolist() == [7]

    both = of_ours([tracks, tracks], [[4], [4]], true)
    counts = links(both)
    assert (counts.right, counts.wrong) == (2, 0), "links of measured lines count"
    assert (counts.found, counts.possible) == (1, 1), "recall asks for detected lines alone"
    assert idf1(both) == 1
    assert idf1(of_ours([tracks, tracks], [[], []], true)) is None


def test_coverage() -> None:
    records = run(*[{0: 1}] * 6, {5: 1}, {0: 1}, {}, also=[2])
    figures = coverage(records)
    assert (figures["lines"], figures["visible_mean"], figures["covered_mean"]) == (2, 8.5, 3.5)
    assert figures["coverage"] == figures["coverage_of_all"] == pytest.approx(7 / 17, abs=1e-4)
    assert figures["covered_most"] == 0.5
    assert (figures["under_3"], figures["confirmed_under_3"]) == (0.5, None)

    unseen = [replace(record, line_owners=record.line_owners[:1]) for record in run(*[{0: 1}] * 6, also=[2])]
    assert (coverage(unseen)["coverage"], coverage(unseen)["coverage_of_all"]) == (1, 0.5)
    assert coverage(unseen)["covered_most"] == 1
    assert coverage(run(*[{0: 1, 9: 1}] * 3, *[{9: 1}] * 3, fragments={9: 0}))["coverage"] == 1, "pieces are the track"
    assert coverage(run(*[{0: 1}] * 4))["coverage"] is None, "seen in too few frames"
    short = [replace(record, truth=truth([1], (0, 0, 14, 0))) for record in run(*[{0: 1}] * 6)]
    assert coverage(short)["lines"] == 0, "too short to be called visible"


def test_confirmed_tracks_that_are_short() -> None:
    ids = [[0, 1], [0, 1, 2], [0, 2, 3], [0]]
    confirmed = [[0], [0, 1], [0], [0]]
    tracks = [
        blank_tracks(len(i), ids=np.array(i), states=np.isin(i, c).astype(np.uint8))
        for i, c in zip(ids, confirmed, strict=True)
    ]
    figures = coverage(of_ours(tracks, [[UNKNOWN]] * 4, truth([])))
    assert (figures["under_3"], figures["confirmed_under_3"]) == (0.75, 0.5)


def test_accuracy_of_fused_and_observed_lines() -> None:
    rng = np.random.default_rng(0)
    true, count, sigma, turn = truth([0], (30, 80, 130, 80)), 3000, 0.4, 0.004
    middle, angle = sigma * rng.standard_normal(count), turn * rng.standard_normal(count)
    observed = np.tile(np.float32([[130, 80], [30, 80]]), (count, 1, 1))
    observed[:, 0, 1] += middle + 50 * angle
    observed[:, 1, 1] += middle - 50 * angle
    fused = observed.copy()
    fused[:, 0, 0] += 3
    fused[:, :, 1] = 80 + (observed[:, :, 1] - 80) / 2
    honest = np.tile(np.diag([sigma**2, turn**2]).astype(np.float32), (count, 1, 1))
    tracks = blank_tracks(
        count,
        segments_px=fused,
        observed_px=observed,
        covariances=honest,
        observed_covariances=honest,
        hits=np.where(np.arange(count) % 3, 4, 3),
    )
    found = accuracy(of_ours([tracks], [[0]], true))
    assert found["fused"]["lines"] == 2000, "young tracks have nothing fused"
    assert found["observed"] == found["detected"]
    assert found["measured"]["lines"] == 0
    assert found["measured"]["across_px"] is None
    seen, better = found["observed"], found["fused"]
    assert seen["across_px"] == pytest.approx(np.hypot(sigma, 50 * turn), rel=0.05)
    assert better["across_px"] == pytest.approx(np.hypot(sigma, 50 * turn) / 2, rel=0.05)
    assert seen["along_px"] == pytest.approx(0, abs=1e-3)
    assert better["along_px"] == pytest.approx(3 / np.sqrt(2), rel=1e-3)
    for key in ("offset_68", "offset_rms", "angle_68", "angle_rms"):
        assert seen[key] == pytest.approx(1, rel=0.05), key
        assert better[key] == pytest.approx(0.5, rel=0.05), key


THREE = lines((20, 20, 120, 30), (30, 60, 30, 140), (60, 120, 150, 60))


@pytest.mark.parametrize("make", [NearestTracker, FlowTracker])
@pytest.mark.parametrize("speed", [0, 3])
def test_baselines_follow_simple_motion(make: type[NearestTracker] | type[FlowTracker], speed: int) -> None:
    tracker, rng = make(), np.random.default_rng(1)
    for i in range(10):
        order = rng.permutation(3)
        segments = (THREE + np.float32([speed * i, 0]))[order]
        segments[::2] = segments[::2, ::-1]
        tracked = tracker.update(frame_of(i, shift=speed * i), line_set(segments))
        by_line = dict(zip(order[tracked.line_indices].tolist(), tracked.ids.tolist(), strict=True))
        ends = {int(track): segment for track, segment in zip(tracked.ids, tracked.segments_px, strict=True)}
        if i == 0:
            first, start = by_line, ends
        assert by_line == first
        for track, segment in ends.items():
            assert ((segment[1] - segment[0]) * (start[track][1] - start[track][0])).sum() > 0, "ends keep their order"


@pytest.mark.parametrize("make", [NearestTracker, FlowTracker])
def test_baselines_wait_for_missed_lines(make: type[NearestTracker] | type[FlowTracker]) -> None:
    tracker = make()
    ids = [
        tracker.update(frame_of(i), line_set(THREE if seen else THREE[:0])).ids.tolist()
        for i, seen in enumerate([1, 1, *[0] * 5, 1, *[0] * 6, 1])
    ]
    assert ids[7] == [0, 1, 2]
    assert ids[-1] == [3, 4, 5]
