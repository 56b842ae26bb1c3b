"""Parts of the command `python -m airline.evaluate`."""
