"""The last step of the edge network."""

from __future__ import annotations

from typing import Any

import numpy as np

from airline.kernels.compiled import njit

HALF = np.float32(0.5)
# Lambert's continued fraction of tanh(t), nine terms: t * (A0 + A1 s + ...) / (A0 + B1 s + ...) with s = t * t; cut off
# where it reaches 1, it is 6e-6 off at most
A0, A1, A2, A3 = (np.float32(value) for value in (34459425, 4729725, 135135, 990))
B1, B2, B3, B4 = (np.float32(value) for value in (16216200, 945945, 13860, 45))
LIMIT = np.float32(6.28)


@njit(fastmath=True)
def sigmoid(values: Any) -> None:
    """Probabilities of logits, (N,) float32, in place."""
    for x in range(len(values)):
        t = HALF * values[x]
        t = LIMIT if t > LIMIT else (-LIMIT if t < -LIMIT else t)
        s = t * t
        over = A0 + s * (A1 + s * (A2 + s * (A3 + s)))
        values[x] = HALF + HALF * t * over / (A0 + s * (B1 + s * (B2 + s * (B3 + s * B4))))
