"""Parts of the commands `python -m airline.evaluate` and `python -m airline.evaluation.ablate`."""
