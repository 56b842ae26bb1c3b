"""Camera calibrations in the files of calibration tools and data sets; what a file is shows in its content."""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta, Struct

from airline.errors import ConfigError, InputError
from frontend.camera.model import LARGEST, MAX_SIDE, CameraModel, lens
from frontend.camera.number_files import camera_of, intrinsics, left_3x3, number_rows
from frontend.camera.rig import rig_of_projection, rigid, rigs_of_chain

log = logging.getLogger(__name__)

_MAX_BYTES = 256 * 1024
_MAX_DEPTH = 32
_CAMERA = re.compile(r"cam\d{1,4}")
_NUMBERED = re.compile(r"(?:cam|image_)0?(\d)|(?:images?_)?(?:(l|left)|r|right)")  # folders of EuRoC, KITTI, pairs
_RECTIFIED = frozenset({"rect", "rectified"})
_OPENCV_HEADER = re.compile(r"\A%YAML:1\.\d[^\n]*\n")  # a colon for a space

T = TypeVar("T")
_Side = Annotated[int, Meta(ge=1, le=MAX_SIDE)]
_Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
_Two = Annotated[list[_Side], Meta(min_length=2, max_length=2)]
_Four = Annotated[list[_Number], Meta(min_length=4, max_length=4)]
_Nine = Annotated[list[_Number], Meta(min_length=9, max_length=9)]
_Twelve = Annotated[list[_Number], Meta(min_length=12, max_length=12)]


class _Euroc(Struct):
    """EuRoC's `sensor.yaml`, and each of `cam0`, `cam1`, ... in Kalibr's `camchain.yaml`."""

    resolution: _Two
    intrinsics: _Four
    camera_model: str = "pinhole"
    distortion_model: str = "none"
    distortion_coefficients: list[_Number] | None = None
    distortion_coeffs: list[_Number] | None = None
    T_BS: list[Any] | None = None


class _Ros(Struct):
    """ROS's `camera_info` of the raw images; OpenCV's own calibration sample writes the same fields."""

    image_width: _Side
    image_height: _Side
    camera_matrix: _Nine
    distortion_coefficients: list[_Number]
    distortion_model: str | None = None
    fisheye_model: int = 0  # OpenCV's sample names no model
    rectification_matrix: _Nine | None = None
    projection_matrix: _Twelve | None = None


class _Simple(Struct, forbid_unknown_fields=True):
    """JSON or YAML of what `CameraModel` holds."""

    width: _Side
    height: _Side
    fx: _Number
    fy: _Number
    cx: _Number
    cy: _Number
    distortion: str = "none"
    coefficients: list[_Number] = []
    rig_from_camera: list[Any] | None = None


@dataclass(frozen=True)
class Calibration:
    """A camera out of a file.

    Attributes:
        file: where it is from.
        camera: width and height are 0 where the file does not tell the size of its images; `fit_camera` takes it.
        which: its name in a file with several.
        y_up: whether the file's y axis points up, with a negative fy, as in ICL-NUIM's.
        number: its place in a file with several, from 0; None in a file of one.
    """

    file: Path
    camera: CameraModel
    which: str = ""
    y_up: bool = False
    number: int | None = None

    def __str__(self) -> str:
        name = os.fsencode(self.file).decode(errors="replace")  # it may hold bytes that are no text
        return f"{self.which and self.which + ' of '}'{name}', fx {self.camera.fx:.1f} px"


def read_calibration(path: str | os.PathLike[str], images: str | os.PathLike[str] | None = None) -> Calibration:
    """Read a camera from a calibration file, with `rig_from_camera` where it says how several lie to each other.

    Args:
        path: the file.
        images: the images or their folder, whose name tells which of several cameras they are from: `cam1`, `image_2`,
            `right`. It is the first one where no name tells; of a camchain with a warning. Of ROS's YAML a name such as
            `image_rect` takes the projection matrix, without the lens.

    Raises:
        InputError: the file cannot be read, or a field is missing or makes no sense.
        ConfigError: the camera's model is not supported.
    """
    return _calibration(Path(path), images, _number(images))


def read_pair(
    path: str | os.PathLike[str],
    images: tuple[str | os.PathLike[str], str | os.PathLike[str]],
    right_path: str | os.PathLike[str] | None = None,
) -> tuple[Calibration, Calibration]:
    """Read the left and the right camera of a pair, from one file or from two; see `read_calibration`.

    Where no name tells which camera of one file is which, the left one is the first, and the right one comes next.

    Raises:
        InputError, ConfigError: as of `read_calibration`; or one file holds one camera.
    """
    left = _calibration(Path(path), images[0], _number(images[0]) or 0)
    if right_path not in (None, path):
        return left, read_calibration(right_path or path, images[1])
    number = _number(images[1])
    right = _calibration(Path(path), images[1], (left.number or 0) + 1 if number in (None, left.number) else number)
    if right.number in (None, left.number):
        raise InputError(f"'{path}' holds one camera, and a pair has two: give the right one's with --right-calib")
    return left, right


def _calibration(file: Path, images: str | os.PathLike[str] | None, number: int | None) -> Calibration:
    """The camera of that number where there are several, of these images."""
    text = _read(file)
    try:
        if (rows := number_rows(text)) is not None:
            rectified = not any(part.endswith("_extract") for part in _parts(images))  # KITTI's name for raw images
            return Calibration(file, *camera_of(rows, number or 0, rectified=rectified))
        content = _parsed(text)
        tree = content if isinstance(content, dict) else {}
        chain = {str(name): entry for name, entry in tree.items() if _CAMERA.fullmatch(str(name))}
        chain = {name: entry for name, entry in chain.items() if isinstance(entry, dict)}
        if chain:
            topics = {str(entry["rostopic"]): int(name[3:]) for name, entry in chain.items() if "rostopic" in entry}
            number = topics.get(str(images), number)
            name = min(chain, key=lambda name: (name != f"cam{number}", int(name[3:])))
            if len(chain) > 1 and number is None:
                log.warning("'%s' holds %s: using %s", file, ", ".join(chain), name)
            rig = rigs_of_chain({key: chain[key] for key in sorted(chain, key=lambda key: int(key[3:]))})[name]
            camera = replace(_euroc(chain[name], f"{name}."), rig_from_camera=rig)
            return Calibration(file, camera, name, number=int(name[3:]))
        if "camera_matrix" in tree:
            rectified = "projection_matrix" in tree and images is not None and says_rectified(images)
            return Calibration(file, _ros(tree, rectified), "projection_matrix" if rectified else "")
        for field, camera_in in {"intrinsics": _euroc, "fx": _simple}.items():
            if field in tree:
                return Calibration(file, camera_in(tree))
    except (ConfigError, InputError) as error:
        raise type(error)(f"'{file}': {error}") from None
    raise InputError(
        f"'{file}' is no camera calibration: give a EuRoC sensor.yaml, a Kalibr camchain, a ROS camera_info YAML, the "
        'calib.txt of KITTI or TUM, or JSON such as {"width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 319.5, '
        '"cy": 239.5}'
    )


def is_rectified(name: str) -> bool:
    """Whether a topic's or a path's name says so of its images, as `/left/image_rect_color/compressed` does."""
    return any(not _RECTIFIED.isdisjoint(part.split("_")) for part in name.split("/"))


def says_rectified(images: str | os.PathLike[str]) -> bool:
    """Whether one of the last three names in the path of images says that they are rectified."""
    return is_rectified("/".join(Path(os.path.abspath(images)).parts[-3:]))  # noqa: PTH100  keeps links


def _parts(images: str | os.PathLike[str] | None) -> tuple[str, ...]:
    return Path(os.path.abspath(images)).parts if images is not None else ()  # noqa: PTH100  keeps links


def _number(images: str | os.PathLike[str] | None) -> int | None:
    """Which camera the last names in a path or a topic stand for, from 0; None where they do not tell."""
    found = [match for part in _parts(images)[-3:] if (match := _NUMBERED.fullmatch(part))]
    return int(found[-1][1] or found[-1][2] is None) if found else None


def fit_camera(camera: CameraModel, width: int, height: int) -> CameraModel:
    """The camera for images of another resolution, up to a pixel of the same aspect ratio.

    A camera of size 0 is taken to be for these images if its principal point lies in their middle half.

    Raises:
        InputError: the images are not the calibrated ones resized.
    """
    if (width, height) == (camera.width, camera.height):
        return camera
    if not camera.width:
        if not (width / 4 < camera.cx + 0.5 < 3 * width / 4 and height / 4 < camera.cy + 0.5 < 3 * height / 4):
            raise InputError(
                f"the calibration's principal point ({camera.cx:.0f}, {camera.cy:.0f}) is not in the middle half of "
                f"images of {width}x{height} px: if these were resized, give JSON with the width and height before"
            )
        return replace(camera, width=width, height=height)
    if abs(width * camera.height - height * camera.width) > max(camera.width, camera.height):
        raise InputError(
            f"the calibration is for images of {camera.width}x{camera.height} px, these have {width}x{height}: "
            "calibrate for this resolution"
        )
    return camera.scaled(width, height)


def _euroc(tree: Mapping[str, Any], prefix: str = "") -> CameraModel:
    found = _checked(tree, _Euroc, prefix)
    if found.camera_model != "pinhole":
        raise ConfigError(f"camera model '{found.camera_model[:40]}' is not supported: calibrate with 'pinhole'")
    coefficients = found.distortion_coefficients if found.distortion_coeffs is None else found.distortion_coeffs
    if coefficients is None and found.distortion_model != "none":
        raise InputError(f"{prefix}distortion_coefficients is missing")
    (width, height), (fx, fy, cx, cy) = found.resolution, found.intrinsics
    distortion = lens(found.distortion_model, coefficients or [])
    rig = None if found.T_BS is None else rigid(found.T_BS, "T_BS")
    return CameraModel(width, height, fx, fy, cx, cy, *distortion, rig_from_camera=rig)


def _ros(tree: Mapping[str, Any], rectified: bool) -> CameraModel:
    found = _checked(tree, _Ros)
    size, projection = (found.image_width, found.image_height), found.projection_matrix or ()
    if rectified:
        return CameraModel(*size, *intrinsics(left_3x3(projection)), rig_from_camera=rig_of_projection(projection))
    model = found.distortion_model
    if model is None:
        model = "equidistant" if found.fisheye_model else "plumb_bob"
    distortion = lens(model, found.distortion_coefficients)
    rig = rig_of_projection(projection, found.rectification_matrix or ())
    return CameraModel(*size, *intrinsics(found.camera_matrix), *distortion, rig_from_camera=rig)


def _simple(tree: Mapping[str, Any]) -> CameraModel:
    found = _checked(tree, _Simple)
    distortion = lens(found.distortion, found.coefficients)
    rig = None if found.rig_from_camera is None else rigid(found.rig_from_camera, "rig_from_camera")
    pinhole = found.fx, found.fy, found.cx, found.cy
    return CameraModel(found.width, found.height, *pinhole, *distortion, rig_from_camera=rig)


def _checked(tree: Mapping[str, Any], kind: type[T], prefix: str = "") -> T:
    """The fields of a mapping; lists may also have OpenCV's form {rows, cols, data}."""
    fields = {
        name: value.get("data", value) if isinstance(value, dict) else value
        for name, value in tree.items()
        if isinstance(name, str)
    }
    try:
        return msgspec.convert(fields, kind, strict=False)  # numbers may be texts
    except (msgspec.ValidationError, UnicodeError) as error:  # a lone surrogate
        what, _, where = str(error).partition(" - at `$.")
        place = (prefix + where).rstrip(".`")
        raise InputError(f"{place}{place and ': '}{what[0].lower()}{what[1:]}") from None


def _read(path: Path) -> str:
    """The text of a small file: files come from strangers."""
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"'{path}' is not a text file") from None
    except (OSError, ValueError) as error:  # no permission; a name that no file can have
        raise InputError(f"cannot read '{path}': {error}") from None
    if len(data) > _MAX_BYTES:
        raise InputError(f"'{path}' is longer than the {_MAX_BYTES // 1024} KB that a calibration may have")
    return text


def _parsed(text: str) -> Any:
    """The content of JSON or YAML; of several YAML documents the first."""
    if text.lstrip().startswith("{"):
        try:
            return json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"not valid JSON: {error}") from None
    return _yaml(_OPENCV_HEADER.sub("", text))


def _yaml(text: str) -> Any:
    """Deeply nested YAML is refused, and so are anchors, with which a short text can stand for gigabytes."""
    from ruamel.yaml import YAML
    from ruamel.yaml.constructor import SafeConstructor
    from ruamel.yaml.error import YAMLError
    from ruamel.yaml.events import CollectionEndEvent, CollectionStartEvent, DocumentEndEvent
    from ruamel.yaml.nodes import MappingNode, SequenceNode

    class Plain(SafeConstructor):
        """What has a tag of its own, or would become a date, is read as if it had none."""

        def plain(self, node: Any) -> Any:
            if isinstance(node, MappingNode):
                return self.construct_mapping(node, deep=True)
            return self.construct_sequence(node, deep=True) if isinstance(node, SequenceNode) else node.value

    for tag in (None, "tag:yaml.org,2002:timestamp", "tag:yaml.org,2002:binary"):
        Plain.add_constructor(tag, Plain.plain)
    yaml, depth = YAML(typ="safe", pure=True), 0
    yaml.Constructor = Plain
    try:
        for event in yaml.parse(text):
            depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
            if getattr(event, "anchor", None) is not None:
                raise InputError(f"it has the YAML anchor '{event.anchor}': write its value out instead")
            if depth > _MAX_DEPTH:
                raise InputError(f"it is nested deeper than {_MAX_DEPTH} levels")
            if isinstance(event, DocumentEndEvent):
                break
        return next(yaml.load_all(text), None)
    except (YAMLError, ValueError, LookupError, TypeError, AttributeError) as error:  # the parser's slips, too
        problem = (getattr(error, "problem", None) or str(error)).partition("\n")[0]
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark is not None else ""
        raise InputError(f"not valid YAML{where}: {problem}") from None
