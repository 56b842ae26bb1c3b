"""Settings: presets, files and flags, laid over each other."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec
import pytest
from hypothesis import HealthCheck, given, reject, settings
from hypothesis import strategies as st

from airline.config import preset
from airline.errors import ConfigError
from frontend.cli.settings import InputConfig, RunConfig, dump, load
from tests.helpers.command import command

CHECKS = [HealthCheck.function_scoped_fixture, HealthCheck.filter_too_much]  # many values contradict each other
in_one_folder = settings(max_examples=40, suppress_health_check=CHECKS)
SIZES = st.integers(16, 9999)
STRINGS = {
    "resize": st.one_of(SIZES.map(str), st.tuples(SIZES, SIZES).map(lambda size: f"{size[0]}x{size[1]}")),
    "text": st.text(st.characters(exclude_categories=["Cs"]), max_size=30),
}


def leaves(kind: type[msgspec.Struct], *above: str) -> list[tuple[tuple[str, ...], Any]]:
    """Path and type of every setting."""
    found = []
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
            found += leaves(hint, *above, name)
        else:
            found.append(((*above, name), hint))
    return found


LEAVES = leaves(RunConfig)
TABLES = [(), *sorted({path[:depth] for path, _ in LEAVES for depth in range(1, len(path))})]


def values(name: str, hint: Any) -> st.SearchStrategy[Any]:
    """Plausible values of a setting of this type."""
    if get_origin(hint) is Annotated:
        return values(name, get_args(hint)[0])
    if get_origin(hint) in (Union, UnionType):
        return st.one_of([values(name, kind) for kind in get_args(hint) if kind is not type(None)])
    if get_origin(hint) is Literal:
        return st.sampled_from(get_args(hint))
    plain = {bool: st.booleans(), int: st.integers(1, 99), float: st.floats(2**-10, 99)}
    return plain[hint] if hint in plain else STRINGS.get(name, STRINGS["text"])


def nested(flat: dict[tuple[str, ...], Any]) -> dict[str, Any]:
    """{("a", "b"): 1} as {"a": {"b": 1}}."""
    tree: dict[str, Any] = {}
    for path, value in flat.items():
        table = tree
        for key in path[:-1]:
            table = table.setdefault(key, {})
        table[path[-1]] = value
    return tree


def value_at(tree: Any, path: tuple[str, ...]) -> Any:
    for key in path:
        tree = tree[key] if isinstance(tree, dict) else getattr(tree, key)
    return tree


# any few of the settings: the more of them, the more often they contradict each other
parts = st.sets(st.sampled_from(range(len(LEAVES))), max_size=8).flatmap(
    lambda some: st.fixed_dictionaries({path: values(path[-1], hint) for path, hint in (LEAVES[k] for k in some)})
)


def write(folder: Path, text: str) -> Path:
    (folder / "settings.toml").write_text(text, encoding="utf-8")
    return folder / "settings.toml"


@given(part=parts)
@in_one_folder
def test_dump_reads_back_as_the_same_settings(tmp_path: Path, part: dict[tuple[str, ...], Any]) -> None:
    try:
        config = load(None, nested(part))
    except ConfigError:  # two values that contradict each other
        reject()
    for path, value in part.items():
        assert value_at(config, path) == value
    assert load(write(tmp_path, dump(config)), {}) == config


@given(stored=parts, given_flags=parts)
@in_one_folder
def test_flags_over_file_over_preset(tmp_path, stored, given_flags):
    """Each setting comes from the first of the three that names it."""
    import tomli_w

    try:
        config = load(write(tmp_path, tomli_w.dumps(nested(stored))), nested(given_flags))
    except ConfigError:
        reject()
    chosen = {**stored, **given_flags}
    base = RunConfig(detector=preset(chosen.get(("preset",), "default")))
    for path, _ in LEAVES:
        assert value_at(config, path) == chosen.get(path, value_at(base, path))


@pytest.mark.parametrize("path", [path for path, _ in LEAVES], ids=".".join)
def test_wrong_type_is_an_error_that_names_the_setting(path: tuple[str, ...]) -> None:
    for wrong in ([], {}, tomllib.loads("a = 2020-01-01")["a"]):
        with pytest.raises(ConfigError, match=path[-1]):
            load(None, nested({path: wrong}))


@pytest.mark.parametrize("table", TABLES, ids=lambda path: ".".join(path) or "top")
def test_unknown_key_is_an_error_that_names_it(table: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError, match="colour"):
        load(None, nested({(*table, "colour"): 1}))
    if table:
        with pytest.raises(ConfigError, match=table[-1]):
            load(None, nested({table: 1}))


@pytest.mark.parametrize("number", ["nan", "-nan", "inf", "-inf", "1e999"])
def test_numbers_must_be_finite(tmp_path: Path, number: str) -> None:
    for setting in ("detector.edges.threshold", "tracker.band", "input.start"):
        with pytest.raises(ConfigError, match="finite"):
            load(write(tmp_path, f"{setting} = {number}"), {})


WRONG = """
input = {start = 5, end = 5}; input.resize = "x480"; input.resize = ""; recording.jpeg_quality = 0
recording.jpeg_quality = 101; recording.descriptor_every = -1; tracker.confirm_hits = 0; tracker.max_lines = -1
"""


@pytest.mark.parametrize("text", re.split("[;\n]", WRONG.strip()))
def test_out_of_range(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError):
        load(write(tmp_path, text), {})
    assert InputConfig(resize="640").size == (640, None)


def test_dump_config_feeds_config(tmp_path: Path) -> None:
    flags = "--start 1 --end 9.5 --stride 2 --max-frames 7 --resize 320x240 --fps 10 --topic /left --preset paper"
    flags += " --weights my.safetensors --runtime torch --max-lines 90 --show-lost"
    first = command("--dump-config", *flags.split())
    assert (first.code, first.err) == (0, "")
    config = load(write(tmp_path, first.out), {})
    assert config.input == InputConfig(
        start=1, end=9.5, stride=2, max_frames=7, resize="320x240", fps=10, topic="/left"
    )
    assert (config.preset, config.runtime, config.detector.edges.weights) == ("paper", "torch", "my.safetensors")
    assert config.detector.grow == preset("paper").grow
    assert (config.tracker.max_lines, config.recording.show_lost) == (90, True)
    assert command("--dump-config", "--config", tmp_path / "settings.toml") == first
