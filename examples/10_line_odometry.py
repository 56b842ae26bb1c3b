"""The path of the camera from lines alone: `python examples/10_line_odometry.py [--baselines] [--clip DIR]`.

Lines are tracked, the map begins with two views, every further pose comes from the map, and the last keyframes are
adjusted together (`line_odometry/`, read `odometry.py` first). Nothing is given but the camera: the true poses are for
the score, and for the map of lines beside it. --clip DIR takes a folder with images, calib.txt and poses.txt, as
KITTI's sequences are handed around.
"""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices this small are done before a second thread wakes

from rich.console import Console
from rich.table import Table

from airline.command import write_json
from airline.errors import AirLineError
from line_odometry.clips import FUSED, LSD, OURS, TRUE_LINES, Seen, built_in, posed
from line_odometry.odometry import LineOdometry
from line_odometry.score import align, mapped
from line_odometry.show import show
from line_odometry.triangulation import map_lines

COLUMNS = {
    "ate_percent": "path error, % of its length",
    "rotation_deg": "rotation error, degrees",
    "lost_frames": "frames without a pose",
    "mapped_length_percent": "true length mapped, %",
    "mapped_precision_percent": "map that is true, %",
    "frames_per_second": "frames/s",
}


def run(seen: Seen, name: str, save: Path | None = None) -> dict[str, float | None]:
    """Odometry and mapping from what one frontend saw; its figures, None where there is nothing to compare with."""
    started = time.perf_counter()
    odometry = LineOdometry(seen.focal)
    for view in seen.views[name]:
        odometry.add(view)
    poses = odometry.trajectory()
    figures: dict[str, float | None] = dict.fromkeys(COLUMNS)
    figures["frames_per_second"] = len(seen.poses) / (time.perf_counter() - started)
    figures["lost_frames"] = float(len(seen.poses) - len(poses) + len(odometry.lost))
    if len(poses) == len(seen.poses):
        path = align(poses, seen.poses)
        figures.update(ate_percent=path.ate_percent, rotation_deg=path.rotation_deg)
        if save is not None:
            show(save, seen, map_lines(seen.views[name], poses, seen.focal)[1], path)
    if seen.lines is not None:
        _, segments = map_lines(seen.views[name], seen.poses, seen.focal)
        length, precision = mapped(segments, seen.lines)
        figures.update(mapped_length_percent=length, mapped_precision_percent=precision)
    return figures


parser = argparse.ArgumentParser(description="Estimate the camera's path from tracked lines.")
parser.add_argument(
    "--clip", type=Path, metavar="DIR", help="images/, calib.txt, poses.txt (default: the built-in clip)"
)
parser.add_argument("--frames", type=int, metavar="N", help="use the first N frames (200 of the built-in clip)")
parser.add_argument("--baselines", action="store_true", help="also LSD with nearest neighbour, and true lines")
parser.add_argument("--fused", action="store_true", help="also with lines fused over the frames")
parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
parser.add_argument("--save", type=Path, metavar="FILE.rrd", help="record path and lines for the Rerun viewer")
options = parser.parse_args()
baselines, ours = options.baselines, [OURS, FUSED] if options.fused else [OURS]
try:
    if options.clip is not None:
        clip = posed(options.clip, options.frames, [*ours, LSD] if baselines else ours)
    else:
        clip = built_in(options.frames or 200, [*ours, TRUE_LINES, LSD] if baselines else ours)
    results = {name: run(clip, name, options.save if name == OURS else None) for name in clip.views}
    write_json(options.json, results)
except AirLineError as error:
    sys.exit(f"error: {error}")
table = Table("", *COLUMNS.values())
for name, figures in results.items():
    table.add_row(
        name, *("-" if figures[key] is None else f"{figures[key]:.3f}".rstrip("0").rstrip(".") for key in COLUMNS)
    )
Console().print(table)
if options.save is not None:
    print(f"saved {options.save}; look at it with: rerun {options.save}")
