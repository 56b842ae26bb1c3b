"""Giving recordings to workers, and to others when a worker dies."""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

from frontend.fleet.job import Job, Row

log = logging.getLogger(__name__)

ATTEMPTS = 3  # per recording; a worker's death may be another's fault, as when memory runs out


@dataclass(frozen=True)
class Died:
    """A worker ended in the middle of a recording.

    Attributes:
        reason: how, as in "its worker was killed by SIGKILL".
    """

    reason: str


class Workers(Protocol):
    """Processes that run recordings, here or elsewhere."""

    def has_room(self) -> bool:
        """Whether another recording can be started."""
        ...

    def start(self, job: Job) -> None:
        """Start a recording."""
        ...

    def wait(self) -> list[tuple[Job, Row | Died]]:
        """Wait until recordings have ended, one at least."""
        ...

    def close(self) -> None:
        """End all workers, and with them what they are running."""
        ...


def run_all(jobs: Iterable[Job], workers: Workers) -> Iterator[Row]:
    """Run all recordings; yields what became of each as it ends.

    A recording whose worker dies is run again after the others, `ATTEMPTS` times in all.
    """
    waiting = deque(jobs)
    attempts: Counter[str] = Counter()
    running = 0
    while waiting or running:
        while waiting and workers.has_room():
            job = waiting.popleft()
            attempts[job.name] += 1
            running += 1
            workers.start(job)
        for job, ended in workers.wait():
            running -= 1
            count = attempts[job.name]
            if isinstance(ended, Row):
                yield replace(ended, attempts=count)
            elif count < ATTEMPTS:
                log.warning("%s: %s; it will be run again", job.name, ended.reason)
                waiting.append(job)
            else:
                reason = f"{ended.reason}, {count} times"
                yield Row(job.name, job.input, "failed", reason=reason, attempts=count)
