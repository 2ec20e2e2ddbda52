"""Threads: how many, and who may use them."""

import os
from contextlib import AbstractContextManager


def processors() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def blas_threads(count: int) -> AbstractContextManager[object]:
    """Let the linear algebra use `count` threads inside, so that it does not fight with workers."""
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[object] = threadpool_limits(limits=count, user_api="blas")
    return limits
