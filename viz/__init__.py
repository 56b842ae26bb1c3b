"""Rerun: the recording of a run, the layout it is shown in, and pictures of both.

Importing this package is light; `viz.rerun_sink`, `viz.blueprint` and `viz.snapshot` load Rerun.
"""
