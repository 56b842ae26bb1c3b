"""Work that stands in for running a recording; workers import this file, so it is light."""

from __future__ import annotations

import os
import time

from frontend.fleet.job import Job, Recipe, Row


def act_by_name(job: Job, recipe: Recipe) -> Row:
    """Die by the signal, end with the exit code, or wait, as the recording's name says; else tell the process."""
    what, _, number = job.name.partition("-")
    if what == "signal":
        os.kill(os.getpid(), int(number))
    elif what == "exit":
        os._exit(int(number))
    elif what == "wait":
        job.folder.write_text(str(os.getpid()))
        time.sleep(60)
    return Row(job.name, job.input, "done", frames=os.getpid())
