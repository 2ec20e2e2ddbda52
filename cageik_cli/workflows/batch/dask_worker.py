"""The set-up of a worker process of a cluster."""

import ctypes
import sys
from functools import cache

from cageik_cli.util.threads import set_blas_threads

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h

MAX_KEPT_BYTES = 1 << 25
"""Bytes; the largest value that the C library accepts for its thresholds."""


@cache
def configure_worker() -> None:
    """Let this process use one thread in the linear algebra, and keep the memory that it frees.

    Dask makes the C library return every freed array to the system at once, so that each block of
    frames gets new pages, which takes half as long as the solve. These are the values that the
    library would reach by itself. They stay set, since the tasks of a worker follow each other.
    """
    set_blas_threads()
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:  # not every C library has it
            mallopt(_M_MMAP_THRESHOLD, MAX_KEPT_BYTES)
            mallopt(_M_TRIM_THRESHOLD, 2 * MAX_KEPT_BYTES)
