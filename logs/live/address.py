"""Addresses of line streams."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from urllib.parse import urlsplit

from airline.errors import ConfigError, InputError


@dataclass(frozen=True)
class Address:
    """Where something listens.

    Attributes:
        scheme: "tcp" or "ipc" for ZeroMQ, "ws" for Foxglove.
        host: the machine's name or number, "*" for all of its networks; empty for "ipc".
        port: 0 for any that is free.
        path: of the socket's file, for "ipc".
    """

    scheme: str
    host: str = ""
    port: int = 0
    path: str = ""

    def __str__(self) -> str:
        if self.scheme == "ipc":
            return f"ipc://{self.path}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def parse_address(text: str) -> Address:
    """The address that a text stands for: `tcp://[HOST]:PORT`, `ws://[HOST]:PORT` or `ipc://PATH`.

    Without a host it is this machine alone.

    Raises:
        ConfigError: a text that is no such address.
    """
    scheme, separator, rest = text.partition("://")
    if separator and scheme == "ipc" and rest and rest.isprintable():
        return Address(scheme, path=rest)
    if separator and scheme in ("tcp", "ws"):
        with suppress(ValueError):  # a port that is none
            parts = urlsplit(text)
            if parts.port is not None and "@" not in parts.netloc and not (parts.path or parts.query or parts.fragment):
                return Address(scheme, parts.hostname or "127.0.0.1", parts.port)
    raise ConfigError(
        f"'{text}' is no address of a line stream: give tcp://127.0.0.1:5555, ipc:///tmp/lines (ZeroMQ) or "
        "ws://127.0.0.1:8765 (Foxglove)"
    )


def cannot_publish(address: Address, reason: str) -> InputError:
    """The error for an address that cannot be bound."""
    return InputError(f"cannot publish at {address} ({reason}): choose another address")
