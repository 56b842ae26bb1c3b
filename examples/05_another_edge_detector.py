"""Plug in other edge detectors: `python examples/05_another_edge_detector.py [--dexined FILE] [--out PICTURE] [IMAGE]`.

Beside the default network: Canny, and a torch module of a few lines. `--dexined` adds kornia's DexiNed with weights of
yours, a .safetensors file or a state dict of torch.save; no code in them is run. Any object whose `detect` turns a grey
image into edge probabilities will do, see `airline.EdgeDetector`.
"""

import argparse
import os
import sys

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # else torch's threads spin, and stall on cores that others use

import cv2
import numpy as np
import torch
from safetensors.torch import load_file

from airline import AirLine, CannyEdges, ModuleEdges
from airline.scenes import RenderedClip
from viz.overlay import draw_lines

YELLOW = (255, 220, 80)  # RGB


class SobelMagnitude(torch.nn.Module):
    """Logits of (1, 1, H, W) brightness in [0, 1]: even odds where it changes by 0.03 per pixel."""

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        across = torch.tensor([[-1.0, 0.0, 1.0], [-2.0, 0.0, 2.0], [-1.0, 0.0, 1.0]]) / 8
        kernels = torch.stack([across, across.T])[:, None]
        gradient = torch.nn.functional.conv2d(torch.nn.functional.pad(image, (1, 1, 1, 1), "replicate"), kernels)
        return 100 * (gradient.square().sum(dim=1, keepdim=True).sqrt() - 0.03)


def dexined(weights: str) -> ModuleEdges:
    """kornia's DexiNed, whose input is 0 to 255 less the mean of its training images."""
    from kornia.enhance import Normalize
    from kornia.models.dexined import DexiNed

    net = DexiNed(pretrained=False)
    try:
        state = load_file(weights) if weights.endswith(".safetensors") else torch.load(weights, weights_only=True)
        net.load_state_dict(state)
    except Exception as error:  # a file that is something else can make its reader stumble over anything
        sys.exit(f"{weights} does not hold weights of kornia's DexiNed ({type(error).__name__})")
    mean = torch.tensor([103.939, 116.779, 123.68])
    return ModuleEdges(torch.nn.Sequential(Normalize(mean, torch.ones(3)), net), channels=3, scale=1.0)


parser = argparse.ArgumentParser(description="Lines from the edges of several detectors, side by side.")
parser.add_argument("--dexined", metavar="FILE", help="weights of kornia's DexiNed")
parser.add_argument("--out", default="edge_detectors.png", help="picture to write (default: %(default)s)")
parser.add_argument("image", nargs="?", metavar="IMAGE", help="default: a rendered room")
options = parser.parse_args()

image = cv2.imread(options.image) if options.image else RenderedClip(seed=12).render(60).image
if image is None:
    sys.exit(f"cannot read {options.image}: give a JPEG or PNG file")
detectors = {
    "default": AirLine(),
    "Canny": AirLine(edges=CannyEdges(low=20, high=60)),
    "Sobel": AirLine(edges=ModuleEdges(SobelMagnitude())),
}
if options.dexined:
    detectors["DexiNed"] = AirLine(edges=dexined(options.dexined))

panels = []
for name, detect in detectors.items():
    trace = detect.trace(image)
    print(f"{name}: {len(trace.lines)} lines")
    print(f"{name}: {len(trace.pixels)} edge pixels")
    edges = cv2.cvtColor(np.uint8(255 * trace.edges), cv2.COLOR_GRAY2BGR)
    drawn = image // 2
    draw_lines(drawn, trace.lines.segments, np.full((len(trace.lines), 3), YELLOW, np.uint8), 1)
    cv2.putText(edges, name, (8, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (80, 220, 255), 1, cv2.LINE_AA)
    panels.append(np.vstack([edges, drawn]))
picture = np.hstack(panels)
scale = min(1.0, 1920 / picture.shape[1])
if not cv2.imwrite(options.out, cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)):
    sys.exit(f"{options.out} cannot be written: give --out in a folder that exists")
print(f"wrote {options.out}: edges above, lines below")
