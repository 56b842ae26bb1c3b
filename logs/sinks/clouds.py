"""The messages of PL-VINS and its kin: topics, and what is in each channel, which they read by position.

Read from the sources: PL-VINS (cnqiangfu/PL-VINS, da47af3), EPLF-VINS (LeiXu1999/EPLF-VINS, ac78538), UV-SLAM
(url-kaist/UV-SLAM, 303ab90 and 078b169), VINS-Mono (HKUST-Aerial-Robotics/VINS-Mono, 0d28093), which all of them
descend from. Structure-PLP-SLAM (PeterFWS/Structure-PLP-SLAM, 87dafe0) takes images alone, no messages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from airline.errors import ConfigError
from frontend.camera.model import CameraModel
from logs.sinks.vanishing import vanishing_points

Float32 = NDArray[np.float32]


def _none() -> Float32:
    return np.zeros(0, np.float32)


def _no_points() -> Float32:
    return np.zeros((0, 2), np.float32)


@dataclass(frozen=True)
class Observed:
    """What the messages of one time tell of.

    Attributes:
        stamp_ns: of the image.
        camera: of the image; None in a message without lines.
        line_numbers: (K,) numbers of the lines.
        lines: (K, 2, 2) their ends, undistorted, on the plane z = 1.
        point_numbers: (P,) numbers of the points.
        points: (P, 2) the points, undistorted, on the plane z = 1.
        points_px: (P, 2) the points in the image as it is, px.
        velocities: (P, 2) of `points`, per second.
    """

    stamp_ns: int
    camera: CameraModel | None = None
    line_numbers: Float32 = field(default_factory=_none)
    lines: Float32 = field(default_factory=lambda: np.zeros((0, 2, 2), np.float32))
    point_numbers: Float32 = field(default_factory=_none)
    points: Float32 = field(default_factory=_no_points)
    points_px: Float32 = field(default_factory=_no_points)
    velocities: Float32 = field(default_factory=_no_points)

    @property
    def lines_px(self) -> Float32:
        """(K, 2, 2) ends in the undistorted picture of UV-SLAM, OpenCV's, which keeps the camera's matrix, px."""
        return self._in_picture(lambda camera: (camera.cx, camera.cy))

    @property
    def lines_centred_px(self) -> Float32:
        """(K, 2, 2) ends in the undistorted picture of PL-VINS, where the optical axis is in the middle, px.

        The middle is half the width and height without a remainder (camodocal's `initUndistortRectifyMap`).
        """
        return self._in_picture(lambda camera: (camera.width // 2, camera.height // 2))

    def _in_picture(self, middle: Callable[[CameraModel], tuple[float, float]]) -> Float32:
        if self.camera is None:
            return self.lines
        return (self.lines * (self.camera.fx, self.camera.fy) + middle(self.camera)).astype(np.float32)


Column = Callable[[Observed], Float32]


@dataclass(frozen=True)
class Cloud:
    """A topic of `sensor_msgs/PointCloud`.

    Attributes:
        topic: its name.
        points: (K, 2) x and y of its points; z is 1.
        channels: names of channels, and the numbers of these: a column for each name. Nobody reads the names.
    """

    topic: str
    points: Column
    channels: Mapping[str, Column]

    def columns(self, observed: Observed) -> dict[str, Float32]:
        """Name and values of each channel."""
        found: dict[str, Float32] = {}
        for names, column in self.channels.items():
            values = column(observed)
            rows = values.reshape(len(values), len(names.split()))
            found |= dict(zip(names.split(), np.ascontiguousarray(rows.T), strict=True))
        return found


@dataclass(frozen=True)
class System:
    """What an estimator takes.

    Attributes:
        name: for people.
        lines: its topic of lines alone, if it has one.
        points: its topic of points, which holds the lines too where there is no other.
        by_order: it takes the messages of both topics for pairs by their order, whatever their stamps.
        restart: topic of the `std_msgs/Bool` at which it starts anew.
    """

    name: str
    lines: Cloud | None
    points: Cloud
    by_order: bool = False
    restart: str | None = None


POINTS: dict[str, Column] = {  # PL-VINS and EPLF-VINS read the first three, VINS-Mono all of them
    "id_of_point": lambda seen: seen.point_numbers,
    "u_of_point v_of_point": lambda seen: seen.points_px,
    "velocity_x_of_point velocity_y_of_point": lambda seen: seen.velocities,
}
LINES: dict[str, Column] = {  # the start is in the points; PL-VINS's picture (image_node_b) reads from the fourth on
    "id_of_line": lambda seen: seen.line_numbers,
    "u_of_endpoint v_of_endpoint": lambda seen: seen.lines[:, 1],
    "start_u_of_line start_v_of_line end_u_of_line end_v_of_line": lambda seen: seen.lines_centred_px,
}
BOTH: dict[str, Column] = POINTS | {
    "id_of_line": lambda seen: seen.line_numbers,
    "start_x_of_line start_y_of_line end_x_of_line end_y_of_line": lambda seen: seen.lines,
    "start_u_of_line start_v_of_line end_u_of_line end_v_of_line": lambda seen: seen.lines_px,
    # zeros in UV-SLAM's own messages too: an end has no velocity along the line
    "start_velocity_x start_velocity_y end_velocity_x end_velocity_y": lambda seen: np.zeros_like(seen.lines),
    "vp_x vp_y vp_z": lambda seen: vanishing_points(seen.lines),  # it looks at those whose last number is 1
}


def _starts(seen: Observed) -> Float32:
    return seen.lines[:, 0]


def _points(seen: Observed) -> Float32:
    return seen.points


SYSTEMS = {
    "plvins": System(
        "PL-VINS",
        Cloud("/linefeature_tracker/linefeature", _starts, LINES),
        Cloud("/feature_tracker/feature", _points, POINTS),
        by_order=True,
    ),
    "eplf": System(
        "EPLF-VINS",
        Cloud("/lf_linefeature_tracker/linefeature", _starts, LINES),
        Cloud("/lf_feature_tracker/feature", _points, POINTS),
    ),
    "uvslam": System(
        "UV-SLAM",
        None,
        Cloud("/feature_tracker/feature", _points, BOTH),
        restart="/feature_tracker/restart",
    ),
}


def check_points(system: str, points: bool) -> None:
    """Refuse, before any work, a system of `SYSTEMS` that takes points with the lines, if there are none."""
    if SYSTEMS[system].lines is None and not points:
        raise ConfigError(f"{SYSTEMS[system].name} takes points and lines in one message: add --points")
