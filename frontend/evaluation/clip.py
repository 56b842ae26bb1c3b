"""What the tracker is measured on: frames with the lines that are in them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from frontend.frame import Frame


@dataclass(frozen=True)
class Truth:
    """The lines that can be seen in one frame.

    Attributes:
        segments_px: (N, 2, 2) float32 visible pieces, px.
        ids: (N,) int64 the physical line of each piece, the same over the whole clip; a line may be in pieces.
    """

    segments_px: NDArray[np.float32]
    ids: NDArray[np.int64]


class Clip(Protocol):
    """A short stream with known identities. Iterating twice gives the same frames."""

    @property
    def name(self) -> str:
        """As the command line and the JSON name it."""
        ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[tuple[Frame, Truth]]: ...
