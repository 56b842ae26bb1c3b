"""Measuring trackers against known identities; `python -m frontend.evaluate` is its command."""
