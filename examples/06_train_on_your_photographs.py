"""Train the edge network on your photographs: `python examples/06_train_on_your_photographs.py [--steps N] [FOLDER]`.

No labels are needed: LSD makes them, from what it finds again in random views. trial.safetensors is written into the
current folder, and beside it what the training keeps: labels, pictures, a checkpoint from which a run with more steps
goes on. Without FOLDER three rendered images in a temporary folder stand in for photographs. A hundred photographs and
the few steps that are the default show the way and give POOR weights. Good ones take many photographs, rendered scenes
and an hour or more: `python -m airline.train --images FOLDER --scenes 800 --out mine.safetensors`.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import cv2

from airline import AirLine, UNetEdges
from airline.evaluation.dataset import list_images
from airline.evaluation.metrics import pixel_scores
from airline.scenes import RenderedClip
from airline.train import main as train

parser = argparse.ArgumentParser(description="Try the training of the edge network on your photographs.")
parser.add_argument("--steps", type=int, default=20, help="default: %(default)s, far too few for good weights")
parser.add_argument("folder", nargs="?", type=Path, metavar="FOLDER", help="photographs; labels are not needed")
options = parser.parse_args()

photographs, out = options.folder, Path("trial.safetensors")
if photographs is None:
    temporary = Path(tempfile.mkdtemp())
    photographs, out = temporary / "photographs", temporary / out
    photographs.mkdir()
    for seed in range(3):
        view = RenderedClip(kind=("indoor", "street")[seed % 2], seed=seed, size=(320, 240)).render(0)
        cv2.imwrite(str(photographs / f"{seed}.png"), view.image)

trial = ["--model", "fast", "--limit", 100, "--views", 2, "--steps", options.steps]
if code := train([str(word) for word in ["--images", photographs, "--out", out, *trial]]):  # it has said why
    sys.exit(code)

images = (cv2.imread(str(path)) for path in list_images(photographs))
image = next(image for image in images if image is not None)
lines, bundled = AirLine(edges=UNetEdges(out))(image), AirLine("fast")(image)
agreement = pixel_scores(lines.segments, bundled.segments, bundled.segments, image.shape[:2])
print(f"weights after {options.steps} steps: {out}")
print(f"what they have learned, in pictures: {out.with_name('trial-samples')}")
print(f"lines with them in the first photograph: {len(lines)}")
print(f"lines with the bundled weights: {len(bundled)}")
print(f"of the former {agreement.p2:.0f} % are among the latter, of the latter {agreement.r2:.0f} % among the former")
if options.steps < 10_000:
    print(f"{options.steps} steps give poor weights, to try the way and no more; good ones take an hour or more:")
    print(f"python -m airline.train --images {options.folder or 'FOLDER'} --scenes 800 --out mine.safetensors")
