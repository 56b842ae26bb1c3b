"""Errors that a user can cause: each message is one sentence that says what is wrong and what to do about it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class AirLineError(Exception):
    """Base class of every error in this project that a user can cause."""


class InputError(AirLineError):
    """An image, file, folder, device or stream that cannot be used."""


class ConfigError(AirLineError):
    """A setting that is unknown, of the wrong type or out of range."""


class WeightsError(AirLineError):
    """A weights file that is missing, damaged or made for another network."""


@contextmanager
def from_extra(extra: str) -> Iterator[None]:
    """Around the import of what an extra of this package brings along; raises ConfigError where it is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise ConfigError(f"{error.name} is not installed: pip install 'airline-frontend[{extra}]'") from None


@contextmanager
def errors_of(path: Path) -> Iterator[None]:
    """Turn the system's errors inside the block, such as a full disk, into an `InputError` that names the file."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write '{path}': {error.strerror or error}") from error
