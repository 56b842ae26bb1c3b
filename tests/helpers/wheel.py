"""What is in the wheel and the source archive: `python tests/helpers/wheel.py DIST`. Needs nothing but Python."""

from __future__ import annotations

import sys
import tarfile
import zipfile
from pathlib import Path, PurePosixPath

PACKAGES = ("airline", "frontend", "logs", "viz")
WEIGHTS = tuple(f"airline/network/weights/{name}.safetensors" for name in ("accurate", "default", "fast"))
CLIP = "frontend/sources/clip/corridor.mp4"
LARGEST_WHEEL = 3_200_000  # bytes, of which the weights are 1.4 million and the clip is 1.1
LARGEST_OTHER = 60_000  # bytes of any other file
LARGEST_SOURCES = 5_000_000  # with the pictures of the documentation


def faults_of_wheel(path: Path) -> list[str]:
    """What is wrong with a wheel, one sentence each."""
    with zipfile.ZipFile(path) as wheel:
        sizes = {info.filename: info.file_size for info in wheel.infolist()}
    expected = [*WEIGHTS, CLIP, *(f"{package}/py.typed" for package in PACKAGES)]
    faults = [f"{name} is missing" for name in expected if name not in sizes]
    for name, size in sizes.items():
        top = PurePosixPath(name).parts[0]
        if top not in PACKAGES and not top.endswith(".dist-info"):
            faults.append(f"{name} does not belong there")
        if size > LARGEST_OTHER and name not in (*WEIGHTS, CLIP):
            faults.append(f"{name} has {size} bytes")
    if not any(name.endswith(".dist-info/licenses/LICENSE") for name in sizes):
        faults.append("the licence is missing")
    if path.stat().st_size > LARGEST_WHEEL:
        faults.append(f"it has {path.stat().st_size} bytes")
    return faults


def faults_of_sources(path: Path) -> list[str]:
    """What is wrong with a source archive, one sentence each."""
    with tarfile.open(path) as archive:
        names = {str(PurePosixPath(*PurePosixPath(name).parts[1:])) for name in archive.getnames()}
    wanted = ("README.md", "LICENSE", "CHANGELOG.md", "Makefile", "constraints.txt", "tests/conftest.py", *WEIGHTS)
    faults = [f"{name} is missing" for name in wanted if name not in names]
    if path.stat().st_size > LARGEST_SOURCES:
        faults.append(f"it has {path.stat().st_size} bytes")
    return faults


def main() -> int:
    """Check the one wheel and the one source archive of a folder; returns 1 where something is wrong."""
    (made,), (sources,) = (list(Path(sys.argv[1]).glob(kind)) for kind in ("*.whl", "*.tar.gz"))
    faults = {made: faults_of_wheel(made), sources: faults_of_sources(sources)}
    for path, found in faults.items():
        print(f"{path.name}: {path.stat().st_size} bytes", *found, sep="\n  ")
    return int(any(faults.values()))


if __name__ == "__main__":
    sys.exit(main())
