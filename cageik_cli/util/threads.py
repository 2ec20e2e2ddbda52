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
Output = TypeVar("Output")
CGROUP_ROOT = Path("/sys/fs/cgroup")


def count_processors() -> int:
    """Processors that this process may use; a container's share of time counts, rounded up."""
    count = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        count = len(os.sched_getaffinity(0))
    return max(1, math.ceil(min(count, _read_cgroup_cpu_limit(CGROUP_ROOT))))


def _read_cgroup_cpu_limit(group: Path) -> float:
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


def limit_blas_threads(count: int) -> AbstractContextManager[object]:
    """Let the linear algebra use `count` threads inside, so that it does not fight with workers."""
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[object] = threadpool_limits(limits=count, user_api="blas")
    return limits


def set_blas_threads(count: int = 1) -> None:
    """Let the linear algebra of this process use `count` threads from now on.

    For processes that work beside others: each has its share of the processors.
    """
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=count, user_api="blas")


class OrderedMap(Generic[Item, Output]):
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
        self, function: Callable[[Item], Output], items: Iterable[Item], jobs: int, max_pending: int
    ) -> None:
        self._function, self._items, self._max_pending = function, iter(items), max_pending
        self._pool = ThreadPoolExecutor(jobs)
        self._pending: deque[Future[Output]] = deque()
        self._fill()

    def __enter__(self) -> "OrderedMap[Item, Output]":
        return self

    def __exit__(self, *error: object) -> None:
        for future in self._pending:
            future.cancel()
        self._pool.shutdown()

    def __iter__(self) -> "OrderedMap[Item, Output]":
        return self

    def __next__(self) -> Output:
        if not self._pending:
            raise StopIteration
        made = self._pending[0].result()
        self._pending.popleft()
        self._fill()
        return made

    def _fill(self) -> None:
        while len(self._pending) < self._max_pending:
            try:
                item = next(self._items)
            except StopIteration:
                return
            self._pending.append(self._pool.submit(self._function, item))
