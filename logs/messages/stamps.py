"""Seconds and nanoseconds of a message to one number."""

from __future__ import annotations


def stamp_ns(seconds: int, nanoseconds: int) -> int:
    """The time in ns; 0, which means that there is none, where it does not fit into 64 bits."""
    stamp = seconds * 10**9 + nanoseconds
    return stamp if abs(stamp) < 2**63 else 0
