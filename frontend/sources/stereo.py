"""Pairs of frames: of two sources by their times, or of pictures that hold both halves."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from operator import attrgetter
from pathlib import PurePath
from statistics import median

import numpy as np

from airline.errors import ConfigError, InputError
from frontend.camera.calibration import Calibration, fit_camera
from frontend.camera.model import CameraModel
from frontend.camera.undistort import values_of
from frontend.frame import Frame
from frontend.protocols import Source
from frontend.sources.pace import FreshFrames
from frontend.sources.reading import Image
from frontend.sources.wrapped import WrappedSource
from frontend.stereo.rectify import NO_PLACES, Rectifier

_STEPS = 31  # of a camera's times, whose median is its period
_FIRST = 5  # frames of either camera that tell it before the first pair
_UNPAIRED_LIVE = 60  # frames of live cameras without a pair, after which there will be none
_PERIOD_NS = 33_333_333  # of a camera, until its second frame is there
_BEFORE_NS = 10**9  # where the right camera's frames begin before a start: its period is not known yet


class StereoSource(Source):
    """Rectified pairs of two cameras' frames, paired by their times: the nearest ones, each in one pair at most.

    Which is certain as long as the gap is less than half of either period; with a larger one the next frame is asked.

    A frame is the left camera's, with `Frame.right` and the camera of the rectified pair. Both sources bring the
    calibration: `Frame.camera` with `rig_from_camera`. Frames without a partner are counted in `unpaired`, and noted.
    Images of folders without times are paired by the last number in their names. It holds a few frames of either
    source; live ones are read by a thread each.

    Args:
        left, right: the sources; closed with this one.
        rectified: the images are rectified already; then they need no calibration, but have no metres without one.
        max_gap_s: how far apart the times of a pair may be, seconds; by default a third of the left camera's period.
        name: by default the left source's.

    Raises:
        ConfigError: one of the sources is live and the other is not, or an impossible gap.
        InputError: while iterating, when there is no pair, the images of one differ in size or depth, or the
            calibration is missing or none of a pair.
    """

    name: str
    unpaired: tuple[int, int]

    def __init__(
        self,
        left: Source,
        right: Source,
        *,
        rectified: bool = False,
        max_gap_s: float | None = None,
        name: str | None = None,
    ) -> None:
        wrong = None
        if left.live != right.live:
            wrong = "one camera of the pair is live, and the other one is recorded: give two of a kind"
        elif max_gap_s is not None and not 0 <= max_gap_s < 1e9:
            wrong = f"the times of a pair may be 0 to 1e9 seconds apart, not {max_gap_s}"
        if wrong is not None:
            left.close()
            right.close()
            raise ConfigError(wrong)
        self._left, self._right = (FreshFrames(left), FreshFrames(right)) if left.live else (left, right)
        self.name = left.name if name is None else name
        self.unpaired = 0, 0
        self._rectify = _Rectify(rectified)
        self._max_gap_ns = None if max_gap_s is None else round(max_gap_s * 1e9)
        self._steps: list[deque[int]] = [deque(maxlen=_STEPS), deque(maxlen=_STEPS)]
        self._by_number = False
        self._start_ns: int | None = None
        self._notes: list[str] = []
        self._noted = [0, 0]

    @property
    def frame_count(self) -> int | None:
        counts = [count for one in (self._left, self._right) if (count := one.frame_count) is not None]
        return min(counts, default=None)

    @property
    def kind(self) -> str:
        """Both kinds or names, and how far apart their times may be."""
        left, right = self._left, self._right
        if left.kind == right.kind:
            both = f"{left.kind}, pairs of '{left.name}' and '{right.name}'"
        else:
            both = f"pairs of {left.kind} and {right.kind}"
        return f"{both} {'by number' if self._by_number else f'at most {self._gap_ns / 1e6:.3g} ms apart'}"

    @property
    def calibration(self) -> str | None:
        return " and ".join(filter(None, (self._left.calibration, self._right.calibration))) or None

    @property
    def notes(self) -> list[str]:
        """Of both sources, each in the order in which they came."""
        for place, (one, prefix) in enumerate(((self._left, ""), (self._right, "right camera: "))):
            new = one.notes[self._noted[place] :]
            self._notes += [prefix + note for note in new if not prefix or note not in self._left.notes]
            self._noted[place] = len(one.notes)
        return self._notes

    @property
    def first_stamp_ns(self) -> int | None:
        return None if self._right.first_stamp_ns is None else self._left.first_stamp_ns

    @property
    def last_stamp_ns(self) -> int | None:
        return self._left.last_stamp_ns if self._left.frame_count == self._right.frame_count else None

    def seek(self, start_s: float) -> None:
        """As in `Source`, where both sources can; frames before the start are not counted as unpaired."""
        first_ns, right_ns = self._left.first_stamp_ns, self._right.first_stamp_ns
        if first_ns is None or right_ns is None:
            return
        self._start_ns = first_ns + round(start_s * 1e9)
        self._left.seek(start_s)
        if first_ns or right_ns:  # where images are paired by number, the right one's places are not known
            self._right.seek(max(0.0, (self._start_ns - max(self._gap_ns, _BEFORE_NS) - right_ns) / 1e9))

    def stop(self) -> None:
        self._left.stop()
        self._right.stop()

    def close(self) -> None:
        self._left.close()
        self._right.close()

    def __iter__(self) -> Iterator[Frame]:
        lefts, rights = (
            _Ahead(iter(one), steps) for one, steps in zip((self._left, self._right), self._steps, strict=True)
        )
        paired = False
        if not self.live:
            self._begin([[one for k in range(_FIRST) if (one := ahead[k])] for ahead in (lefts, rights)])
        try:
            while (left := lefts[0]) is not None and (right := rights[0]) is not None:
                unpaired = self._without_partner(left, right, lefts, rights)
                if unpaired is None:
                    lefts.take()
                    rights.take()
                    frame = self._rectify(left, right.image, right.camera)
                    if not paired and self._rectify.remaps:
                        self.notes.append("both images are rectified by their calibration")
                    paired = True
                    yield replace(frame, read_s=max(left.read_s, right.read_s))
                else:
                    self._count(unpaired, of_left=unpaired is lefts)
                    if self.live and not paired and sum(self.unpaired) >= _UNPAIRED_LIVE:
                        break
            if self.live and paired:
                self.notes.append(f"the {'left' if lefts[0] is None else 'right'} camera ended, and with it the pairs")
            for rest in () if self.live else (lefts, rights):
                while rest[0] is not None:
                    self._count(rest, of_left=rest is lefts)
            if not paired and any(self.unpaired):
                what = "have one number" if self._by_number else f"are {self._apart} of each other"
                raise InputError(
                    f"no two frames of '{self._left.name}' and '{self._right.name}' {what}: check their times, "
                    "or give --max-stereo-gap"
                )
        finally:
            if any(self.unpaired):
                how = "of their number" if self._by_number else self._apart
                self.notes.append("frames without a partner {}: {} left, {} right".format(how, *self.unpaired))

    def _begin(self, first: list[list[Frame]]) -> None:
        """Whether images are paired by number, with the first frames of both cameras at hand."""
        counts = self._left.frame_count, self._right.frame_count
        if any(frames and frames[0].stamp_ns for frames in first) or self._left.first_stamp_ns:
            return
        self._by_number = all(len(frames) > 1 and all(_number(one) is not None for one in frames) for frames in first)
        if not self._by_number and counts[0] != counts[1]:
            self.notes.append("the times of both cameras begin at zero, so their first frames are taken for one moment")

    @property
    def _apart(self) -> str:
        return f"within {self._gap_ns / 1e6:.3g} ms"

    def _without_partner(self, left: Frame, right: Frame, lefts: _Ahead, rights: _Ahead) -> _Ahead | None:
        """Where the first frame has no partner; None where the first two are a pair.

        A nearer one that comes next is preferred, unless that has a nearer one itself. Live frames do not wait for it.
        """
        if self._by_number:
            ours, theirs = _number(left) or 0, _number(right) or 0
            return None if ours == theirs else lefts if ours < theirs else rights
        after, right_after = (None, None) if self.live else (lefts[1], rights[1])
        gap = _apart(left, right)
        if gap > self._gap_ns:
            return lefts if left.stamp_ns < right.stamp_ns else rights
        if _apart(left, right_after) < min(gap, _apart(after, right_after)):
            return rights
        return lefts if _apart(after, right) < min(gap, _apart(after, right_after)) else None

    def _count(self, unpaired: _Ahead, *, of_left: bool) -> None:
        frame = unpaired.take()
        if frame is not None and (self._start_ns is None or frame.stamp_ns >= self._start_ns):
            self.unpaired = self.unpaired[0] + of_left, self.unpaired[1] + (not of_left)

    @property
    def _gap_ns(self) -> int:
        if self._max_gap_ns is not None:
            return self._max_gap_ns
        # frames that are missing make either of them longer
        return round(min((median(steps) for steps in self._steps if steps), default=_PERIOD_NS) / 3)


class SideBySide(WrappedSource):
    """Pairs out of pictures whose left half is the left camera's.

    Args:
        source: the pictures; what camera they carry is left.
        left, right: calibrations of the halves, with `rig_from_camera`.
        rectified: as of `StereoSource`.

    Raises:
        InputError: while iterating, as of `StereoSource`; a picture has an odd width.
    """

    def __init__(
        self,
        source: Source,
        left: CameraModel | Calibration | None = None,
        right: CameraModel | Calibration | None = None,
        *,
        rectified: bool = False,
    ) -> None:
        super().__init__(source)
        self._files = [str(one) for one in (left, right) if isinstance(one, Calibration)]
        self._cameras = [one.camera if isinstance(one, Calibration) else one for one in (left, right)]
        self._rectify = _Rectify(rectified)
        self._notes: list[str] = []

    @property
    def kind(self) -> str:
        return f"{self._source.kind}, two halves side by side"

    @property
    def calibration(self) -> str | None:
        return " and ".join(self._files) or None

    @property
    def notes(self) -> list[str]:
        own = ["both halves are rectified by their calibration"] if self._rectify.remaps else []
        return [*own, *self._source.notes]

    def __iter__(self) -> Iterator[Frame]:
        for frame in self._source:
            height, width = frame.image.shape[:2]
            if width % 2:
                raise InputError(f"a picture {width} px wide has no two halves: leave --side-by-side out")
            self._cameras = [camera and fit_camera(camera, width // 2, height) for camera in self._cameras]
            halves = (np.ascontiguousarray(half) for half in np.split(frame.image, 2, axis=1))
            left, right = halves
            yield self._rectify(replace(frame, image=left, camera=self._cameras[0]), right, self._cameras[1])


class _Ahead:
    """The next frames of a source, None behind the last; times between frames go into `steps`, ns."""

    def __init__(self, frames: Iterator[Frame], steps: deque[int]) -> None:
        self._frames, self._steps = frames, steps
        self._held: list[Frame | None] = []
        self._latest: int | None = None

    def __getitem__(self, place: int) -> Frame | None:
        while len(self._held) <= place:
            frame = next(self._frames, None)
            self._held.append(frame)
            if frame is not None:
                if self._latest is not None and frame.stamp_ns > self._latest:
                    self._steps.append(frame.stamp_ns - self._latest)
                self._latest = frame.stamp_ns
        return self._held[place]

    def take(self) -> Frame | None:
        frame = self[0]
        del self._held[0]
        return frame


class _Rectify:
    """Makes rectified pairs; `Rectifier` for cameras that may change on the way."""

    def __init__(self, rectified: bool) -> None:
        self._rectified = rectified
        self._rectifier: Rectifier | None = None
        self._made_for: list[tuple[object, ...] | None] = []

    @property
    def remaps(self) -> bool:
        return self._rectifier is not None and self._rectifier.remaps

    def __call__(self, left: Frame, image: Image, camera: CameraModel | None) -> Frame:
        """The left frame with the image of the right camera, both rectified."""
        if (left.image.shape[:2], left.image.dtype) != (image.shape[:2], image.dtype):
            both = (left.image, image)
            sizes = " and ".join(f"{one.shape[1]}x{one.shape[0]} px of {8 * one.itemsize} bits" for one in both)
            raise InputError(f"the images of a pair must be of one size and depth, not {sizes}: convert one of them")
        if left.camera is None:
            if not self._rectified:
                raise InputError(NO_PLACES)
            return replace(left, right=image)
        values = [None if one is None else values_of(one) for one in (left.camera, camera)]
        if self._rectifier is None or values != self._made_for:
            self._rectifier = Rectifier(left.camera, camera, rectified=self._rectified)
            self._made_for = values
        left_image, right_image = self._rectifier(left.image, image)
        return replace(left, image=left_image, right=right_image, camera=self._rectifier.camera)


def _of_both(name: str) -> property:
    count = attrgetter(name)
    return property(lambda pair: count(pair._left) + count(pair._right))


for _name in ("skipped", "dropped", "reconnects"):
    setattr(StereoSource, _name, _of_both(_name))
for _name in ("live", "codec", "orientation"):
    setattr(StereoSource, _name, property(attrgetter(f"_left.{_name}")))


def _apart(left: Frame | None, right: Frame | None) -> float:
    """Nanoseconds between two frames; infinite where one is missing."""
    return float("inf") if left is None or right is None else abs(left.stamp_ns - right.stamp_ns)


def _number(frame: Frame) -> int | None:
    """The last number in the name of a frame's file."""
    found = re.findall(r"\d+", PurePath(frame.name).stem)
    return int(found[-1]) if found else None
