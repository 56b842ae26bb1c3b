"""Bundled weights of the edge network, and loading of weights files.

A weights file is a safetensors file whose header holds the network's shape (`UNetSpec`). Files that come with the
package are checked against the SHA-256 recorded here.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from airline.errors import WeightsError
from airline.network.spec import UNetSpec

if TYPE_CHECKING:
    from airline.network.unet import UNet

Ranges = dict[str, tuple[float, float]]
End = Annotated[float, msgspec.Meta(gt=-1e6, lt=1e6)]

BUNDLED = {
    "accurate": "c96a8cfd4795c610e73e560a0c2f9987d5e8aceb798ef3fc7a3b4094b94e4323",
    "default": "e8dcfbd2abbe581142ba5837ef6c31dc7c23f97f07881049d30abb7db22a4f9d",
    "fast": "16068ff7548ec7518ca91fd0530e72ea7db88755dda636f55b5976e1e6af4bda",
}


def bundled_path(name: str) -> Path:
    """Path of bundled weights; WeightsError where there are none of this name."""
    if name not in BUNDLED:
        raise WeightsError(f"no bundled weights named '{name}': there are {', '.join(sorted(BUNDLED))}")
    return Path(__file__).with_name(f"{name}.safetensors")


def sha256_of(weights: str | Path) -> str:
    """SHA-256 of a weights file, or of bundled ones; WeightsError where it cannot be read."""
    path = _path_of(weights)
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise WeightsError(f"cannot read the weights file {path} ({error.strerror})") from None


def load_weights(weights: str | Path) -> tuple[UNetSpec, dict[str, NDArray[np.float32]]]:
    """The edge network's shape, and its float32 tensors by the names of `UNetSpec.shapes`, without torch.

    Raises WeightsError where `weights`, a name of bundled ones or the path of a safetensors file, is missing, damaged,
    or not made for this network.
    """
    path, metadata, tensors = _read(weights)
    with _fitting(path):
        spec = UNetSpec.from_metadata(metadata)
        expected = spec.shapes()
        if tensors.keys() != expected.keys():
            raise ValueError(f"its tensors differ: {', '.join(sorted(tensors.keys() ^ expected.keys())[:3])}")
        for name, tensor in tensors.items():
            if tensor.shape != expected[name]:
                raise ValueError(f"{name} has the shape {tensor.shape} and not {expected[name]}")
            if tensor.dtype.kind != "f" or not np.isfinite(tensor).all():
                raise ValueError("it holds values that are not finite numbers")
    return spec, {name: tensor.astype(np.float32, copy=False) for name, tensor in tensors.items()}


def load_ranges(weights: str | Path) -> Ranges:
    """Least and largest input of each convolution but the first, by its name; empty for a file without them."""
    path, metadata, tensors = _read(weights)
    convs = {name.removesuffix(".weight") for name in tensors if name.endswith(".weight")} - {"down.0.0"}
    with _fitting(path):
        ranges = msgspec.json.decode(metadata.get("ranges", "{}"), type=dict[str, tuple[End, End]])
        if ranges and ranges.keys() != convs:
            raise ValueError("its ranges are not those of its convolutions")
        if any(low > high for low, high in ranges.values()):
            raise ValueError("its ranges are no ranges of numbers")
    return ranges


def _read(weights: str | Path) -> tuple[Path, dict[str, str], dict[str, NDArray[Any]]]:
    from safetensors import SafetensorError, safe_open

    path = _path_of(weights)
    if str(weights) in BUNDLED and sha256_of(weights) != BUNDLED[str(weights)]:
        raise WeightsError(f"the bundled weights {path.name} are damaged (wrong SHA-256): reinstall the package")
    try:
        with safe_open(path, framework="numpy") as stored:
            metadata = stored.metadata() or {}
            return path, metadata, {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError, TypeError) as error:
        raise WeightsError(
            f"{path} is not a readable safetensors file ({error}): give a file of airline.train"
        ) from None


def _path_of(weights: str | Path) -> Path:
    path = bundled_path(str(weights)) if str(weights) in BUNDLED else Path(weights)
    if not path.is_file():
        raise WeightsError(f"no weights file {path}: give a .safetensors file or one of {', '.join(sorted(BUNDLED))}")
    return path


@contextmanager
def _fitting(path: Path) -> Iterator[None]:
    try:
        yield
    except (KeyError, ValueError, RecursionError, msgspec.MsgspecError) as error:
        why = " ".join(str(error).split())[:200]
        raise WeightsError(
            f"{path} does not hold weights of this edge network ({why}): train with airline.train"
        ) from None


def load_unet(weights: str | Path) -> UNet:
    """The edge network with its weights, ready for inference on the CPU; arguments and errors of `load_weights`."""
    import torch

    from airline.network.unet import UNet

    spec, tensors = load_weights(weights)
    with torch.device("meta"):
        net = UNet(spec)
    net.load_state_dict({key: torch.from_numpy(value) for key, value in tensors.items()}, strict=True, assign=True)
    return net.eval()


def save_unet(net: UNet, path: Path, ranges: Ranges | None = None, **notes: str) -> str:
    """Write a network (batch normalisation folded) and notes about its training; returns the file's SHA-256.

    With `ranges` (see `airline.network.unet.measure_ranges`) it can run in 8-bit numbers.
    """
    from safetensors.torch import save

    tensors = {key: value.detach().cpu().contiguous() for key, value in net.folded().state_dict().items()}
    if ranges:
        notes["ranges"] = json.dumps({name: [round(end, 4) for end in ranges[name]] for name in sorted(ranges)})
    data = _in_order(save(tensors, metadata={**notes, **net.spec.to_metadata()}))
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(data)
    partial.replace(path)
    return hashlib.sha256(data).hexdigest()


def _in_order(data: bytes) -> bytes:
    """The same safetensors file with a sorted header: the library's order changes from run to run, and so would the
    SHA-256 of equal weights.
    """
    end = 8 + int.from_bytes(data[:8], "little")
    header = json.dumps(json.loads(data[8:end]), sort_keys=True, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header + data[end:]
