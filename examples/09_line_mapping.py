"""Lines in space from tracks and known poses: `python examples/09_line_mapping.py [--frames N] [--save FILE.rrd]`.

The frames of the built-in clip come with their poses, as those of a calibrated rig or of another odometry would. Each
track is triangulated; those that are known to half a percent of their distance make the map.
"""

import argparse
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices this small are done before a second thread wakes

import numpy as np

from airline.scenes import RenderedClip
from line_odometry.clips import OURS, rendered
from line_odometry.score import mapped
from line_odometry.show import show
from line_odometry.triangulation import map_lines
from line_odometry.views import View

parser = argparse.ArgumentParser(description="Reconstruct lines in space from tracks and known poses.")
parser.add_argument("--frames", type=int, default=200, metavar="N", help="of the built-in clip (default: %(default)s)")
parser.add_argument("--save", type=Path, metavar="FILE.rrd", help="record the lines for the Rerun viewer")
options = parser.parse_args()

seen = rendered(RenderedClip(kind="indoor", motion="handheld", seed=12, frames=options.frames), [OURS])
ids, segments = map_lines([View.of(tracks).lines for tracks in seen.tracks[OURS]], seen.poses, seen.focal)
lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
print(f"{len(segments)} lines, {lengths.sum():.1f} m, from {len(seen.poses)} frames; the longest are")
for row in np.argsort(-lengths)[:5]:
    start, end = np.round(segments[row], 2).tolist()
    print(f"  track {ids[row]}: {start} to {end}, {lengths[row]:.2f} m")
assert seen.lines is not None
print("tolerance, % of the depth   of the visible length mapped, %   of the map true, %")
for tolerance in (0.0025, 0.005, 0.01, 0.02):
    length, precision = mapped(segments, seen.lines, tolerance)
    print(f"{100 * tolerance:25.2f} {length:34.1f} {precision:20.1f}")
if options.save is not None:
    show(options.save, seen, segments)
    print(f"saved {options.save}; look at it with: rerun {options.save}")
