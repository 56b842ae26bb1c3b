"""The path of the camera from tracked lines: `python examples/10_line_odometry.py [--stereo] [--clip DIR]`.

Lines are tracked, `frontend.start` begins (flow points help it), every further pose comes from the map, and the newest
keyframes and their lines are smoothed in GTSAM (`line_odometry/`, read `odometry.py` first). Nothing is given but the
camera: the true poses are for the score, and for the map of lines beside it. --clip DIR takes a folder with images,
calib.txt and poses.txt, as KITTI's sequences are handed around. With --stereo, a second camera to the right, the path
begins at the first frame and is in metres: it is compared as it is, while that of one camera gets the true one's scale.
"""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices this small are done before a second thread wakes

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from airline.command import write_json
from airline.errors import AirLineError
from airline.scenes import RenderedClip

try:
    from line_odometry.clips import FUSED, LSD, OURS, TRUE_LINES, Seen, posed, rendered
    from line_odometry.odometry import LineOdometry
    from line_odometry.score import align, mapped
    from line_odometry.show import show
    from line_odometry.triangulation import map_lines
    from line_odometry.views import View
except ImportError as error:
    sys.exit(f"error: {error}: pip install 'airline-frontend[odometry]' evo")

COLUMNS = {
    "ate_percent": "path, %",
    "scale_percent": "scale, %",
    "rotation_deg": "rot., °",
    "lost_frames": "no pose",
    "maps": "maps",
    "mapped_length_percent": "mapped, %",
    "mapped_precision_percent": "map true, %",
    "frames_per_second": "frames/s",
}
SEED_FRAMES = 90

Figures = dict[str, float | None]


def run(seen: Seen, name: str, points: bool, save: Path | None = None) -> Figures:
    """Odometry and mapping from what one frontend saw; its figures, None where there is nothing to compare with."""
    started = time.perf_counter()
    odometry = LineOdometry(seen.focal, points=points)
    for tracks in seen.tracks[name]:
        odometry.add(tracks)
    poses = odometry.trajectory()
    figures: Figures = dict.fromkeys(COLUMNS)
    figures["frames_per_second"] = len(seen.poses) / (time.perf_counter() - started)
    figures["lost_frames"] = float(len(seen.poses) - len(poses) + len(odometry.lost))
    figures["maps"] = float(len(odometry.begun))
    views = [View.of(tracks).lines for tracks in seen.tracks[name]]
    if len(poses):
        true, metric = seen.poses[odometry.first :], odometry.baseline_m > 0
        path = align(poses, true, metres=metric)
        figures.update(ate_percent=path.ate_percent, rotation_deg=path.rotation_deg)
        if metric:
            figures["scale_percent"] = 100 / align(poses, true).scale - 100
        if save is not None:
            show(save, seen, map_lines(views[odometry.first :], poses, seen.focal)[1], path)
    else:
        print(f"{name}: no path, for {odometry.waits}")
    if odometry.failed:
        print(f"{name}: the graph began anew at the frames {odometry.failed}, which GTSAM could not solve for")
    if seen.lines is not None:
        length, precision = mapped(map_lines(views, seen.poses, seen.focal)[1], seen.lines)
        figures.update(mapped_length_percent=length, mapped_precision_percent=precision)
    return figures


def many(first: int, last: int, names: list[str], points: bool, max_lines: int, stereo: bool) -> dict[str, Figures]:
    """The same of rendered streets and rooms of the seeds: how many begin, and how well they go on."""
    results: dict[str, Figures] = {}
    for kind in ("street", "indoor"):
        rows: dict[str, list[Figures]] = {name: [] for name in names}
        for seed in range(first, last):
            clip = RenderedClip(kind=kind, motion="handheld", seed=seed, frames=SEED_FRAMES)
            seen = rendered(clip, names, max_lines, stereo=stereo)
            for name in names:
                rows[name].append(run(seen, name, points))
                print(kind, seed, name, {key: value for key, value in rows[name][-1].items() if value is not None})
        for name, figures in rows.items():
            errors = [row["ate_percent"] for row in figures if row["ate_percent"] is not None]
            results[f"{kind}, {name}"] = {
                "begun": float(len(errors)),
                "of": float(len(figures)),
                "median ATE, %": float(np.median(errors)) if errors else None,
                "worst ATE, %": max(errors, default=None),
                "frames without a pose": float(np.median([row["lost_frames"] or 0.0 for row in figures])),
            }
    return results


def part(text: str) -> slice:
    """A range of frames as Python writes it."""
    return slice(*(int(number) if number else None for number in text.split(":")))


parser = argparse.ArgumentParser(description="Estimate the camera's path from tracked lines.")
parser.add_argument(
    "--clip", type=Path, metavar="DIR", help="images/, calib.txt, poses.txt (default: the built-in clip)"
)
parser.add_argument("--stereo", action="store_true", help="with the right camera (of --clip: images_right/)")
parser.add_argument("--frames", type=int, metavar="N", help="use the first N frames (200 of the built-in clip)")
parser.add_argument("--slice", type=part, metavar="A:B:C", help="frames of --clip: 0:26 the first half, ::-1 backwards")
parser.add_argument("--max-lines", type=int, default=0, metavar="N", help="of ours in each frame, the best (0: all)")
parser.add_argument("--points", action="store_true", help="map the flow points, too: for few lines")
parser.add_argument("--baselines", action="store_true", help="also LSD with nearest neighbour, and true lines")
parser.add_argument("--fused", action="store_true", help="also with lines fused over the frames")
parser.add_argument("--seeds", type=int, nargs=2, metavar=("A", "B"), help="rendered clips of the seeds A to B - 1")
parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
parser.add_argument("--save", type=Path, metavar="FILE.rrd", help="record path and lines for the Rerun viewer")
options = parser.parse_args()
names = [OURS, *([FUSED] if options.fused else []), *([LSD] if options.baselines else [])]
try:
    if options.seeds is not None:
        results = many(*options.seeds, names, options.points, options.max_lines, options.stereo)
    else:
        if options.clip is not None:
            part_of = options.slice or slice(options.frames)
            seen = posed(options.clip, part_of, names, options.max_lines, stereo=options.stereo)
        else:
            clip = RenderedClip(kind="indoor", motion="handheld", seed=12, frames=options.frames or 200)
            names += [TRUE_LINES] if options.baselines else []
            seen = rendered(clip, names, options.max_lines, stereo=options.stereo)
        results = {n: run(seen, n, options.points, options.save if n == OURS else None) for n in seen.tracks}
    write_json(options.json, results)
except AirLineError as error:
    sys.exit(f"error: {error}")
columns = list(next(iter(results.values())))
table = Table("", *(COLUMNS.get(key, key) for key in columns), box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
for name, figures in results.items():
    table.add_row(
        name, *("-" if figures[key] is None else f"{figures[key]:.3f}".rstrip("0").rstrip(".") for key in columns)
    )
Console().print(table)
if options.save is not None:
    print(f"saved {options.save}; look at it with: rerun {options.save}")
