"""Settings of the tracker."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from airline.errors import ConfigError

Share = Annotated[float, Meta(ge=0, le=1)]
Cosine = Annotated[float, Meta(ge=-1, le=1)]


class TrackerConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of the tracker.

    Attributes:
        confirm_hits: a track is confirmed when it was seen in this many frames.
        max_missed: a confirmed track ends when it was not seen in more than 2 frames in a row and half of those in
            which it was seen, at the latest after this many;
        max_missed_tentative: and a tentative one after this many.
        band: a line may be this far from where its track is predicted, px, and three standard deviations of that,
        max_band: up to this, max_lost_band: and up to that for a track that was missed.
        max_angle: a track and its line may differ in direction by this much, degrees.
        min_agreement: least dot product of the orientation descriptors of a track and its line.
        min_appearance: least dot product of the grey profiles across a track and its line,
        min_appearance_lost: and of a track that was missed, min_appearance_measured: of one that was found on the edge
            map,
        min_appearance_first: and of how the track looked when it began.
        min_support: least share of a line that has an edge where it is found on the edge map.
        min_vote: least vote of a pair, see `overlap`.
        gate: largest squared innovation of a pair, over what its covariance lets expect.
        max_gap_s: a longer gap between two frames ends all tracks, seconds.
        max_lines: hand out this many tracks per frame, the best ones; 0 is all.
        points: follow corners of the image beside the lines, for backends that take both.
    """

    confirm_hits: int = 3
    max_missed: int = 30
    max_missed_tentative: int = 8
    band: float = 1.5
    max_band: float = 8.0
    max_lost_band: float = 4.0
    max_angle: Annotated[float, Meta(gt=0, le=90)] = 20.0
    min_agreement: Cosine = 0.5
    min_appearance: Cosine = -0.3
    min_appearance_lost: Cosine = 0.3
    min_appearance_measured: Cosine = 0.5
    min_appearance_first: Cosine = 0.0
    min_support: Share = 0.6
    min_vote: Share = 0.1
    gate: float = 16.0
    max_gap_s: float = 1.0
    max_lines: Annotated[int, Meta(ge=0, description="hand out the N best tracks of each frame, 0 all")] = 0
    points: Annotated[bool, Meta(description="follow points beside the lines too, for backends that take both")] = False

    def __post_init__(self) -> None:
        if self.confirm_hits < 1 or min(self.max_missed, self.max_missed_tentative, self.max_lines) < 0:
            raise ConfigError("tracker needs confirm_hits >= 1, and max_missed and max_lines of at least 0")
        if not (0 < self.band <= min(self.max_band, self.max_lost_band) and self.gate > 0 and self.max_gap_s > 0):
            raise ConfigError("tracker needs band > 0, max_band and max_lost_band >= band, gate > 0 and max_gap_s > 0")
