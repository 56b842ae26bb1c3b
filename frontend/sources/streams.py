"""Which of a folder's images are frames, where there are several pictures of each moment: colour among depth."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from itertools import compress, pairwise, zip_longest
from pathlib import Path

from airline.errors import InputError

_DEPTH = {"depth", "depths", "disp", "disparity", "disparities"}
_MEASURED = _DEPTH | {
    *("mask", "masks", "label", "labels", "seg", "segmentation", "semantic", "semantics", "instance", "instances"),
    *("normal", "normals", "flow", "conf", "confidence", "albedo", "gt", "groundtruth"),
}
_COLOUR = {"color", "colour", "colors", "colours", "rgb", "bgr"}
_SEEN = _COLOUR | {"thermal", "flir", "lwir", "ir", "nir", "infrared", "gray", "grey", "mono", "left", "right"}
_CAMERA = re.compile(r"^(.*?(?:cam|camera|image|img|view)[-_]?)(\d{1,2})(([-_]|\.(?!\d)).*\d.*)$", re.IGNORECASE)
_INTO = re.compile(r"[-_](?:to|in|on)[-_]|To(?=[A-Z])|(?<=[a-z])2(?=[a-z])")  # depth_to_color shows depth
_MOST_CAMERAS = 8
_SHARE = 0.8  # of all images; otherwise the folder has names of many kinds, as collections of photographs have
_MOST_WORDS = 3  # in a name that says what is in a file, not what somebody works on


def words_of(name: str) -> set[str]:
    """The words of a name, in lower case: "left_disp01" has "left" and "disp", "depth_to_color" has "depth"."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", _INTO.split(name)[0])}


def says_depth(path: Path) -> bool:
    """Whether a file's name, or else that of its folder, tells of depth rather than light."""
    for words in (words_of(path.stem), words_of(path.parent.name)):
        if words & (_DEPTH | _SEEN) and len(words) <= _MOST_WORDS:
            return not words & _SEEN
    return "proj_depth" in path.parts  # KITTI's


def choose_frames(images: list[Path], notes: list[str]) -> list[Path]:
    """The images of one camera that takes pictures of light, in the same order; what is left out goes into the notes.

    Raises:
        InputError: it cannot be told which of several pictures of each moment are the frames.
    """
    if len(images) < 2:
        return images
    groups = _grouped(images)
    if len(groups) > 1:
        groups = _without_measured(groups, notes)
    if len(groups) > 1 and (paired := _paired(groups)):
        chosen = _choice(paired)
        if chosen is not None:
            left = sum(len(groups[key]) for key in paired if key != chosen)
            others = next(groups[key][0].name for key in paired if key != chosen)
            notes.append(
                f"of several pictures of each moment those like '{groups[chosen][0].name}' are taken, {left} like "
                f"'{others}' are left out: a glob pattern chooses others"
            )
            groups = {key: group for key, group in groups.items() if key == chosen or key not in paired}
        else:
            one, other = (groups[key][0].name for key in paired[:2])
            if _alternate(images, groups[paired[0]], groups[paired[1]]):
                raise InputError(
                    f"each moment has several pictures, such as '{one}' and '{other}': choose by a glob pattern"
                )
            notes.append(f"series like '{one}' and '{other}' follow each other: a glob pattern chooses one")
    kept = {path for group in groups.values() for path in group}
    return [path for path in images if path in kept]


def _grouped(images: list[Path]) -> dict[tuple[str, str], list[Path]]:
    """Images by their name with its numbers left out, or if those are all the same by the number of a camera."""
    parents = {path.parent for path in images}
    groups: dict[tuple[str, str], list[Path]] = defaultdict(list)
    for path in images:
        stem = path.stem if len(parents) == 1 else f"{path.parent.name}/{path.stem}"
        groups[re.sub(r"(?:(?<![^_ =])[-+])?[\d.]+", "#", stem), path.suffix.lower()].append(path)
    if len(groups) > 1 or len(parents) > 1:
        return groups
    cameras: dict[tuple[str, str], list[Path]] = defaultdict(list)
    moments: dict[str, set[str]] = defaultdict(set)
    for path in images:
        found = _CAMERA.match(path.stem)
        if found is None:
            return groups
        cameras[found[1] + found[2] + "#", path.suffix.lower()].append(path)
        moments[found[2]].add(found[3])
    first, *others = moments.values()
    if not others or len(moments) > _MOST_CAMERAS or len(first) < 2:
        return groups
    return cameras if all(2 * len(first & other) > len(first) for other in others) else groups


def _without_measured(groups: dict[tuple[str, str], list[Path]], notes: list[str]) -> dict[tuple[str, str], list[Path]]:
    measured = {key for key in groups if words_of(key[0]) & _MEASURED}
    if not measured or len(measured) == len(groups):
        return groups
    kept = {key: group for key, group in groups.items() if key not in measured}
    count, left = (sum(len(groups[key]) for key in keys) for keys in (kept, measured))
    example = groups[min(measured)][0].name
    notes.append(f"{left} image{'s' * (left > 1)} like '{example}' left out as depth or labels, {count} kept")
    return kept


def _paired(groups: dict[tuple[str, str], list[Path]]) -> list[tuple[str, str]]:
    """The groups whose names mostly have the numbers of the largest one's, that one first; [] if there are none."""
    largest = max(groups, key=lambda key: len(groups[key]))
    numbers = {key: _moments(key, group) for key, group in groups.items()}
    most = numbers[largest]
    others = [
        key for key in groups if key != largest and 2 * len(numbers[key] & most) > max(len(numbers[key]), len(most))
    ]
    paired = [largest, *others]
    most_of_all = sum(len(groups[key]) for key in paired) >= _SHARE * sum(map(len, groups.values()))
    return paired if others and len(groups[largest]) > 1 and most_of_all else []


def _moment(key: tuple[str, str], path: Path) -> tuple[str, ...]:
    found = _CAMERA.match(path.stem)
    return (found[3],) if found and key[0] == f"{found[1]}{found[2]}#" else tuple(re.findall(r"\d+", path.stem))


def _moments(key: tuple[str, str], group: list[Path]) -> set[tuple[str, ...]]:
    """The numbers in the names of a group, without those that are the same in all, as in "8bit"."""
    rows = [_moment(key, path) for path in group]
    varying = [len(set(column)) > 1 for column in zip_longest(*rows)]
    return {tuple(compress(row, varying)) for row in rows}


def _choice(keys: Sequence[tuple[str, str]]) -> tuple[str, str] | None:
    """The colour images, the left ones, or those of the first camera."""
    for words in (_COLOUR, {"left"}):
        having = [key for key in keys if words_of(key[0]) & words]
        if having and len(having) < len(keys):
            return having[0] if len(having) == 1 else _choice(having)
    return min(keys) if all(re.search(r"\d#$", key[0]) for key in keys) else None


def _alternate(images: list[Path], one: list[Path], other: list[Path]) -> bool:
    """Whether two groups take turns in the order of the images."""
    first, both = set(one), {*one, *other}
    turns = [path in first for path in images if path in both]
    return sum(a != b for a, b in pairwise(turns)) >= len(turns) // 2
