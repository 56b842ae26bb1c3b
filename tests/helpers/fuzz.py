"""Damaged and hostile input for everything that reads files and messages of strangers: `make fuzz`.

Whatever comes in, the only answers are a sound result and an error of this project (`UndecodableError` of messages);
within two seconds, without opening any other file, and with little more memory than before.
"""

from __future__ import annotations

import argparse
import logging
import os
import random
import resource
import sys
import sysconfig
import tempfile
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from airline.errors import AirLineError

LONGEST_S = 2.0
MOST_MB = 200
Target = tuple[list[bytes], Callable[[bytes], object]]

_opened: list[str] | None = None
_NUMBERS = [bytes([value]) * count for value in (0, 1, 0x7F, 0x80, 0xFF) for count in (1, 2, 4, 8)]
_WORDS = [b"/etc/passwd", b"../../x", b"file:///etc/passwd", b"!!python/object/apply:os.system", b"nan", b"1e999"]


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and _opened is not None and isinstance(arguments[0], (str, bytes)):
        _opened.append(os.fsdecode(arguments[0]))


sys.addaudithook(_watch)


def mutated(rng: random.Random, samples: list[bytes]) -> bytes:
    """A sample with some things cut, changed, put in, repeated or taken from another one; sometimes only noise."""
    data = bytearray(rng.choice(samples))
    if rng.random() < 0.02:
        return rng.randbytes(rng.randrange(200))
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        place = rng.randrange(len(data) + 1)
        part = data[place : place + rng.choice((1, 1, 2, 4, 8, 40))]
        other = rng.choice(samples)
        start = rng.randrange(len(other) + 1)
        changed: list[bytes] = [
            bytes(byte ^ 1 << rng.randrange(8) for byte in part[:1]) + part[1:],
            rng.randbytes(len(part)),
            b"",
            part * rng.choice((2, 3, 50)),
            rng.choice(_NUMBERS),
            rng.choice(_WORDS),
            other[start : start + rng.choice((4, 16, 64))],
        ]
        data[place : place + len(part)] = rng.choice(changed)
        if rng.random() < 0.04:
            del data[place:]
    return bytes(data)


def attempt(read: Callable[[bytes], object], data: bytes, mine: Path) -> str | None:
    """What was wrong, None if nothing was."""
    global _opened
    begin_s, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    _opened = []
    try:
        with suppress(AirLineError):
            read(data)
    except Exception as error:
        deepest = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {str(error)[:200]} at {deepest.filename}:{deepest.lineno}"
    finally:
        opened, _opened = _opened, None
    code = (sys.prefix, sys.base_prefix, sysconfig.get_path("stdlib"), str(Path(__file__).parents[2]))
    strangers = [path for path in opened if not path.startswith((str(mine), *code, "/dev/", "/proc/"))]
    if strangers:
        return f"opened {strangers[0]}"
    if time.perf_counter() - begin_s > LONGEST_S:
        return f"took {time.perf_counter() - begin_s:.1f} s"
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    return f"took {grown:.0f} MB" if grown > MOST_MB else None


def fuzz(name: str, target: Target, count: int, seed: int, mine: Path) -> dict[str, bytes]:
    """Try so many inputs; returns the first input for each kind of finding."""
    samples, read = target
    for sample in samples:
        read(sample)  # sound ones are read; and what loads late is loaded
    findings: dict[str, bytes] = {}
    rng = random.Random(f"{name} {seed}")
    for _ in range(count):
        data = mutated(rng, samples)
        wrong = attempt(read, data, mine)
        if wrong is not None:
            findings.setdefault(wrong, data)
    return findings


def main() -> int:
    """Command line: one line per target; exit code 1 for findings, which are written into `--keep`."""
    from tests.helpers.fuzz_targets import all_targets

    parser = argparse.ArgumentParser(prog="python -m tests.helpers.fuzz")
    parser.add_argument("--inputs", type=int, default=10_000, help="per target")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-findings"))
    parser.add_argument("--only", help="one target")
    options = parser.parse_args()
    logging.disable(logging.ERROR)
    found = 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name, target in all_targets(folder).items():
            if options.only not in (None, name):
                continue
            findings = fuzz(name, target, options.inputs, options.seed, folder)
            print(f"{name}: {options.inputs} inputs, {len(findings)} findings", flush=True)
            for number, (wrong, data) in enumerate(findings.items()):
                options.keep.mkdir(exist_ok=True)
                path = options.keep / f"{name}-{number}".replace("/", "_").replace(" ", "_")
                path.write_bytes(data)
                print(f"  {path}: {wrong}", flush=True)
            found += len(findings)
    return min(found, 1)


if __name__ == "__main__":
    sys.exit(main())
