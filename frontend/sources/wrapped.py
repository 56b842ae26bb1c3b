"""Sources around another source: with its first frame at hand, with a camera, a part of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from operator import attrgetter

from airline.errors import ConfigError
from frontend.camera.calibration import Calibration, fit_camera
from frontend.camera.model import CameraModel
from frontend.frame import Frame
from frontend.protocols import Source

_SIZES = range(16, 16385)


class WrappedSource(Source):
    """Says all that the source inside says, but for its frames; closing it closes that one."""

    def __init__(self, source: Source) -> None:
        self._source = source

    def seek(self, start_s: float) -> None:
        self._source.seek(start_s)

    def stop(self) -> None:
        self._source.stop()

    def close(self) -> None:
        self.stop()
        self._source.close()


_COUNTS = ("frame_count", "skipped", "dropped", "reconnects", "unpaired", "first_stamp_ns", "last_stamp_ns")
_WORDS = ("name", "live", "kind", "codec", "orientation", "notes", "calibration")
for _name in (*_COUNTS, *_WORDS):
    setattr(WrappedSource, _name, property(attrgetter(f"_source.{_name}")))


class Peeked(WrappedSource):
    """A source whose first frame has been read, to prepare with it.

    Attributes:
        first: that frame; None where there is none.
    """

    def __init__(self, source: Source) -> None:
        super().__init__(source)
        self._frames = iter(source)
        self.first = next(self._frames, None)

    def __iter__(self) -> Iterator[Frame]:
        return self._frames if self.first is None else chain([self.first], self._frames)


class CalibratedFrames(WrappedSource):
    """Frames that carry a camera.

    Args:
        source: the stream.
        camera: the camera of the frames, or a file's, fitted to their size; None to keep what they carry themselves.
        undistort: remap every image to that of `undistorted_camera`, which the frame carries then.

    Raises:
        InputError: while iterating, when the camera is for images of another shape.
        ConfigError: while iterating, when there is no camera.
    """

    def __init__(self, source: Source, camera: CameraModel | Calibration | None, *, undistort: bool = False) -> None:
        super().__init__(source)
        self._file = None if isinstance(camera, CameraModel) else camera
        self._camera = camera if isinstance(camera, CameraModel) else camera and camera.camera
        self._undistort = undistort

    @property
    def calibration(self) -> str | None:
        return self._source.calibration if self._file is None else str(self._file)

    def __iter__(self) -> Iterator[Frame]:
        from frontend.camera.undistort import Undistorter

        remap: Undistorter | None = None
        fitted: CameraModel | None = None
        for frame in self._source:
            height, width = frame.image.shape[:2]
            camera = self._camera or frame.camera
            if camera is None:
                raise ConfigError(
                    f"{self.name} brings no camera calibration to undistort with: give one with --calib FILE"
                )
            if fitted is None or self._camera is None or (fitted.width, fitted.height) != (width, height):
                fitted = fit_camera(camera, width, height)
            if not self._undistort:
                yield replace(frame, camera=fitted)
                continue
            if remap is None or not remap.fits(fitted):
                remap = Undistorter(fitted)
            yield replace(frame, image=remap(frame.image), camera=remap.camera)


class UncalibratedFrames(WrappedSource):
    """Frames that carry no camera."""

    calibration = None

    def __iter__(self) -> Iterator[Frame]:
        return (replace(frame, camera=None) for frame in self._source)


class SelectedFrames(WrappedSource):
    """A part of another source. Frames keep their index and stamp.

    Args:
        source: the stream; closed also where a value is impossible.
        start_s, end_s: seconds since the stream's first frame; start is included, end is not.
        stride: keep every stride-th frame, by index, from 0 on or with start_s from the first one: that a frame cannot
            be read changes nothing for the others.
        max_frames: yield at most so many frames.
        resize: (width, height) px, or (width, None) to keep the aspect ratio; `Frame.camera` is scaled along.

    Raises:
        ConfigError: a value is impossible.
    """

    first_stamp_ns = None  # it begins where it was told to

    def __init__(
        self,
        source: Source,
        *,
        start_s: float | None = None,
        end_s: float | None = None,
        stride: int = 1,
        max_frames: int | None = None,
        resize: tuple[int, int | None] | None = None,
    ) -> None:
        super().__init__(source)
        start, end = start_s or 0.0, math.inf if end_s is None else end_s
        wrong = None
        if not (math.isfinite(start) and start >= 0):
            wrong = f"start must be zero or more seconds, not {start_s}"
        elif not end > start or (end_s is not None and math.isinf(end)):
            wrong = f"end must be later than start ({start:g} s), not {end_s}"
        elif stride < 1:
            wrong = f"stride must be 1 or more, not {stride}"
        elif max_frames is not None and max_frames < 1:
            wrong = f"the number of frames must be 1 or more, not {max_frames}"
        elif resize is not None and any(size is not None and size not in _SIZES for size in resize):
            wrong = f"a frame can be resized to between {_SIZES[0]} and {_SIZES[-1]} px, not {resize}"
        if wrong is not None:
            source.close()
            raise ConfigError(wrong)
        self._start_ns, self._end_ns = round(start * 1e9), None if end_s is None else round(end_s * 1e9)
        self._stride, self._max_frames, self._resize = stride, max_frames, resize
        if start > 0:
            source.seek(start)

    @property
    def frame_count(self) -> int | None:
        count = self._source.frame_count
        if count is None:
            return self._max_frames
        count = math.ceil(count / self._stride)
        return count if self._max_frames is None else min(count, self._max_frames)

    @property
    def last_stamp_ns(self) -> int | None:
        whole = self._stride == 1 and self._max_frames is None and self._end_ns is None
        return self._source.last_stamp_ns if whole else None

    def seek(self, start_s: float) -> None:
        """It begins where it was told to."""

    def __iter__(self) -> Iterator[Frame]:
        origin_ns = self._source.first_stamp_ns
        first = None if self._start_ns else 0
        yielded = 0
        for frame in self._source:
            origin_ns = frame.stamp_ns if origin_ns is None else origin_ns
            elapsed_ns = frame.stamp_ns - origin_ns
            if self._end_ns is not None and elapsed_ns >= self._end_ns:
                return
            if elapsed_ns < self._start_ns:
                continue
            first = frame.index if first is None else first
            if (frame.index - first) % self._stride:
                continue
            yield frame if self._resize is None else _resized(frame, *self._resize)
            yielded += 1
            if yielded == self._max_frames:  # before a live source is asked for one more
                return


def _resized(frame: Frame, width: int, height: int | None) -> Frame:
    import cv2

    rows, columns = frame.image.shape[:2]
    if height is None:
        height = max(1, round(rows * width / columns))
    if (columns, rows) == (width, height):
        return frame
    image, right = (
        None if one is None else cv2.resize(one, (width, height), interpolation=cv2.INTER_AREA)
        for one in (frame.image, frame.right)
    )
    camera = frame.camera and frame.camera.scaled(width, height)
    return replace(frame, image=image, right=right, camera=camera)  # type: ignore[arg-type]
