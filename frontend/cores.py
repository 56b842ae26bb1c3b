"""How many of the machine's cores there are for the edge network."""

from __future__ import annotations

from airline.kernels.threads import cores


def network_threads(of: int | None = None) -> int:
    """Cores for the edge network when the other stages work beside it: half of those given, or of all."""
    return max(1, (of or cores()) // 2)
