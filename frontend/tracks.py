"""The tracker's result for one frame, and the table of its fields that all files and messages are made of."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from typing import Annotated, Any, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from frontend.camera.lines import coefficients, covariances_on_plane, normals
from frontend.camera.model import CameraModel
from frontend.fields import Field, ends_named, words_of
from frontend.stereo.disparity import disparities, in_metres

Int64: TypeAlias = NDArray[np.int64]
Int32: TypeAlias = NDArray[np.int32]
UInt8: TypeAlias = NDArray[np.uint8]
Bool: TypeAlias = NDArray[np.bool_]
Float32: TypeAlias = NDArray[np.float32]


class TrackState(IntEnum):
    """Where a track is in its life."""

    TENTATIVE = 0
    CONFIRMED = 1


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
        earlier: frames, and their rows, that `history` is made of.
        left_out: how many more were seen, beyond `TrackerConfig.max_lines`; in no file.
    """

    frame_index: int
    stamp_ns: int
    ids: Annotated[Int64, Field("track id, ascending, never used again", columns="id")]
    segments_px: Annotated[Float32, Field("line fused over the frames so far", "px", (2, 2), ends_named())]
    observed_px: Annotated[
        Float32, Field("line as measured in this frame alone", "px", (2, 2), ends_named("observed_"))
    ]
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
            "of the observed line's errors, as covariances; independent of other frames but for a bias",
            unit="px^2, px rad, px rad, rad^2",
            shape=(2, 2),
            columns="observed_var_offset observed_cov_offset_angle observed_cov_offset_angle observed_var_angle",
            older=np.nan,
        ),
    ]
    scores: Annotated[Float32, Field("score of the measurement, in [0, 1]", columns="score")]
    descriptors: Annotated[Float32, Field("orientation descriptor, a unit vector", shape=(-1,), columns="descriptor")]
    states: Annotated[UInt8, Field("0 tentative, 1 confirmed", columns="state", words=words_of(TrackState))]
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
    right_px: Annotated[
        Float32,
        Field(
            "its partner as measured in the right image, in the same direction; NaN where there is none",
            "px",
            (2, 2),
            ends_named("right_"),
            "right",
            older=np.nan,
        ),
    ] = field(default_factory=_no_segments)
    right_covariances: Annotated[
        Float32,
        Field(
            "of the partner's errors, as covariances",
            unit="px^2, px rad, px rad, rad^2",
            shape=(2, 2),
            columns="right_var_offset right_cov_offset_angle right_cov_offset_angle right_var_angle",
            rows="right",
            older=np.nan,
        ),
    ] = field(default_factory=_no_segments)
    right_hits: Annotated[
        Int32, Field("frames in a row, this one the last, in which it had a partner; 0 now none", rows="right", older=0)
    ] = field(default_factory=lambda: np.zeros(0, np.int32))
    right_measured: Annotated[
        Bool, Field("the partner was not detected, but found on the edge map", rows="right", older=False)
    ] = field(default_factory=lambda: np.zeros(0, np.bool_))
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
    point_ids: Annotated[
        Int64,
        Field(
            "point followed beside the lines, ascending, never used again; one that is not here has ended",
            columns="point_id",
            rows="points",
            older=0,
        ),
    ] = field(default_factory=_no_ids)
    points_px: Annotated[
        Float32,
        Field("where it is in this frame, a corner of the image", "px", (2,), "point_x point_y", "points", older=0),
    ] = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    camera: CameraModel | None = None
    reset: str | None = None
    earlier: tuple[tuple[LineTracks, NDArray[np.intp]], ...] = field(default=(), compare=False, repr=False)
    left_out: int = 0

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def confirmed(self) -> NDArray[np.bool_]:
        """(N,) mask of the tracks seen often enough to be trusted."""
        mask: NDArray[np.bool_] = self.states == TrackState.CONFIRMED
        return mask

    @cached_property
    def segments_normalized(self) -> Float32 | None:
        """(N, 2, 2) float32 undistorted coordinates of `segments_px` on the plane z = 1; None without a camera."""
        return None if self._on_plane is None else self._on_plane[0]

    @cached_property
    def observed_normalized(self) -> Float32 | None:
        """(N, 2, 2) float32 undistorted coordinates of `observed_px` on the plane z = 1; None without a camera."""
        return None if self._on_plane is None else self._on_plane[1]

    @cached_property
    def observed_lines(self) -> Float32 | None:
        """(N, 3) float32 coefficients a, b, c of the observed lines on that plane; see `frontend.camera.lines`."""
        return None if self.observed_normalized is None else coefficients(self.observed_normalized)

    @cached_property
    def observed_line_covariances(self) -> Float32 | None:
        """(N, 2, 2) float32 covariances of their offsets across at the middle and of their angles, radians."""
        if self._on_plane is None:
            return None
        _, ends, there, back = self._on_plane
        return covariances_on_plane(self.observed_px, self.observed_covariances, ends, np.float64(there) - back)

    @cached_property
    def points_normalized(self) -> Float32 | None:
        """(P, 2) float32 undistorted coordinates of `points_px` on the plane z = 1; None without a camera."""
        return None if self.camera is None else self.camera.normalize(self.points_px)

    @cached_property
    def _in_both(self) -> tuple[Float32, Float32, Bool] | None:
        if not len(self.right_hits) and len(self):
            return None
        lines = self.observed_px, self.observed_covariances, self.right_px, self.right_covariances
        return disparities(*lines, 0.0 if self.camera is None else self.camera.disparity_offset)

    @property
    def disparity_px(self) -> Float32 | None:
        """(N, 2) float32 px, x of both ends of `observed_px` minus x of the partner in their rows.

        NaN without a partner and where it runs along the rows; None without a right image.
        """
        return None if self._in_both is None else self._in_both[0]

    @property
    def disparity_covariances(self) -> Float32 | None:
        """(N, 2, 2) float32 px^2, of the errors of `disparity_px`."""
        return None if self._in_both is None else self._in_both[1]

    @property
    def depth_known(self) -> Bool | None:
        """(N,) mask of those whose disparities tell how far away both ends are."""
        return None if self._in_both is None else self._in_both[2]

    @cached_property
    def _in_space(self) -> tuple[Float32, Float32] | None:
        if self._in_both is None or self.camera is None or not self.camera.baseline_m:
            return None
        lines = self.observed_px, self.observed_covariances, self.right_px, self.right_covariances
        return in_metres(*lines, self._in_both[2], self.camera)

    @property
    def segments_m(self) -> Float32 | None:
        """(N, 2, 3) float32 m, the ends of `observed_px` in the left camera's frame (x right, y down, z forward).

        NaN where `depth_known` says so; None without a right image or its calibration.
        """
        return None if self._in_space is None else self._in_space[0]

    @property
    def segments_m_covariances(self) -> Float32 | None:
        """(N, 6, 6) float32 m^2, of the errors of `segments_m`: those across the line alone, so its rank is 4."""
        return None if self._in_space is None else self._in_space[1]

    @cached_property
    def _on_plane(self) -> Float32 | None:
        """(4, N, 2, 2) fused, observed, and these moved across by half a pixel: one call takes half the time of two."""
        if self.camera is None:
            return None
        step = 0.5 * normals(self.observed_px)[:, None]
        ends = self.segments_px, self.observed_px, self.observed_px + step, self.observed_px - step
        return self.camera.normalize(np.stack(ends))

    @cached_property
    def history(self) -> tuple[LineTracks, ...]:
        """What earlier frames saw of the tracks here that this frame is the first to confirm, oldest first.

        Each is a part of its frame's tracks, with its time and camera. A backend that takes these and the confirmed
        tracks of every frame misses no observation of a track that is ever confirmed, and gets each once; but for what
        `max_lines` left out.
        """
        parts = []
        for frame, rows in self.earlier:
            own = rows[np.isin(frame.ids[rows], self.ids)]
            none = {f.name: getattr(frame, f.name)[:0] for f in FIELDS if f.rows not in ("seen", "right")}
            parts.append(replace(frame.take(own), **none, reset=None))
        return tuple(part for part in parts if len(part))

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> LineTracks:
        """Some of the seen tracks; lost and ended ones stay, and points."""
        kinds = ("seen", "right") if len(self.right_hits) else ("seen",)
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in FIELDS if f.rows in kinds})


def _declared() -> tuple[Field, ...]:
    fields = []
    for name, hint in get_type_hints(LineTracks, include_extras=True).items():
        if get_origin(hint) is Annotated:
            array, declared = get_args(hint)
            (dtype,) = get_args(get_args(array)[1])
            fields.append(replace(declared, name=name, dtype=np.dtype(dtype)))
    return tuple(fields)


FIELDS = _declared()


def _derived(name: str, meaning: str, dtype: type = np.float32, **form: Any) -> Field:
    return Field(meaning, name=name, dtype=np.dtype(dtype), **form)


DERIVED = (  # follow from the others where the camera is known
    _derived(
        "segments_normalized",
        "the fused line undistorted, on the plane z = 1; NaN without a camera and where its lens model ends",
        shape=(2, 2),
        columns="u0 v0 u1 v1",
    ),
    _derived(
        "observed_normalized",
        "the observed line undistorted, on the plane z = 1",
        shape=(2, 2),
        columns="observed_u0 observed_v0 observed_u1 observed_v1",
    ),
    _derived(
        "observed_lines",
        "a, b, c: a u + b v + c is the signed distance of (u, v) on that plane from the observed line; "
        "(a, b) is the unit direction from start to end, turned a quarter from u to v",
        shape=(3,),
        columns="line_a line_b line_c",
    ),
    _derived(
        "observed_line_covariances",
        "of the errors of observed_lines: offset along (a, b) at the middle of observed_normalized, angle (radians)",
        unit=", rad, rad, rad^2",
        shape=(2, 2),
        columns="line_var_offset line_cov_offset_angle line_cov_offset_angle line_var_angle",
    ),
    _derived(
        "points_normalized",
        "the point undistorted, on the plane z = 1; NaN without a camera and where its lens model ends",
        shape=(2,),
        columns="point_u point_v",
        rows="points",
    ),
    _derived(
        "disparity_px",
        "x of both ends of the observed line minus x of its partner in their rows; NaN where it runs along these",
        unit="px",
        shape=(2,),
        columns="disparity_0 disparity_1",
        rows="right",
    ),
    _derived(
        "disparity_covariances",
        "of the errors of disparity_px",
        unit="px^2",
        shape=(2, 2),
        columns="disparity_var_0 disparity_cov disparity_cov disparity_var_1",
        rows="right",
    ),
    _derived("depth_known", "its disparities tell how far away both ends are", np.bool_, rows="right"),
    _derived(
        "segments_m",
        "the observed line in space, in the left camera's frame; NaN where its depth is not known",
        unit="m",
        shape=(2, 3),
        columns="x0_m y0_m z0_m x1_m y1_m z1_m",
        rows="right",
    ),
    _derived(
        "segments_m_covariances",
        "of the errors of segments_m: those across the line alone, so its rank is 4",
        unit="m^2",
        shape=(6, 6),
        columns=" ".join(f"cov_{min(j, k)}{max(j, k)}_m2" for j in range(6) for k in range(6)),
        rows="right",
    ),
)
