"""README and docs: every command and code block runs, every link leads somewhere."""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from pathlib import Path

import pytest

from tests.helpers.page_inputs import prepare
from tests.helpers.page_runner import run_command, run_page, run_python
from tests.helpers.pages import PAGES, ROOT, PageError, anchors_of, blocks_of, links_of

LINKING = [*PAGES, ROOT / "CHANGELOG.md", ROOT / "airline" / "network" / "weights" / "README.md"]


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.fixture(scope="session")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages") / "inputs"
    folder.mkdir()
    prepare(folder)
    return folder


@pytest.mark.usefixtures("short_built_in_clip")
@pytest.mark.filterwarnings("default")  # as readers have it
@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_everything_on_the_page_runs(page: Path, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(inputs, tmp_path / "work")
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    for screen in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(screen, raising=False)
    assert run_page(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("page", LINKING, ids=name_of)
def test_json_is_valid_and_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for block in blocks_of(text):
        if block.language == "json":
            json.loads(block.text)
    for link in links_of(text):
        if "://" in link:
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        assert target.exists(), f"{name_of(page)} links to {link}"
        if anchor:
            assert anchor in anchors_of(target.read_text(encoding="utf-8")), f"{name_of(page)} links to {link}"


def test_readme_lists_every_page() -> None:
    linked = links_of((ROOT / "README.md").read_text(encoding="utf-8"))
    assert [name_of(page) for page in PAGES[1:] if name_of(page) not in linked] == []


def test_markers_change_the_lines_they_name() -> None:
    page = """<!-- ci: skip `camera` because there is none -->
<!-- ci: append `--limit 1` to `b` because it is long -->
```sh
python -m a         # comment
python -m b --out x # comment
python -m c camera
```
"""
    (block,) = blocks_of(page)
    assert block.commands() == [(4, "python -m a"), (5, "python -m b --out x --limit 1")]
    (block,) = blocks_of("<!-- ci: skip `b` because it is long -->\n```sh\na\n```\n")
    with pytest.raises(PageError, match="no command contains 'b'"):
        block.commands()


@pytest.mark.parametrize("marker", ["skip -->", "skip because -->", "append --x because y -->", "skip because y -->\n"])
def test_markers_without_form_reason_or_block_are_refused(marker: str) -> None:
    for page in (f"<!-- ci: {marker}\n```sh\na\n```\n", f"<!-- ci: {marker}\n", "```sh\na\n"):
        with pytest.raises(PageError):
            blocks_of(page)


def test_what_fails_is_told() -> None:
    assert run_command("python -m frontend.run --max-frames none --headless") is not None
    assert run_command("python -m frontend.run --dump-config") is None
    assert run_command("exit 3") is not None
    assert run_python("backend.add_line(1)", {}) is not None
    assert run_python("1 + 1", {}) is None
