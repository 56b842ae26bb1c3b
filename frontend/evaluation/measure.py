"""Runs the trackers over a clip, side by side on the same detections."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import islice

import numpy as np

from airline.detector import AirLine
from airline.lines import LineSet
from frontend.evaluation.baselines import FlowTracker, NearestTracker
from frontend.evaluation.metrics import Figures, identity_scores
from frontend.evaluation.posed import Observation, PosedClip, consistency
from frontend.evaluation.truth import Clip, Record, Tracked, Tracker, owners
from frontend.frame import Frame
from frontend.tracker import LineTracker

Tick = Callable[[], None]


class OurTracker:
    """The tracker of this project, as the evaluation sees it."""

    def __init__(self) -> None:
        self._tracker = LineTracker()

    def update(self, frame: Frame, lines: LineSet) -> Tracked:
        """Take the lines of the next frame."""
        tracks = self._tracker.update(frame, lines)
        return Tracked(tracks.ids, tracks.line_indices, tracks.segments_px, tracks.fragment_of)


TRACKERS: dict[str, Callable[[], Tracker]] = {"ours": OurTracker, "nearest": NearestTracker, "flow": FlowTracker}


def measure(clip: Clip, detect: AirLine, limit: int | None, tick: Tick) -> dict[str, Figures]:
    """Figures of every tracker on the first `limit` frames of a clip with known identities; all get the same lines.

    Raises:
        InputError: a frame cannot be read.
    """
    trackers = {name: make() for name, make in TRACKERS.items()}
    records: dict[str, list[Record]] = {name: [] for name in trackers}
    for frame, truth in islice(clip, limit):
        lines = detect(frame.image)
        line_owners = owners(lines.segments, truth)
        height, width = frame.image.shape[:2]
        for name, (tracked, ms) in _update(trackers, frame, lines).items():
            records[name].append(Record(tracked, line_owners, truth, (width, height), ms))
        tick()
    return {name: identity_scores(run) for name, run in records.items()}


def measure_posed(clip: PosedClip, detect: AirLine, limit: int | None, tick: Tick) -> dict[str, Figures]:
    """The same on a clip with known poses. What is triangulated are the detections, not what a tracker fuses."""
    trackers = {name: make() for name, make in TRACKERS.items()}
    tracks: dict[str, dict[int, list[Observation]]] = {name: {} for name in trackers}
    times: dict[str, list[float]] = {name: [] for name in trackers}
    for frame in islice(clip, limit):
        lines = detect(frame.image)
        for name, (tracked, ms) in _update(trackers, frame, lines).items():
            times[name].append(ms)
            for track, row in zip(tracked.ids.tolist(), tracked.line_indices, strict=True):
                seen = Observation(lines.segments[row], clip.poses[frame.index])
                tracks[name].setdefault(track, []).append(seen)
        tick()
    return {
        name: {**consistency(list(found.values()), clip.K), "ms": round(float(np.median(times[name])), 4)}
        for name, found in tracks.items()
    }


def _update(trackers: dict[str, Tracker], frame: Frame, lines: LineSet) -> dict[str, tuple[Tracked, float]]:
    """Every tracker's answer, and the milliseconds it took."""
    answers = {}
    for name, tracker in trackers.items():
        started = time.perf_counter()
        tracked = tracker.update(frame, lines)
        answers[name] = (tracked, 1e3 * (time.perf_counter() - started))
    return answers
