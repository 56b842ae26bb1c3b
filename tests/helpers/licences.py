"""Licences of everything that an installation needs: `python -m tests.helpers.licences` prints a table.

It fails where one is neither permissive nor named here.
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = [extra for extra in PROJECT["optional-dependencies"] if extra not in ("all", "dev")]  # what users install
PERMISSIVE = re.compile(
    r"apache|\bmit\b|bsd|\bisc\b|zlib|\bpsf\b|python-2|python software|unlicense|0bsd|cc0|hpnd|any-osi", re.IGNORECASE
)
COPYLEFT = re.compile(r"\b(?:a|l)?gpl|general public|\bmpl|mozilla|\bepl|eclipse", re.IGNORECASE)
Distributions = dict[str, Distribution]

# Copyleft by file: used as they are, they ask nothing of a program beside them.
ACCEPTED = {
    "certifi": "MPL-2.0, a list of certificates",
    "orjson": "its own code is MPL-2.0 beside Apache-2.0 or MIT",
}


def key_of(name: str) -> str:
    """A distribution's name as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def needed(requirements: list[str], extra: str = "", found: Distributions | None = None) -> Distributions:
    """The distributions that requirements stand for and all that those need, as they are installed here, by name."""
    found = {} if found is None else found
    for requirement in map(Requirement, requirements):
        key = key_of(requirement.name)
        if key in found or (requirement.marker is not None and not requirement.marker.evaluate({"extra": extra})):
            continue
        try:
            found[key] = distribution(requirement.name)
        except PackageNotFoundError:
            raise SystemExit(f"{requirement.name} is not installed: run this where make installs to") from None
        for one in requirement.extras or {""}:
            needed(found[key].requires or [], one, found)
    return found


def licence_of(installed: Distribution) -> str:
    """What a distribution says of its licence, in few words; empty where it says nothing."""
    metadata = installed.metadata
    classifiers = metadata.get_all("Classifier") or []
    names = [text.split(" :: ")[-1] for text in classifiers if re.match("License :: (?!OSI Approved$)", text)]
    stated = (metadata.get("License") or "").strip().splitlines()
    expression = " ".join((metadata.get("License-Expression") or "").split())
    return expression or ", ".join(names) or (stated[0][:60] if stated else "")


def is_fine(key: str, licence: str) -> bool:
    """Whether a licence asks nothing of those who use the package unchanged beyond naming it."""
    return key in ACCEPTED or bool(PERMISSIVE.search(licence) and not COPYLEFT.search(licence))


def rows() -> Iterator[tuple[str, str, str, str]]:
    """Name, version, licence and extra of every distribution, those of the plain installation first."""
    wanted = {"": PROJECT["dependencies"], **{extra: PROJECT["optional-dependencies"][extra] for extra in EXTRAS}}
    seen: set[str] = set()
    for extra, requirements in wanted.items():
        found = needed(requirements)
        for key in sorted(found.keys() - seen - {PROJECT["name"]}):
            yield found[key].metadata["Name"], found[key].version, licence_of(found[key]), extra
        seen |= found.keys()


def main() -> int:
    """Print the table; returns 1 where a licence is neither permissive nor named above."""
    print("| package | version | licence | with |\n|---|---|---|---|")
    bad = []
    for name, version, licence, extra in rows():
        print(f"| {name} | {version} | {licence} | {f'`[{extra}]`' if extra else ''} |")
        if not is_fine(key_of(name), licence):
            bad.append(name)
            print(f"look at {name}: {licence or 'states no licence'}", file=sys.stderr)
    return min(len(bad), 1)


if __name__ == "__main__":
    sys.exit(main())
