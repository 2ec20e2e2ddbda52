"""A process of a cluster, made fit for our tasks."""

import ctypes
import sys
from functools import cache

from cageik_cli.util.threads import set_blas_threads

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h

MAX_KEPT_BYTES = 1 << 25
"""Bytes; the largest allocation for which the C library may be told to keep memory at hand."""


@cache
def configure_worker() -> None:
    """Let this process use one thread inside the linear algebra, and keep memory it has freed.

    Dask has the C library give back every array at once, so that each block of frames pays for
    its pages again: as much time as half of the solve. These are the values that the library
    would find by itself. For good, for tasks come one after the other.
    """
    set_blas_threads()
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:  # not every C library has it
            mallopt(_M_MMAP_THRESHOLD, MAX_KEPT_BYTES)
            mallopt(_M_TRIM_THRESHOLD, 2 * MAX_KEPT_BYTES)
