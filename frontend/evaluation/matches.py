"""Pairs of lines of two images against labelled associations and known homographies, beside nearest neighbours."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airline.errors import InputError
from airline.evaluation.benchmark import lsd
from airline.evaluation.metrics import MIN_OVERLAP, measure_pairs, warp
from airline.image import to_gray, to_uint8
from airline.lines import LineSet
from airline.scenes import RenderedClip
from frontend.evaluation.baselines import nearest_pairs
from frontend.evaluation.icl import LabelledClip, read_numbers
from frontend.evaluation.moved import airline
from frontend.evaluation.truth import Truth, owners
from frontend.matching import LineMatches, match_lines
from frontend.sources.reading import Image
from frontend.sources.stills import read_image
from frontend.tracking.assignment import assign

GAPS = (1, 2, 3, 5)  # frames between the two of a pair
KINDS, SEEDS, APART = ("indoor", "street", "shelves"), (201, 202, 203), (1, 15, 40, 80)  # of rendered ones
RADII = (3, 5)  # px
MIN_COSINE = float(np.cos(np.deg2rad(10.0)))
# How far a nearest neighbour may lie away, px, and where it was moved: best on rendered views of other seeds
NEAR, NEARER = 15.0, 5.0

Pairs = NDArray[np.int32]
Counts = Callable[[NDArray[np.float32], NDArray[np.float32], Pairs], dict[str, NDArray[np.int64]]]
Figures = dict[str, dict[str, dict[str, Any]]]


def match_figures(folder: Path | None) -> Figures:
    """Precision, recall and F of every matcher on every group of pairs of a folder's images.

    Args:
        folder: labelled frames, see `LabelledClip`, whose groups are pairs so many frames apart; or `1.png` to `N.png`
            with `H_1_2` to `H_1_N`, homographies in text files, whose groups are pairs of the first image with another;
            None for rendered views, whose groups are as those of labelled frames.

    Raises:
        InputError: it is neither, or a file is malformed.
    """
    tallies: dict[str, dict[str, list[dict[str, Any]]]] = defaultdict(lambda: defaultdict(list))
    views = folder is not None and (folder / "1.png").is_file()
    pairs_of = _rendered() if folder is None else _views(folder) if views else _labelled(folder)
    for group, first, second, count in pairs_of:
        for name, lines, matches, pairs, ms in _matched(first, second):
            found = count(matches.first.segments, matches.second.segments, pairs)
            tallies[group][name].append({**found, "lines": lines, "pairs": len(pairs), "ms": ms})
    return {group: {name: _figures(rows) for name, rows in by_name.items()} for group, by_name in tallies.items()}


def _labelled(folder: Path) -> Iterator[tuple[str, Image, Image, Counts]]:
    frames = list(LabelledClip(folder))
    for (a, (one, truth)), (b, (other, later)) in combinations(enumerate(frames), 2):
        if b - a in GAPS:
            yield f"{folder.resolve().name}, {b - a} apart", one.image, other.image, partial(_same_line, truth, later)


def _rendered() -> Iterator[tuple[str, Image, Image, Counts]]:
    for kind, seed in product(KINDS, SEEDS):
        clip = RenderedClip(kind, "handheld", seed, min_contrast=1.0, merge_doubles=False)
        one, *others = (clip.render(i) for i in (0, *APART))
        for apart, other in zip(APART, others, strict=True):
            truth, later = (Truth(view.segments_px, view.ids) for view in (one, other))
            yield f"{kind}, {apart} apart", one.image, other.image, partial(_same_line, truth, later)


def _views(folder: Path) -> Iterator[tuple[str, Image, Image, Counts]]:
    homographies = sorted(folder.glob("H_1_*"))
    if not homographies:
        raise InputError(f"no H_1_2 beside '{folder / '1.png'}': give the homographies to the other images")
    for path in homographies:
        number = path.name.removeprefix("H_1_")
        count = partial(_same_place, read_numbers(path, 3, None))
        name = f"{folder.resolve().name} 1-{number}"
        yield name, read_image(folder / "1.png"), read_image(folder / f"{number}.png"), count


def _same_line(
    truth: Truth, later: Truth, first: NDArray[np.float32], second: NDArray[np.float32], pairs: Pairs
) -> dict[str, NDArray[np.int64]]:
    """Right pairs, pairs of lines that are known, true lines found, and those that could be."""
    one, other = owners(first, truth), owners(second, later)
    a, b = one[pairs[:, 0]], other[pairs[:, 1]]
    known = (a >= 0) & (b >= 0)
    right = known & (a == b)
    both = np.intersect1d(one[one >= 0], other)
    return {"": np.array([right.sum(), known.sum(), len(np.unique(a[right])), len(both)])}


def _same_place(
    homography: NDArray[np.float64], first: NDArray[np.float32], second: NDArray[np.float32], pairs: Pairs
) -> dict[str, NDArray[np.int64]]:
    """The same by how near the lines are, for each of `RADII`."""
    distance, overlap, cosine = measure_pairs(warp(first, homography), second)
    counts = {}
    for radius in RADII:
        same = (distance <= radius) & (overlap >= MIN_OVERLAP) & (cosine >= MIN_COSINE)
        right, possible = int(same[tuple(pairs.T)].sum()), int((assign(same.astype(np.float32), 0.5) >= 0).sum())
        counts[f"_{radius}px"] = np.array([right, len(pairs), right, possible])
    return counts


def _matched(first: Image, second: Image) -> Iterator[tuple[str, int, LineMatches, Pairs, float | None]]:
    """Every matcher's name, lines of the first image, matches whose lines are meant, pairs and milliseconds."""
    detectors: dict[str, Callable[[ArrayLike], LineSet]] = {"": airline(), "LSD, ": _lsd}
    for kind, detector in detectors.items():
        started = time.perf_counter()
        matches = match_lines(first, second, detector=detector)
        ms = 1e3 * (time.perf_counter() - started)
        lines, others = matches.first.segments, matches.second.segments
        yield f"{kind}votes", len(lines), matches, matches.pairs, ms
        moved = warp(lines, matches.homography).astype(np.float32)
        for name, where, reach in ((f"{kind}nearest", lines, NEAR), (f"{kind}moved, nearest", moved, NEARER)):
            yield name, len(lines), matches, np.column_stack(nearest_pairs(where, others, reach)).astype(np.int32), None


def _figures(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Of all pairs of a group together; None for measures that it has not."""
    figures: dict[str, Any] = {"lines": float(np.mean([row["lines"] for row in rows]))}
    figures["pairs"] = sum(row["pairs"] for row in rows)
    figures["ms"] = None if rows[0]["ms"] is None else float(np.median([row["ms"] for row in rows]))
    for key in ("", *(f"_{radius}px" for radius in RADII)):
        scores: list[float | None] = [None] * 3
        if key in rows[0]:
            right, known, found, possible = np.sum([row[key] for row in rows], axis=0).tolist()
            precision, recall = right / max(known, 1), found / max(possible, 1)
            scores = [precision, recall, 2 * precision * recall / max(precision + recall, 1e-9)]
        figures |= dict(zip((f"precision{key}", f"recall{key}", f"f{key}"), scores, strict=True))
    return figures


def _lsd(image: ArrayLike) -> LineSet:
    """OpenCV's lines; without scores, and with descriptors that all agree."""
    segments = lsd()(to_uint8(to_gray(image))).astype(np.float32)
    ones = np.ones(len(segments), np.float32)
    return LineSet(segments, ones, ones[:, None])
