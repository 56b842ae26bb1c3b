"""The tracker's result for one frame, and the table of its fields that all files and messages are made of."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from typing import Annotated, Any, Literal, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from frontend.camera.model import CameraModel

Int64: TypeAlias = NDArray[np.int64]
Int32: TypeAlias = NDArray[np.int32]
UInt8: TypeAlias = NDArray[np.uint8]
Bool: TypeAlias = NDArray[np.bool_]
Float32: TypeAlias = NDArray[np.float32]


class TrackState(IntEnum):
    """Where a track is in its life."""

    TENTATIVE = 0
    CONFIRMED = 1


@dataclass(frozen=True)
class Field:
    """What an array of `LineTracks` holds, one row per line.

    Attributes:
        meaning: for people, in files too.
        unit: of all numbers, or one for each number of a row, separated by commas.
        shape: of a row; (-1,) is any length, the same for all rows of a frame.
        columns: names in Parquet and CSV, one for each number of a row; by default the field's name. A name that comes
            twice is the same number. Rows of any length, and those of lost and ended tracks, are one column.
        rows: whose: tracks seen in the frame (N), lost (L) or ended (E).
        older: what stands for it in files from before it was there; None: all files have it.
        name: of the attribute. It and the dtype come from the declaration.
        dtype: numpy's, of the array.
    """

    meaning: str
    unit: str = ""
    shape: tuple[int, ...] = ()
    columns: str = ""
    rows: Literal["seen", "lost", "ended"] = "seen"
    older: float | None = None
    name: str = ""
    dtype: Any = None

    @property
    def text(self) -> str:
        """Shape, unit and meaning, such as "(N, 2, 2) px, the line"."""
        axes = [{"seen": "N", "lost": "L", "ended": "E"}[self.rows], *("C" if n < 0 else str(n) for n in self.shape)]
        return f"({', '.join(axes)}) {self.unit + ', ' if self.unit and ',' not in self.unit else ''}{self.meaning}"

    @property
    def numbers(self) -> list[tuple[str, str]]:
        """Name and unit of each column, in the order of a row's numbers."""
        count = 1 if self.shape == (-1,) or self.rows != "seen" else int(np.prod(self.shape))
        names = self.columns.split() or [self.name if count == 1 else f"{self.name}_{k}" for k in range(count)]
        units = self.unit.split(", ")
        return list(zip(names, units if len(units) == count else [self.unit] * count, strict=True))


def _ends(prefix: str = "") -> str:
    return " ".join(prefix + end for end in ("x0", "y0", "x1", "y1"))


def _no_ids() -> Int64:
    return np.zeros(0, np.int64)


def _no_segments() -> Float32:
    return np.zeros((0, 2, 2), np.float32)


@dataclass(frozen=True)
class LineTracks:
    """The tracks that were seen in one frame. Row k of every array of N rows speaks of the same track.

    A new field is declared here and computed in `LineTracker`; every format of files and messages then has it.

    Attributes:
        frame_index: `Frame.index` of the frame.
        stamp_ns: sensor time, nanoseconds.
        camera: the camera, where known.
        reset: why all earlier tracks ended before this frame, or None.
        left_out: how many more were seen, beyond `TrackerConfig.max_lines`; in no file.
    """

    frame_index: int
    stamp_ns: int
    ids: Annotated[Int64, Field("track id, ascending, never used again", columns="id")]
    segments_px: Annotated[Float32, Field("line fused over the frames so far", "px", (2, 2), _ends())]
    observed_px: Annotated[Float32, Field("line as measured in this frame alone", "px", (2, 2), _ends("observed_"))]
    covariances: Annotated[
        Float32,
        Field(
            "of the fused line's errors: offset across itself at its middle (px), and angle (radians)",
            unit="px^2, px rad, px rad, rad^2",
            shape=(2, 2),
            columns="var_offset cov_offset_angle cov_offset_angle var_angle",
        ),
    ]
    observed_covariances: Annotated[
        Float32,
        Field(
            "the same of the observed line; errors of different frames are independent",
            unit="px^2, px rad, px rad, rad^2",
            shape=(2, 2),
            columns="observed_var_offset observed_cov_offset_angle observed_cov_offset_angle observed_var_angle",
            older=np.nan,
        ),
    ]
    scores: Annotated[Float32, Field("score of the measurement, in [0, 1]", columns="score")]
    descriptors: Annotated[Float32, Field("orientation descriptor, a unit vector", shape=(-1,), columns="descriptor")]
    states: Annotated[UInt8, Field("0 tentative, 1 confirmed", columns="state")]
    ages: Annotated[Int32, Field("frames since the track began, 0 in its first frame", columns="age")]
    hits: Annotated[Int32, Field("frames in which it was seen, this one included")]
    measured: Annotated[
        Bool, Field("not detected, but found on the edge map where the track was predicted", older=False)
    ]
    consistency: Annotated[
        Float32,
        Field(
            "how far off its prediction the line was in the last frames, rms over what its covariances let expect: "
            "about 1 for one line in space, more for one that drifts",
            older=np.nan,
        ),
    ]
    stable: Annotated[Bool, Field("fit to be a landmark: confirmed, consistent and not short", older=False)]
    line_indices: Annotated[
        Int32, Field("row of the detection among the frame's lines, -1 if measured", columns="line_index")
    ]
    fragment_of: Annotated[Int64, Field("track whose line broke and left this piece, -1 for whole lines")]
    lost_ids: Annotated[Int64, Field("confirmed track that is not seen now and still looked for", rows="lost")] = field(
        default_factory=_no_ids
    )
    lost_segments_px: Annotated[Float32, Field("where it should be", "px", (2, 2), "lost_segments", "lost")] = field(
        default_factory=_no_segments
    )
    lost_frames: Annotated[Int32, Field("frames since it was seen", rows="lost", older=1)] = field(
        default_factory=lambda: np.zeros(0, np.int32)
    )
    ended_ids: Annotated[Int64, Field("track that will never be seen again", rows="ended")] = field(
        default_factory=_no_ids
    )
    camera: CameraModel | None = None
    reset: str | None = None
    left_out: int = 0

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def confirmed(self) -> NDArray[np.bool_]:
        """(N,) mask of the tracks seen often enough to be trusted."""
        mask: NDArray[np.bool_] = self.states == TrackState.CONFIRMED
        return mask

    @cached_property
    def segments_normalized(self) -> NDArray[np.float32] | None:
        """(N, 2, 2) float32 undistorted coordinates of `segments_px` on the plane z = 1; None without a camera."""
        return None if self.camera is None else self.camera.normalize(self.segments_px)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> LineTracks:
        """Some of the seen tracks; lost and ended ones stay."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in FIELDS if f.rows == "seen"})


def _declared() -> tuple[Field, ...]:
    fields = []
    for name, hint in get_type_hints(LineTracks, include_extras=True).items():
        if get_origin(hint) is Annotated:
            array, declared = get_args(hint)
            (dtype,) = get_args(get_args(array)[1])
            fields.append(replace(declared, name=name, dtype=np.dtype(dtype)))
    return tuple(fields)


FIELDS = _declared()
NORMALIZED = Field(  # follows from the others where the camera is known
    "the fused line undistorted, on the plane z = 1; NaN without a camera and where its lens model ends",
    shape=(2, 2),
    columns="u0 v0 u1 v1",
    name="segments_normalized",
    dtype=np.dtype(np.float32),
)
