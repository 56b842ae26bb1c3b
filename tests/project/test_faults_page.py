"""docs/faults.md: every test that it names is there, and every row names one."""

from __future__ import annotations

import ast
import re

from tests.helpers.command import ROOT

PAGE = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")


def test_every_test_on_the_page_exists() -> None:
    named = re.findall(r"`(test_\w+\.py)::(test_\w+)`", PAGE)
    assert len(named) > 40
    for file, test in named:
        tree = ast.parse(next((ROOT / "tests").rglob(file)).read_text(encoding="utf-8"))
        assert test in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, f"{file}::{test}"


def test_every_fault_has_a_test_and_an_exit_code() -> None:
    rows = [line.split(" | ") for line in PAGE.splitlines() if line.startswith("| ") and not line.startswith("| fault")]
    faults = [row for row in rows if len(row) == 5]
    assert len(faults) > 30
    for row in faults:
        assert re.search(r"\d", row[3]), row[0]
        assert "::" in row[4], row[0]
