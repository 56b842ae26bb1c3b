"""Lines of dark, noisy frames, LSD beside AirLine: `python examples/03_dark_frames.py [--out PICTURE.png] [IMAGE ...]`.

Every image gets a quarter of its light, with a noise of 8 grey levels added after darkening. Columns: what the camera
delivers, brightened for the eye alone; LSD; LSD after the blur and stretch that help it most; AirLine. Without IMAGE a
rendered room and a rendered street are shown.
"""

import argparse
import sys

import cv2
import numpy as np

from airline import AirLine
from airline.evaluation.benchmark import BAD_LIGHT, lsd
from airline.scenes import RenderedClip
from viz.overlay import draw_lines

parser = argparse.ArgumentParser(description="Draw the lines found in dark frames, LSD beside AirLine.")
parser.add_argument("--out", default="dark_frames.png", help="picture to write (default: %(default)s)")
parser.add_argument("images", nargs="*", metavar="IMAGE")
options = parser.parse_args()

images = [cv2.imread(path, cv2.IMREAD_GRAYSCALE) for path in options.images] or [
    cv2.cvtColor(RenderedClip(kind=kind, seed=12, effects=None).render(frame).image, cv2.COLOR_BGR2GRAY)
    for kind, frame in (("indoor", 60), ("street", 0))
]
detect_lsd, airline, dark = lsd(), AirLine(), BAD_LIGHT["dark"]
rows = []
for image in images:
    if image is None:
        sys.exit("an image cannot be read: give JPEG or PNG files")
    poor = dark.degrade(image, 0)
    bright = cv2.convertScaleAbs(poor, alpha=3)
    found = {
        "LSD": detect_lsd(poor),
        "LSD after blur and stretch": detect_lsd(dark.prepare(poor)),
        "AirLine": airline(poor).segments,
    }
    panels = [cv2.cvtColor(bright, cv2.COLOR_GRAY2BGR)]
    for name, segments in found.items():
        print(f"{name}: {len(segments)} lines")
        panel = cv2.cvtColor(bright // 2, cv2.COLOR_GRAY2BGR)
        draw_lines(panel, segments, np.full((len(segments), 3), (255, 220, 80), np.uint8), 1)
        cv2.putText(panel, name, (8, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1, cv2.LINE_AA)
        panels.append(panel)
    rows.append(cv2.resize(np.hstack(panels), (1600, round(1600 * image.shape[0] / (4 * image.shape[1])))))
if not cv2.imwrite(options.out, np.vstack(rows)):
    sys.exit(f"{options.out} cannot be written: give --out in a folder that exists")
print(f"wrote {options.out}")
