"""Rerun: the recording of a run, the layout it is shown in, and pictures of both.

Importing this package is light; `viz.rerun_sink`, `viz.blueprint` and `viz.snapshot` load Rerun.
"""

import os

# read once, when Rerun loads: it would report each broken connection three times over, beside our one warning
os.environ.setdefault("RUST_LOG", "warn,re_grpc_client=off,re_sdk::recording_stream=off")
