from threadpoolctl import threadpool_info

from cageik_cli.threads import blas_threads, processors


def test_blas_threads_are_limited_inside_and_restored():
    import numpy as np

    np.ones((2, 2)) @ np.ones((2, 2))

    def counts():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    before = counts()
    assert before
    with blas_threads(1):
        assert set(counts()) == {1}
    assert counts() == before


def test_there_is_a_processor(monkeypatch):
    assert processors() >= 1
    monkeypatch.delattr("os.sched_getaffinity", raising=False)
    assert processors() >= 1
