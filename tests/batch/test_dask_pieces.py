"""What a process of a cluster is told, measured in a process of its own."""

import sys

import pytest

COUNTED = """
import resource, sys
import numpy as np
from threadpoolctl import threadpool_info
from cageik_cli.batch.dask_cluster import configure_worker

import scipy.linalg
if sys.argv[1] == "fit":
    configure_worker()
faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(100):
    np.ones(100_000)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - faults)
print(max(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="others are told nothing")
def test_memory_is_kept_and_the_linear_algebra_has_one_thread(run_process, monkeypatch):
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")  # as Dask does
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    pages = 100_000 * 8 // 4096
    faults, threads = map(int, run_process("-c", COUNTED, "as Dask has it").out.split())
    assert faults > 50 * pages
    assert threads > 1
    faults, threads = map(int, run_process("-c", COUNTED, "fit").out.split())
    assert faults < 10 * pages
    assert threads == 1
