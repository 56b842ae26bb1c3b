"""Stage 1: edge detectors, from a grey image to an edge probability map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from airline.config import Runtime
from airline.errors import ConfigError
from airline.image import Gray, to_uint8
from airline.network.runtimes import EdgeNetwork, open_network

if TYPE_CHECKING:
    import torch

    from airline.network.unet import UNet


class EdgeDetector(Protocol):
    """Anything that turns a grey image into edge probabilities."""

    def detect(self, gray: Gray) -> NDArray[np.float32]:
        """(H, W) uint8 or uint16 image to (H, W) float32 edge probability in [0, 1]."""
        ...


class UNetEdges:
    """The learned edge detector: a U-Net; arguments and errors of `airline.network.runtimes.open_network`."""

    def __init__(
        self, weights: str | Path | UNet = "default", runtime: Runtime = "auto", threads: int | None = None
    ) -> None:
        self.network: EdgeNetwork = open_network(weights, runtime, threads)

    def detect(self, gray: Gray) -> NDArray[np.float32]:
        """Edge probability; the image is normalised to zero mean and unit variance, so its range does not matter."""
        return self.network(gray)


class CannyEdges:
    """OpenCV's Canny (1986): edges of 0 or 1, and no learning.

    Args:
        low, high: hysteresis thresholds of the gradient.
        sigma: of the Gaussian blur before it, px; 0 for none.
    """

    def __init__(self, low: float = 50.0, high: float = 150.0, sigma: float = 1.0) -> None:
        if not 0 <= low <= high or sigma < 0:
            raise ConfigError("Canny needs 0 <= low <= high and sigma >= 0")
        self.low, self.high, self.sigma = low, high, sigma

    def detect(self, gray: Gray) -> NDArray[np.float32]:
        """See `EdgeDetector.detect`."""
        image = to_uint8(gray)
        if self.sigma > 0:
            image = cv2.GaussianBlur(image, (0, 0), self.sigma)
        edges: NDArray[np.uint8] = cv2.Canny(image, self.low, self.high, L2gradient=True)
        return edges.astype(np.float32) / np.float32(255)


class ModuleEdges:
    """Any torch module that maps an image to edge logits, for example kornia's DexiNed with the user's weights.

    Args:
        module: maps (1, channels, H, W) float to logits (1, 1, H, W), or to a list of such whose last counts.
        channels: 1, or 3 for networks that want colour; the grey image is repeated.
        scale: factor from grey levels to what the module expects.
    """

    def __init__(self, module: torch.nn.Module, channels: int = 1, scale: float = 1 / 255) -> None:
        self._module = module.eval()
        self._channels, self._scale = channels, scale

    def detect(self, gray: Gray) -> NDArray[np.float32]:
        """Sigmoid of the module's logits."""
        import torch

        parameter = next(self._module.parameters(), torch.zeros(()))
        with torch.inference_mode():
            image = torch.from_numpy(to_uint8(gray).astype(np.float32) * np.float32(self._scale)).to(parameter.device)
            logits = self._module(image.expand(1, self._channels, *gray.shape))
            if isinstance(logits, (list, tuple)):
                logits = logits[-1]
            if tuple(logits.shape) != (1, 1, *gray.shape):
                raise ConfigError(f"edge module answers {tuple(logits.shape)}: it must answer (1, 1, H, W) logits")
            edges: NDArray[np.float32] = torch.sigmoid(logits[0, 0].float()).contiguous().cpu().numpy()
        return edges
