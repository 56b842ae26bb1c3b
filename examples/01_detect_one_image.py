"""Detect line segments in one image: `python examples/01_detect_one_image.py [IMAGE]`; without IMAGE a rendered one."""

import sys

import cv2

from airline import AirLine
from airline.scenes import RenderedClip

image = cv2.imread(sys.argv[1]) if len(sys.argv) > 1 else RenderedClip(seed=12).render(0).image
if image is None:
    sys.exit(f"cannot read {sys.argv[1]}: give a JPEG or PNG file")
lines = AirLine()(image)
for (start, end), score in zip(lines.segments, lines.scores, strict=True):
    print(f"({start[0]:7.2f}, {start[1]:7.2f}) - ({end[0]:7.2f}, {end[1]:7.2f})  score {score:.2f}")
