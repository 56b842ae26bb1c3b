"""The detector's stages on one image, as a picture: `python -m viz.stage_picture IMAGE --out stages.jpg`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np

from airline.command import Parser, exit_code
from airline.config import PRESETS
from airline.detector import AirLine
from airline.errors import InputError
from airline.image import to_gray, to_uint8
from airline.trace import Trace
from frontend.colours import track_colours
from viz.overlay import Picture, draw_lines, write_picture
from viz.stages import edge_image, orientation_image, region_image

WIDTH = 480  # px of each panel
STRIP = 22  # px of its title


def stage_picture(gray: Picture, trace: Trace) -> Picture:
    """Grey image, edges, orientations, regions, segments and scores beside each other, BGR."""
    lines = trace.lines
    colours = track_colours(np.arange(len(lines)))
    regions = np.concatenate([np.zeros((1, 3), np.uint8), colours])
    by_score = cv2.applyColorMap(np.rint(255 * lines.scores).astype(np.uint8), cv2.COLORMAP_VIRIDIS).reshape(-1, 3)
    panels = {
        "image": gray,
        "edges: probability": edge_image(trace),
        "orientation: hue is the angle": orientation_image(trace)[:, :, ::-1],
        f"grow: pixels behind {len(lines)} lines": regions[
            region_image(trace, np.arange(1, len(regions), dtype=np.uint16))
        ][:, :, ::-1],
        "fit, refine: segments": _with_lines(gray, trace, colours),
        "scores: blue 0, yellow 1": _with_lines(gray, trace, by_score[:, ::-1]),
    }
    titled = [_panel(title, np.ascontiguousarray(picture)) for title, picture in panels.items()]
    return np.vstack([np.hstack(titled[:3]), np.hstack(titled[3:])])


def _with_lines(gray: Picture, trace: Trace, rgb: Picture) -> Picture:
    canvas = np.repeat((gray // 2)[:, :, None], 3, axis=2)
    draw_lines(canvas, trace.lines.segments, rgb, 2)
    return canvas


def _panel(title: str, picture: Picture) -> Picture:
    height = max(1, round(picture.shape[0] * WIDTH / picture.shape[1]))
    how = cv2.INTER_AREA if picture.shape[1] > WIDTH else cv2.INTER_NEAREST
    resized = np.asarray(cv2.resize(picture, (WIDTH, height), interpolation=how), np.uint8)
    if resized.ndim == 2:
        resized = np.repeat(resized[:, :, None], 3, axis=2)
    head = np.full((STRIP, WIDTH, 3), 255, np.uint8)
    cv2.putText(head, title, (6, STRIP - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([head, resized])


def read_image(path: Path | None) -> Picture:
    """A grey image from a file, or a frame of the built-in clip; InputError where it cannot be read."""
    if path is None:
        from airline.scenes import RenderedClip

        return to_uint8(to_gray(RenderedClip(kind="indoor", motion="handheld", seed=12).render(60).image))
    data = np.fromfile(path, np.uint8) if path.is_file() else np.zeros(0, np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    if image is None:
        raise InputError(f"cannot read {path}: give an image file")
    return np.asarray(image, np.uint8)


def run(options: argparse.Namespace) -> None:
    """Detect, draw, write; raises AirLineError."""
    gray = read_image(options.image)
    write_picture(options.out, stage_picture(gray, AirLine(options.preset).trace(gray)))


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = Parser(prog="python -m viz.stage_picture", description="The detector's stages on one image.")
    parser.add_argument("image", type=Path, nargs="?", help="image file (default: a frame of the built-in clip)")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help=".jpg or .png to write")
    parser.add_argument("--preset", choices=PRESETS, default="default")
    return exit_code(run, parser.parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
