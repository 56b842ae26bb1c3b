"""Parts of the evaluation command `python -m airline.evaluate`."""
