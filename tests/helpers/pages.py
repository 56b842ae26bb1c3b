"""The documentation's pages: their code blocks, with what a page says of running them, and their links.

A comment above a block says what the checks do otherwise than a reader, and why. It concerns the whole block, or those
of its lines that contain the text between the last backticks:

    <!-- ci: skip because REASON -->
    <!-- ci: skip `frontend.run 0` because REASON -->
    <!-- ci: append `--limit 1` because REASON -->
    <!-- ci: append `--frame 6` to `viz.snapshot` because REASON -->
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SHOWN = frozenset({"", "json"})  # languages of blocks that are to be read, not run

_BLOCK = re.compile(r"((?:^<!-- ci:[^\n]*\n)*)^```(\S*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_MARKER = re.compile(
    r"<!-- ci: (?:skip(?: `(?P<skipped>[^`]+)`)?|append `(?P<append>[^`]+)`(?: to `(?P<to>[^`]+)`)?) because \S.+ -->"
)
_COMMENT = re.compile(r"\s+#\s.*$")
_LINK = re.compile(r"\]\(([^)\s]+)\)")


class PageError(ValueError):
    """A marker that means nothing, or concerns nothing."""


@dataclass(frozen=True)
class Block:
    """A fenced block, the number of its first line in the page, and the markers right above it."""

    language: str
    number: int
    text: str
    markers: tuple[re.Match[str], ...] = ()

    def commands(self) -> list[tuple[int, str]]:
        """Numbers and texts of the lines to run, as the markers change them; of Python, all of it or nothing."""
        lines = [(self.number, self.text)]
        if self.language != "python":
            rows = enumerate(self.text.splitlines(), self.number)
            lines = [(number, text) for number, row in rows if (text := _COMMENT.sub("", row).strip())]
        for marker in self.markers:
            wanted = marker["skipped"] or marker["to"] or ""
            if not any(wanted in text for _, text in lines):
                raise PageError(f"above line {self.number}: no command contains '{wanted}'")
            added = marker["append"]
            lines = [(n, f"{t} {added}" if wanted in t else t) for n, t in lines if added or wanted not in t]
        return lines


def blocks_of(page: str) -> list[Block]:
    """All fenced blocks of a page; PageError where a marker means nothing, or a fence does not end."""
    blocks: list[Block] = []
    for found in _BLOCK.finditer(page):
        markers = [_MARKER.fullmatch(line) for line in found[1].splitlines()]
        number = page.count("\n", 0, found.start(3)) + 1
        if None in markers:
            raise PageError(f"above line {number}: a marker of no known form, or without a reason")
        blocks.append(Block(found[2], number, found[3], tuple(marker for marker in markers if marker)))
    if len(re.findall("^<!-- ci:", page, re.MULTILINE)) != sum(len(block.markers) for block in blocks):
        raise PageError("a marker stands right above its block, and one does not")
    if len(re.findall("^```", page, re.MULTILINE)) != 2 * len(blocks):
        raise PageError("a block does not end")
    return blocks


def links_of(page: str) -> list[str]:
    """Targets of all links and pictures outside of code."""
    return _LINK.findall(re.sub(r"`[^`\n]*`", "", _BLOCK.sub("", page)))


def anchors_of(page: str) -> set[str]:
    """What the headings of a page are called in links to them, as GitHub makes it."""
    headings = re.findall(r"^#+ (.+)$", _BLOCK.sub("", page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
