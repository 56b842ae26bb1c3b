"""Workers on this machine: processes that are kept for many recordings, and replaced when they die."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from frontend.fleet.job import Job, Recipe, Row, run_job
from frontend.fleet.workers import Died

Work = Callable[[Job, Recipe], Row]


@dataclass
class _Worker:
    process: SpawnProcess
    connection: Connection
    job: Job | None = None


class LocalWorkers:
    """Up to `count` processes, which start when they are needed; see `Workers`.

    An executor of the standard library would give up all recordings when one process dies.

    Args:
        count: how many recordings run at once.
        recipe: what is done with each.
        work: how it is done.
    """

    def __init__(self, count: int, recipe: Recipe, work: Work = run_job) -> None:
        self._count = count
        self._arguments = recipe, work
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, _Worker] = {}

    def has_room(self) -> bool:
        """Whether another recording can be started."""
        return len(self._busy) < self._count

    def start(self, job: Job) -> None:
        """Start a recording."""
        worker = self._idle.pop() if self._idle else self._new_worker()
        worker.job = job
        self._busy[worker.connection] = worker
        with suppress(OSError):  # it died while it was idle: `wait` finds out
            worker.connection.send(job)

    def wait(self) -> list[tuple[Job, Row | Died]]:
        """Wait until recordings have ended, one at least."""
        ended: list[tuple[Job, Row | Died]] = []
        for connection in wait(list(self._busy)):
            assert isinstance(connection, Connection)
            worker = self._busy.pop(connection)
            assert worker.job is not None
            try:
                result: Row | Died = connection.recv()
                self._idle.append(worker)
            except (EOFError, OSError):
                result = Died(_end(worker))
            ended.append((worker.job, result))
        return ended

    def close(self) -> None:
        """End all workers, and with them what they are running."""
        for worker in (*self._idle, *self._busy.values()):
            worker.process.kill()  # nothing of theirs needs to be finished: results are complete or of no use
            _end(worker)
        self._idle.clear()
        self._busy.clear()

    def _new_worker(self) -> _Worker:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, *self._arguments), daemon=True)
        with _interrupts_held():
            process.start()
        theirs.close()  # or its end would not be seen
        return _Worker(process, ours)


def _end(worker: _Worker) -> str:
    """Wait for the process to end; returns how it did."""
    worker.connection.close()
    worker.process.join()
    code = worker.process.exitcode or 0
    worker.process.close()
    if code >= 0:
        return f"its worker ended by itself with exit code {code}"
    with suppress(ValueError):
        name = signal.Signals(-code).name
        return f"its worker was killed by {name}" + (" (is there enough memory?)" if name == "SIGKILL" else "")
    return f"its worker was killed by signal {-code}"


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Processes that start inside the block never see Ctrl-C, which goes to all of a terminal: we end them."""
    resource_tracker.ensure_running()  # or it would start with the first process, and let interrupts through
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection, recipe: Recipe, work: Work) -> None:
    """The life of a worker."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError):
        while True:
            connection.send(work(connection.recv(), recipe))


def _end_with_parent() -> None:
    """A batch that is killed leaves no worker behind, which would write beside the next batch."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
