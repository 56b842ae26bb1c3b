"""The evaluation's figures on cases with known answers, the trackers to compare with, and triangulation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from airline.scenes.camera import rotation
from frontend.evaluation.baselines import FlowTracker, NearestTracker
from frontend.evaluation.metrics import changes, identity_scores, idf1, jitter, links, pure_length, track_lengths
from frontend.evaluation.posed import Observation, consistency, parallax, reprojection_errors, triangulate
from frontend.evaluation.truth import AMBIGUOUS, UNKNOWN, Record, Tracked, Truth, owners
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
    assert (figures["tracks"], figures["track_length_mean"], figures["pure_length_mean"]) == (3, 10, 10)
    assert (figures["visible_length_mean"], figures["alive_3"], figures["alive_10"]) == (10, 1, 1)
    assert (figures["jitter_across_px"], figures["jitter_along_px"]) == (0, 0)


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
    assert idf1(run(*[{0: 1}] * 4, also=[2])) == pytest.approx(2 * 4 / (8 + 4))
    assert idf1(run({0: UNKNOWN})) is None


def test_a_known_fragment_is_no_second_claim() -> None:
    broken = [{0: 1, 1: 1}] * 4
    assert idf1(run(*broken)) == pytest.approx(2 * 4 / (4 + 8))
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
    assert pure_length(records) == pytest.approx((2 + 1) / 2), "a track on no known line has none"
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
    return jitter(records)


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
    assert jittered(moved, true)[1] == pytest.approx(np.sqrt(0.5) * 2)


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


# triangulation

K = np.array([[400.0, 0, 100], [0, 400, 80], [0, 0, 1]])


def observed(first, second, noise=0, seed=0):
    """A line in space between two points, from eight places on a walk."""
    rng = np.random.default_rng(seed)
    track = []
    for k in range(8):
        pose = np.column_stack([rotation(0.02 * k, 0.01 * k, 0.0), [0.1 * k, 0.25 * k, 0.03 * k]])
        points = (np.stack([first, second]) - pose[:, 3]) @ pose[:, :3] @ K.T
        segment = points[:, :2] / points[:, 2:] + noise * rng.standard_normal((2, 2))
        track.append(Observation(segment.astype(np.float32), pose))
    return track


@pytest.mark.parametrize("seed", range(3))
def test_triangulation_finds_the_line(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = rng.uniform((8, -2, -1), (12, 2, 1), (2, 3))
    track = observed(first, second)
    point, direction = triangulate(track, K)
    for end in (first, second):
        away = end - point
        assert np.linalg.norm(away - (away @ direction) * direction) < 0.01
    line = np.stack([point, direction])
    assert reprojection_errors(track, line, K).max() < 0.01
    delta = track[0].segment[1] - track[0].segment[0]
    track[0].segment[:] += 3 * delta[::-1] * (-1, 1) / np.linalg.norm(delta)
    assert reprojection_errors(track[:1], line, K) == pytest.approx(np.full((1, 2), 3), abs=0.02), "in pixels"


def test_consistency() -> None:
    good = observed(np.array([10.0, -1, 0]), np.array([9.0, 1, 1]), noise=0.3)
    bad = observed(np.array([10.0, 1, 0]), np.array([9.0, 1, 1]))
    bad[4:] = observed(np.array([10.0, 1.6, 0]), np.array([9.0, 1.6, 1]))[4:]
    figures = consistency([good, bad, good[:4]], K)
    assert (figures["tracks_5"], figures["consistent_tracks"], figures["consistent_share"]) == (2, 1, 0.5)
    assert figures["consistent_length_mean"] == 8
    assert consistency([good[:4]], K)["consistent_share"] is None
    # a camera that stands still sees no parallax
    still = [observed(np.array([10.0, -1, 0]), np.array([9.0, 1, 1]))[0]] * 6
    assert parallax(still, K) == pytest.approx(0, abs=1e-4)
    assert consistency([still], K)["consistent_share"] == 1
