"""How good a network is while it trains: loss and line scores on samples held out, and pictures of a few of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from airline.detector import AirLine
from airline.errors import InputError
from airline.evaluation.metrics import PixelScores, mean, pixel_scores
from airline.image import scale_points
from airline.network.unet import UNet
from airline.stages.edges import UNetEdges
from airline.training.crops import Batch, Crops, draw_labels
from airline.training.dataset import Sample
from airline.training.loop import edge_loss

MAX_PHOTOGRAPHS = 60
TRUSTED = 0.4  # share of views from which on a labelled piece counts as a line
SEED = 12345  # of the crops for the loss
BATCHES = 4  # of them
PANEL = (400, 400)  # px, largest width and height of one picture in a sheet


def split(photographs: list[Sample]) -> tuple[list[Sample], list[Sample]]:
    """Held-out photographs, one in twenty and at most 60, and the others; a single photograph is in both."""
    count = min(MAX_PHOTOGRAPHS, max(1, len(photographs) // 20))
    return photographs[:count], photographs[count:] or photographs


class Validation:
    """Measures networks on the same held-out samples, always in the same way."""

    def __init__(self, photographs: list[Sample], scenes: list[Sample], crops: Crops) -> None:
        """Keep the samples, and make the crops on which the loss is measured, as `crops` makes them."""
        self._kinds = {"photographs": photographs, "scenes": scenes} if scenes else {"photographs": photographs}
        own = {kind: replace(crops, samples=samples, seed=SEED) for kind, samples in self._kinds.items()}
        self._crops = {kind: [each.at(step) for step in range(BATCHES)] for kind, each in own.items()}

    def measure(self, net: UNet, device: torch.device) -> dict[str, tuple[float, PixelScores]]:
        """By kind of sample: mean loss on fixed crops, and scores of the detector's lines against trusted labels."""
        plain = _folded(net, device)
        detector, found = _detector(plain), {}
        for kind, samples in self._kinds.items():
            scores = []
            for sample in samples:
                trusted = sample.pieces[sample.shares >= TRUSTED]
                scores.append(pixel_scores(detector(sample.gray).segments, trusted, trusted, sample.gray.shape))
            found[kind] = _mean_loss(plain, self._crops[kind], device), mean(scores)
        return found

    def write_sheet(self, net: UNet, device: torch.device, path: Path) -> None:
        """A picture of three photographs and a scene (four photographs without scenes); raises InputError."""
        photographs, scenes = self._kinds["photographs"], self._kinds.get("scenes", [])
        few = [*photographs[: 3 if scenes else 4], *scenes[:1]]
        detector = _detector(_folded(net, device))
        if not cv2.imwrite(str(path), np.concatenate([_sheet_row(sample, detector) for sample in few])):
            raise InputError(f"cannot write {path}: make room, or give an --out elsewhere")


@torch.inference_mode()
def _mean_loss(net: UNet, crops: list[Batch], device: torch.device) -> float:
    losses = []
    for batch in crops:
        image, target, weights = (part.to(device) for part in batch)
        losses.append(edge_loss(net(image.contiguous(memory_format=torch.channels_last)), target, weights).item())
    return float(np.mean(losses))


def _sheet_row(sample: Sample, detector: AirLine) -> NDArray[np.uint8]:
    """One row of a sheet, BGR: the image, its labels, the edges found and the lines found."""
    trace, gray = detector.trace(sample.gray), sample.gray
    scale = min(side / length for side, length in zip(PANEL, gray.shape[::-1], strict=True))
    maps = draw_labels(sample.pieces, sample.shares, gray.shape), trace.edges
    pictures = gray, *((255 * each).astype(np.uint8) for each in maps), gray // 2
    *panels, dim = (_panel(picture, scale) for picture in pictures)
    for start, end in np.rint(scale_points(trace.lines.segments, scale) * 16).astype(int).tolist():
        cv2.line(dim, start, end, (80, 220, 255), 1, cv2.LINE_AA, 4)
    return np.concatenate([*panels, dim], axis=1)


def _panel(gray: NDArray[np.uint8], scale: float) -> NDArray[np.uint8]:
    """A grey image at the left of a BGR panel with a rim; all panels are equally wide."""
    width, height = (max(1, round(side * scale)) for side in gray.shape[::-1])
    panel = np.full((height + 4, PANEL[0] + 4, 3), 40, np.uint8)
    panel[:height, :width] = cv2.resize(gray, (width, height), interpolation=cv2.INTER_AREA)[:, :, None]
    return panel


def _folded(net: UNet, device: torch.device) -> UNet:
    training = net.training
    plain: UNet = net.folded().to(device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    net.train(training)  # folding looks at batch normalisation in evaluation mode
    return plain


def _detector(plain: UNet) -> AirLine:
    return AirLine(edges=UNetEdges(plain, "cuda" if plain.head.weight.is_cuda else "torch"))
