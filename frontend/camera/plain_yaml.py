"""YAML and JSON from strangers, as plain mappings, lists and texts."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from airline.errors import InputError

Tree = dict[str, Any] | list[Any] | str | bool | None
"""Mappings and lists of trees; the leaves are texts, in JSON also true, false and null."""

_MAX_DEPTH = 32
_OPENCV_HEADER = re.compile(r"\A%YAML:1\.\d[^\n]*\n")  # with a colon where YAML has a space


def read_tree(path: Path, max_bytes: int) -> Tree:
    """Read a small YAML or JSON file.

    Numbers stay texts: who needs a number converts it, and nothing turns into a date or a class of its own. Tags such
    as `!!opencv-matrix` are ignored. Anchors, with which a short file can stand for gigabytes, are refused.

    Args:
        path: the file. Of several YAML documents the first is read.
        max_bytes: longer files are refused.

    Raises:
        InputError: the file cannot be read, is too long, or is neither YAML nor JSON.
    """
    try:
        with path.open("rb") as file:
            data = file.read(max_bytes + 1)
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"'{path}' is not a text file") from None
    except (OSError, ValueError) as error:  # no permission; a name that no file can have
        raise InputError(f"cannot read '{path}': {error}") from None
    if len(data) > max_bytes:
        raise InputError(f"'{path}' is longer than the {max_bytes // 1024} KB that a file of its kind may have")
    if text.lstrip().startswith("{"):
        try:
            return json.loads(text, parse_float=str, parse_int=str, parse_constant=str)  # type: ignore[no-any-return]
        except (ValueError, RecursionError) as error:
            raise InputError(f"'{path}' is not valid JSON: {error}") from None
    return _yaml(_OPENCV_HEADER.sub("", text), path)


def _yaml(text: str, path: Path) -> Tree:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        return _document(YAML(typ="safe", pure=True).parse(text), path)
    except (YAMLError, ValueError, LookupError, TypeError, AttributeError) as error:  # the parser's slips, too
        problem = getattr(error, "problem", None) or str(error).partition("\n")[0]
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark is not None else ""
        raise InputError(f"'{path}' is not valid YAML{where}: {problem}") from None


def _document(events: Iterator[Any], path: Path) -> Tree:
    """The first document; without recursion, since nesting is the file's choice."""
    from ruamel.yaml import events as kinds

    root: list[Any] = []
    open_nodes: list[list[Any]] = [root]  # the items so far of the nodes that are not finished
    mappings = [False]
    for event in events:
        if getattr(event, "anchor", None) is not None:
            raise InputError(f"'{path}' has the YAML anchor '{event.anchor}': write its value out instead")
        if isinstance(event, kinds.ScalarEvent):
            open_nodes[-1].append(event.value)
        elif isinstance(event, (kinds.MappingStartEvent, kinds.SequenceStartEvent)):
            if len(open_nodes) > _MAX_DEPTH:
                raise InputError(f"'{path}' is nested deeper than {_MAX_DEPTH} levels")
            open_nodes.append([])
            mappings.append(isinstance(event, kinds.MappingStartEvent))
        elif isinstance(event, (kinds.MappingEndEvent, kinds.SequenceEndEvent)):
            items = open_nodes.pop()
            open_nodes[-1].append(_mapping(items, path) if mappings.pop() else items)
        elif isinstance(event, kinds.DocumentEndEvent):
            break
    return root[0] if root else None


def _mapping(items: list[Any], path: Path) -> dict[str, Any]:
    keys, values = items[::2], items[1::2]
    mapping: dict[str, Any] = {}
    for key, value in zip(keys, values, strict=True):
        if not isinstance(key, str):
            raise InputError(f"'{path}' has a key that is not a name")
        if key in mapping:
            raise InputError(f"'{path}' has '{key}' twice")
        mapping[key] = value
    return mapping
