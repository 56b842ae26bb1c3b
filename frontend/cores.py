"""How many of the machine's cores there are for us."""

from __future__ import annotations

import os


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def network_threads(of: int | None = None) -> int:
    """Cores for the edge network when the other stages work beside it: half of those given, or of all."""
    return max(1, (of or cores()) // 2)
