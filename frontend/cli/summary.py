"""What a run came to: counts, speed and track lengths, in constant memory."""

from __future__ import annotations

import time
from collections import Counter, deque
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from frontend.protocols import FrameResult, Source
from frontend.stereo.counts import PartnerCounts

if TYPE_CHECKING:
    from rich.table import Table

WINDOW = 10_000  # frames over which medians are taken


@dataclass(frozen=True)
class Summary:
    """Figures of a run.

    Attributes:
        frames: frames processed.
        fps: frames per second of wall time, sinks included.
        stage_ms: median milliseconds per stage.
        stage_share: of the time of all stages, which work on different frames at once; 0 to 1.
        latency_ms: median milliseconds from when a frame had been read to when its tracks were known.
        lines_per_frame: mean number of detected lines.
        live_tracks_per_frame: mean number of tracks handed out as seen, tentative ones included.
        stable_tracks_per_frame: of these, the stable ones.
        measured_per_frame: of these, the ones that were measured and not detected.
        measured_share: the same, as a share of all observations.
        left_out_per_frame: mean number of tracks seen beyond `max_lines`.
        points_per_frame: mean number of points followed beside the lines.
        partners_per_frame: mean number of confirmed tracks with a partner in the right image; None without one, as the
            next two.
        partner_share: these as a share of the confirmed tracks.
        depth_known_share: of the confirmed tracks, the share whose disparities tell how far away both ends are.
        tracks: number of tracks handed out that were confirmed.
        ids: number of all tracks handed out, those that stayed tentative too: so many ids are in the files.
        resets: how often the tracks began anew.
        first_reset: why they did so first; None where they did not.
        track_length_median: median number of frames in which a confirmed track was seen.
        skipped_frames: frames that could not be read.
        dropped_frames: frames of a live source that there was no time for.
        unpaired_left, unpaired_right: frames of a stereo pair's cameras without one of the other.
        reconnects: how often a network stream was lost and came back.
        calibration: where the camera of a folder's or a file's frames is from; None for logs and where it is unknown.
        kind: what the input was taken for.
        live: whether it was a live source.
        notes: a sentence on each thing that was guessed or done to the input.
    """

    frames: int
    fps: float
    stage_ms: dict[str, float]
    stage_share: dict[str, float]
    latency_ms: float
    lines_per_frame: float
    live_tracks_per_frame: float
    stable_tracks_per_frame: float
    measured_per_frame: float
    measured_share: float
    left_out_per_frame: float
    points_per_frame: float
    tracks: int
    ids: int
    track_length_median: float
    resets: int
    first_reset: str | None
    skipped_frames: int
    dropped_frames: int
    unpaired_left: int = 0
    unpaired_right: int = 0
    reconnects: int = 0
    partners_per_frame: float | None = None
    partner_share: float | None = None
    depth_known_share: float | None = None
    calibration: str | None = None
    kind: str = ""
    live: bool = False
    notes: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, object]:
        """The figures as plain values, for JSON."""
        return asdict(self)

    def table(self, *, boxed: bool = True) -> Table:
        """The figures as a table for the terminal, in groups; without lines around them where it is not `boxed`."""
        from rich import box
        from rich.table import Table

        missing = {"skipped": self.skipped_frames, "dropped": self.dropped_frames, "reconnects": self.reconnects}
        missing |= {"unpaired of the left": self.unpaired_left, "of the right": self.unpaired_right}
        notes = ", ".join(f"{count} {what}" for what, count in missing.items() if count)
        partners = {}
        if self.partner_share is not None:
            shares = f"{self.partner_share:.1%}; {self.depth_known_share:.1%} tell a depth"
            partners = {"confirmed, with a partner": f"{self.partners_per_frame:.1f} ({shares})"}
        groups = {
            "input": {
                "frames": f"{self.frames} ({notes})" if notes else f"{self.frames}",
                "frames/s": f"{self.fps:.1f}",
                **({"latency, median": f"{self.latency_ms:.2f} ms"} if self.live else {}),
            },
            "time": {stage: f"{spent:.2f} ms, {self.stage_share[stage]:.0%}" for stage, spent in self.stage_ms.items()},
            "tracks": {
                "lines per frame": f"{self.lines_per_frame:.1f}",
                "tracks per frame": f"{self.live_tracks_per_frame:.1f}",
                "of these stable": f"{self.stable_tracks_per_frame:.1f}",
                "of these measured, not detected": f"{self.measured_per_frame:.1f} ({self.measured_share:.1%})",
                **({"left out by --max-lines": f"{self.left_out_per_frame:.1f}"} if self.left_out_per_frame else {}),
                **({"points per frame": f"{self.points_per_frame:.1f}"} if self.points_per_frame else {}),
                **partners,
                "all tracks": f"{self.tracks} confirmed of {self.ids} ids",
                "seen in, median": f"{self.track_length_median:g} frames",
                **({"began anew": f"{self.resets} times, first: {self.first_reset}"} if self.resets else {}),
            },
        }
        table = Table(box=box.ROUNDED if boxed else None, show_header=False)
        for group, rows in groups.items():
            table.add_section()
            for number, row in enumerate(rows.items()):
                table.add_row("" if number else group, *row)
        return table


class SummaryCounter:
    """Adds up results frame by frame."""

    def __init__(self, confirm_hits: int) -> None:
        """Count tracks as confirmed from `confirm_hits` frames on."""
        self.started = False
        self._confirm_hits = confirm_hits
        self._begin_s = self._latest_s = time.perf_counter()
        self._frames = 0
        self._counts = np.zeros(6)  # of lines, tracks, stable ones, measured ones, ones that were left out, and points
        self._partners = PartnerCounts()
        self._resets = 0
        self._first_reset: str | None = None
        self._stages: dict[str, deque[float]] = {}
        self._latencies: deque[float] = deque(maxlen=WINDOW)
        self._hits: dict[int, int] = {}  # of the tracks that have not ended
        self._lengths: Counter[int] = Counter()  # of those that have

    def start(self) -> None:
        """Start the clock: all before was preparation."""
        self.started = True
        self._begin_s = self._latest_s = time.perf_counter()

    def add(self, result: FrameResult, sinks_ms: float) -> None:
        """Count one frame, and the milliseconds that the sinks took for it."""
        self._latest_s = time.perf_counter()  # not the time of the summary: a viewer that is gone blocks the closing
        self._frames += 1
        tracks = result.tracks
        kinds = tracks.stable.sum(), tracks.measured.sum()
        self._counts += (len(result.trace.lines), len(tracks), *kinds, tracks.left_out, len(tracks.point_ids))
        self._partners.add(tracks)
        if tracks.reset is not None:
            self._resets += 1
            self._first_reset = self._first_reset or tracks.reset
        self._latencies.append(result.latency_ms)
        for stage, spent in {**result.stage_ms, "sinks": sinks_ms}.items():
            self._stages.setdefault(stage, deque(maxlen=WINDOW)).append(spent)
        self._hits.update(zip(tracks.ids.tolist(), tracks.hits.tolist(), strict=True))
        self._lengths.update(self._hits.pop(track, 0) for track in tracks.ended_ids.tolist())

    def summary(self, source: Source) -> Summary:
        """The figures so far, with what the source counted."""
        elapsed_s = self._latest_s - self._begin_s
        frames = max(self._frames, 1)
        lines, live, stable, measured, left_out, points = (self._counts / frames).tolist()
        pairs = self._partners
        of = max(pairs.confirmed, 1)
        of_all = self._lengths + Counter(self._hits.values())
        lengths = {hits: n for hits, n in of_all.items() if hits >= self._confirm_hits}
        sizes = np.repeat(list(lengths), list(lengths.values())) if lengths else np.zeros(1)
        stage_ms = {stage: round(float(np.median(spent)), 3) for stage, spent in self._stages.items()}
        all_ms = sum(stage_ms.values()) or 1.0
        return Summary(
            frames=self._frames,
            fps=round(self._frames / elapsed_s, 2) if elapsed_s > 0 else 0.0,
            stage_ms=stage_ms,
            stage_share={stage: round(spent / all_ms, 4) for stage, spent in stage_ms.items()},
            latency_ms=round(float(np.median(self._latencies)), 3) if self._latencies else 0.0,
            lines_per_frame=round(lines, 2),
            live_tracks_per_frame=round(live, 2),
            stable_tracks_per_frame=round(stable, 2),
            measured_per_frame=round(measured, 2),
            measured_share=round(measured / live, 4) if live else 0.0,
            left_out_per_frame=round(left_out, 2),
            points_per_frame=round(points, 2),
            tracks=sum(lengths.values()),
            ids=sum(n for hits, n in of_all.items() if hits),
            track_length_median=float(np.median(sizes)),
            resets=self._resets,
            first_reset=self._first_reset,
            skipped_frames=source.skipped,
            dropped_frames=source.dropped,
            unpaired_left=source.unpaired[0],
            unpaired_right=source.unpaired[1],
            reconnects=source.reconnects,
            partners_per_frame=round(pairs.found / frames, 2) if pairs.stereo else None,
            partner_share=round(pairs.found / of, 4) if pairs.stereo else None,
            depth_known_share=round(pairs.known / of, 4) if pairs.stereo else None,
            calibration=source.calibration,
            kind=source.kind,
            live=source.live,
            notes=[*source.notes, *pairs.notes()],
        )
