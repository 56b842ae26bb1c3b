"""Ports for servers in tests: every test has its own, since several run at once."""

from __future__ import annotations

import socket


def free_port() -> int:
    """A port that no other program on this machine has."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
