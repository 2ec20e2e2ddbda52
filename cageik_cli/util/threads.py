"""Threads: how many a process may use, and an ordered map over them."""

import math
import os
import sys
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")
Output = TypeVar("Output")
CGROUP_ROOT = Path("/sys/fs/cgroup")


def count_processors() -> int:
    """Count the processors that this process may use; a container's share is rounded up."""
    count = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        count = len(os.sched_getaffinity(0))
    return max(1, math.ceil(min(count, _read_cgroup_cpu_limit(CGROUP_ROOT))))


def _read_cgroup_cpu_limit(group: Path) -> float:
    """Read the number of processors that a control group allows, version 2 or 1."""
    for names in (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us")):
        try:
            quota, period = (
                float(word.replace("max", "inf"))
                for name in names
                for word in (group / name).read_text().split()
            )
        except (OSError, ValueError):
            continue  # this version is not in use
        if quota > 0 and period > 0:
            return quota / period
    return math.inf


def limit_blas_threads(count: int) -> AbstractContextManager[object]:
    """Limit the threads of the linear algebra inside, so that workers have the processors."""
    limits: AbstractContextManager[object] = _find_libraries(len(sys.modules)).limit(
        limits=count, user_api="blas"
    )
    return limits


def use_one_blas_thread() -> None:
    """Let the linear algebra have one thread for the rest of the process.

    For processes that run beside others: each has its share of the processors.
    """
    _find_libraries(len(sys.modules)).limit(limits=1, user_api="blas")


@lru_cache(maxsize=1)
def _find_libraries(modules: int) -> "ThreadpoolController":
    """Find the libraries that have threads: a search through all that modules have brought."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def run_blocks(function: Callable[[slice], object], count: int, size: int) -> None:
    """Call a function with the slices of `count` items, of at most `size` each, over threads.

    A single block runs in this thread.
    """
    size = max(1, size)
    blocks = [slice(start, min(start + size, count)) for start in range(0, count, size)]
    if len(blocks) < 2:
        for block in blocks:
            function(block)
        return
    with ThreadPoolExecutor(count_processors()) as pool:
        for _ in pool.map(function, blocks):
            pass


class OrderedMap(Generic[Item, Output]):
    """An iterator over `function(item)` in the order of the items, computed ahead by threads.

    Threads start at once. An error of an item is raised when its result is due. Items are consumed
    in the calling thread, no further than needed: at most `max_pending` are in work, or done and
    not yet taken.
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
        result = self._pending[0].result()
        self._pending.popleft()
        self._fill()
        return result

    def _fill(self) -> None:
        while len(self._pending) < self._max_pending:
            try:
                item = next(self._items)
            except StopIteration:
                return
            self._pending.append(self._pool.submit(self._function, item))
