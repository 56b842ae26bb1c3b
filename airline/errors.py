"""Errors that a user can cause.

Each message is one sentence that says what is wrong and what to do about it. The command line prints it and exits
with code 2; a library caller catches `AirLineError` and never sees a foreign exception for bad input.
"""


class AirLineError(Exception):
    """Base class of every error in this project that a user can cause."""


class InputError(AirLineError):
    """An image, file, folder, device or stream that cannot be used."""


class ConfigError(AirLineError):
    """A setting that is unknown, of the wrong type or out of range."""


class WeightsError(AirLineError):
    """A weights file that is missing, damaged or made for another network."""
