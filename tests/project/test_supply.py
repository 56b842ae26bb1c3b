"""What the package needs is declared, licensed and written down."""

from __future__ import annotations

import ast
import re
import sys
import zipfile
from importlib.metadata import distribution, packages_distributions
from pathlib import Path

import pytest

from tests.helpers import licences, wheel
from tests.helpers.pages import ROOT


def declared() -> set[str]:
    extras = licences.PROJECT["optional-dependencies"]
    texts = [*licences.PROJECT["dependencies"], *(text for extra in licences.EXTRAS for text in extras[extra])]
    return {licences.key_of(re.split(r"[^\w.-]", text)[0]) for text in texts} - {licences.PROJECT["name"]}


def brought_along() -> set[str]:
    """What the declared packages themselves need whatever is installed, as numba needs llvmlite."""
    needed = [text for name in declared() for text in distribution(name).requires or [] if "extra ==" not in text]
    return {licences.key_of(re.split(r"[^\w.-]", text)[0]) for text in needed}


def imported() -> dict[str, str]:
    """Top modules of others that the packages import, each with a file that does."""
    found = {}
    for package in wheel.PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                    names = [node.module]
                found |= {name.split(".")[0]: path.name for name in names}
    ours = {*wheel.PACKAGES, *sys.stdlib_module_names}
    return {name: file for name, file in found.items() if name not in ours}


def test_what_is_imported_is_declared() -> None:
    homes, known = packages_distributions(), declared() | brought_along()
    missing = {
        name: file for name, file in imported().items() if not {licences.key_of(home) for home in homes[name]} & known
    }
    assert missing == {}


def test_tested_versions_cover_everything_declared() -> None:
    pinned = re.findall(r"^([\w.-]+)==", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.MULTILINE)
    assert declared() - {licences.key_of(name) for name in pinned} == set()


UNPINNED = {"setuptools", "torch"}  # the latter's version says how it was built


def test_licences_are_known_permissive_and_written_down() -> None:
    page = (ROOT / "docs" / "supply.md").read_text(encoding="utf-8")
    rows = list(licences.rows())
    pinned = set((ROOT / "constraints.txt").read_text(encoding="utf-8").lower().splitlines())
    if any(f"{name}=={version}".lower() not in pinned for name, version, *_ in rows if name not in UNPINNED):
        pytest.skip("the page is about the versions of constraints.txt, and others are installed here")
    assert [name for name, _, licence, _ in rows if not licences.is_fine(licences.key_of(name), licence)] == []
    assert [name for name, *_ in rows if f"| {name} |" not in page and licences.key_of(name) != "setuptools"] == []
    assert [name for name in licences.ACCEPTED if f"**{name}**" not in page] == []


def test_copyleft_and_unknown_licences_are_told() -> None:
    assert all(licences.is_fine("somebody", licence) for licence in ("MIT", "BSD-3-Clause AND Zlib"))
    copyleft = ("GPL-3.0-or-later", "LGPL-2.1", "GNU Affero General Public License v3", "MIT AND GPL-2.0")
    assert not any(licences.is_fine("somebody", licence) for licence in (*copyleft, "", "Proprietary"))


def test_a_wheel_with_too_much_or_too_little_is_told(tmp_path: Path) -> None:
    path = tmp_path / "airline_frontend-0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as made:
        made.writestr("airline/py.typed", "")
        made.writestr("airline/film.bin", bytes(100_000))
        made.writestr("tests/conftest.py", "")
    faults = "\n".join(wheel.faults_of_wheel(path))
    for part in ("default.safetensors is missing", "viz/py.typed is missing", "film.bin has", "conftest.py does not"):
        assert part in faults
