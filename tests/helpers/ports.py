"""Ports for servers in tests: every test has its own, since several run at once."""

from __future__ import annotations

import socket
from pathlib import Path


def free_port() -> int:
    """A port that no other program on this machine has."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def listening(port: int) -> set[str]:
    """The addresses, as the kernel writes them, on which something listens at a port."""
    rows = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    local = [row[1].split(":") for row in rows if row[3] == "0A"]
    return {address for address, number in local if int(number, 16) == port}
