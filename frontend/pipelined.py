"""Work in stages that run at once, each on another item, in the order of the items."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

WAITING = 3  # items that are under way beyond one per stage: stages take longer for some items than for others
WAITING_LIVE = 1  # where what is read is wanted soon


def pipelined(
    items: Iterator[Any],
    *stages: Callable[[Any], Any],
    read_ahead: bool = True,
    stop: Callable[[], None] = lambda: None,
) -> Generator[Any, None, None]:
    """The items after all stages, in order: `stages[-1](... stages[0](item))`.

    Every stage has one thread, so none runs twice at once; what they do without the GIL overlaps. At most `WAITING`
    items more than there are threads are under way (without `read_ahead`, `WAITING_LIVE`), with the one that the
    consumer has: while it is slow, no items are read. What a stage answers must be its own: the stage takes the next
    item while others still work on the answer.

    An error of the items or of a stage is raised where its result would be, behind all earlier results, with the
    traceback of where it happened; that stage and those behind it take nothing more. At the end, after an error and
    when the generator is closed, what waits is dropped, what runs is waited for, and all threads end.

    Args:
        items: read in a thread of their own.
        stages: at least one.
        read_ahead: False to read an item only when the first stage is ready for it, in that stage's thread.
        stop: called at the end, so that reading does not wait for another item.
    """

    def read() -> Any:
        try:
            return next(items)
        except StopIteration:
            raise _End from None

    first, *rest = stages
    steps: list[Callable[..., Any]] = [read, *stages] if read_ahead else [lambda: first(read()), *rest]
    over = [False] * len(steps)
    threads = [ThreadPoolExecutor(1, "stage") for _ in steps]

    def run(step: int, *before: Future[Any]) -> Any:
        """One step on what the step before answers; the error of that one is its own."""
        if over[step]:
            raise _End
        try:
            return steps[step](*[future.result() for future in before])
        except BaseException:
            over[step] = True
            raise

    most = len(steps) + (WAITING if read_ahead else WAITING_LIVE)
    under_way: deque[Future[Any]] = deque()
    try:
        while True:
            while len(under_way) < most:
                future = threads[0].submit(run, 0)
                for step in range(1, len(steps)):
                    future = threads[step].submit(run, step, future)
                under_way.append(future)
            yield under_way.popleft().result()
    except _End:
        return
    finally:
        stop()
        over[:] = [True] * len(steps)
        for thread in threads:
            thread.shutdown(wait=False, cancel_futures=True)
        for thread in threads:
            thread.shutdown()


class _End(Exception):  # noqa: N818  not an error
    """There are no more items."""
