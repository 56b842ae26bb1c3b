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
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SHOWN = frozenset({"", "json"})  # languages of blocks that are to be read, not run

_FENCE = re.compile(r"^```(\S*)$")
_MARKER = re.compile(
    r"<!-- ci: (?:(?P<skip>skip)(?: `(?P<skipped>[^`]+)`)?|append `(?P<append>[^`]+)`(?: to `(?P<to>[^`]+)`)?)"
    r" because (?P<reason>\S.+) -->"
)
_COMMENT = re.compile(r"\s+#\s.*$")
_LINK = re.compile(r"\]\(([^)\s]+)\)")


class PageError(ValueError):
    """A marker that means nothing, or concerns nothing."""


@dataclass(frozen=True)
class Marker:
    """What the checks do otherwise: skip, or append arguments, where a line contains `text`."""

    append: str | None
    text: str
    number: int


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, the number of its first line in the page, its text and its markers."""

    language: str
    number: int
    text: str
    markers: tuple[Marker, ...] = ()

    def commands(self) -> list[tuple[int, str]]:
        """Numbers and texts of the lines to run, as the markers change them; of Python, all of it or nothing.

        Raises:
            PageError: a marker that no line has to do with.
        """
        lines = [(self.number, self.text)] if self.language == "python" else list(self._lines())
        for marker in self.markers:
            concerned = [line for line in lines if marker.text in line[1]]
            if not concerned:
                raise PageError(f"line {marker.number}: no command contains '{marker.text}'")
            if marker.append is None:
                lines = [line for line in lines if line not in concerned]
            else:
                lines = [(n, f"{text} {marker.append}" if (n, text) in concerned else text) for n, text in lines]
        return lines

    def _lines(self) -> Iterator[tuple[int, str]]:
        for number, line in enumerate(self.text.splitlines(), self.number):
            command = _COMMENT.sub("", line).strip()
            if command:
                yield number, command


def blocks_of(page: str) -> list[Block]:
    """All fenced blocks of a page.

    Raises:
        PageError: a marker that cannot be understood or is above no block, or a fence that does not end.
    """
    blocks: list[Block] = []
    markers: list[Marker] = []
    inside: Block | None = None
    for number, line in enumerate(page.splitlines(), 1):
        fence = _FENCE.match(line)
        if inside is not None:
            if line == "```":
                blocks.append(inside)
                inside = None
            else:
                inside = replace(inside, text=f"{inside.text}{line}\n")
        elif fence:
            inside = Block(fence[1], number + 1, "", tuple(markers))
            markers = []
        elif line.startswith("<!-- ci:"):
            markers.append(_marker(line, number))
        elif markers:
            raise PageError(f"line {markers[0].number}: a marker stands right above its block")
    if inside is not None or markers:
        raise PageError("the last block does not end, or a marker has none")
    return blocks


def _marker(line: str, number: int) -> Marker:
    found = _MARKER.fullmatch(line)
    if not found:
        raise PageError(f"line {number}: no marker of the known forms, with a reason: {line}")
    return Marker(found["append"], found["skipped"] or found["to"] or "", number)


def links_of(page: str) -> list[str]:
    """Targets of all links and pictures outside of code."""
    without = re.sub(r"^```.*?^```$", "", page, flags=re.DOTALL | re.MULTILINE)
    return _LINK.findall(re.sub(r"`[^`\n]*`", "", without))


def anchors_of(page: str) -> set[str]:
    """What the headings of a page are called in links to them, as GitHub makes it."""
    without = re.sub(r"^```.*?^```$", "", page, flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#+ (.+)$", without, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
