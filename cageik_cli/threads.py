"""Threads: how many, and who may use them."""

import math
import os
from contextlib import AbstractContextManager
from pathlib import Path

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
