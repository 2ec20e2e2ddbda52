"""Threads: how many, and who may use them."""

import math
import os
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Generic, TypeVar

Item = TypeVar("Item")
Made = TypeVar("Made")
CONTROL_GROUP = Path("/sys/fs/cgroup")


def processors() -> int:
    """Processors that this process may use; a container's share of time counts, rounded up."""
    count = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        count = len(os.sched_getaffinity(0))
    return max(1, math.ceil(min(count, _share(CONTROL_GROUP))))


def _share(group: Path) -> float:
    """Processors' worth of time that a control group grants, by version 2 or 1 of its files."""
    for names in (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us")):
        try:
            quota, period = (
                float(word.replace("max", "inf"))
                for name in names
                for word in (group / name).read_text().split()
            )
        except (OSError, ValueError):
            continue  # not a system with this version
        if quota > 0 and period > 0:
            return quota / period
    return math.inf


def blas_threads(count: int) -> AbstractContextManager[object]:
    """Let the linear algebra use `count` threads inside, so that it does not fight with workers."""
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[object] = threadpool_limits(limits=count, user_api="blas")
    return limits


def limit_blas_for_good(count: int = 1) -> None:
    """Let the linear algebra of this process use `count` threads from now on.

    For processes that work beside others: each has its share of the processors.
    """
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=count, user_api="blas")


class InOrder(Generic[Item, Made]):
    """What `work` makes of items, in their order, made by threads before it is asked for.

    Threads begin at once. What an item's work raises is raised where it would have been given.

    Parameters
    ----------
    work : callable
    items : iterable
        Gone through in the thread that asks, no further than needed.
    jobs : int
        Threads.
    ahead : int
        How many items are worked on, or done and not yet asked for, at most.
    """

    def __init__(
        self, work: Callable[[Item], Made], items: Iterable[Item], jobs: int, ahead: int
    ) -> None:
        self._work, self._items, self._ahead = work, iter(items), ahead
        self._pool = ThreadPoolExecutor(jobs)
        self._pending: deque[Future[Made]] = deque()
        self._fill()

    def __enter__(self) -> "InOrder[Item, Made]":
        return self

    def __exit__(self, *error: object) -> None:
        for future in self._pending:
            future.cancel()
        self._pool.shutdown()

    def __iter__(self) -> "InOrder[Item, Made]":
        return self

    def __next__(self) -> Made:
        if not self._pending:
            raise StopIteration
        made = self._pending[0].result()
        self._pending.popleft()
        self._fill()
        return made

    def _fill(self) -> None:
        while len(self._pending) < self._ahead:
            try:
                item = next(self._items)
            except StopIteration:
                return
            self._pending.append(self._pool.submit(self._work, item))
