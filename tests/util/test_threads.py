import os
import time

import pytest
from threadpoolctl import threadpool_info

from cageik_cli.util import threads
from cageik_cli.util.threads import OrderedMap, count_processors, limit_blas_threads


def test_blas_threads_are_limited_inside_and_restored():
    import numpy as np

    np.ones((2, 2)) @ np.ones((2, 2))

    def counts():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    before = counts()
    assert set(before) == {1}
    with limit_blas_threads(2):
        assert set(counts()) == {2}
    assert counts() == before


def test_there_is_a_processor(monkeypatch):
    assert count_processors() >= 1
    monkeypatch.delattr("os.sched_getaffinity", raising=False)
    assert count_processors() >= 1


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"cpu.max": "max 100000\n"}, 8),
        ({"cpu.max": "150000 100000\n"}, 2),
        ({"cpu.max": "200000 100000\n"}, 2),
        ({"cpu.max": "1000 100000\n"}, 1),
        ({"cpu.max": "6400000 100000\n"}, 8),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 8),
        ({"cpu/cpu.cfs_quota_us": "250000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 3),
        ({"cpu/cpu.cfs_quota_us": "250000\n"}, 8),
        ({"cpu.max": "of another system\n"}, 8),
        ({"cpu.max": "0 0\n"}, 8),
        ({}, 8),
    ],
)
def test_a_container_has_its_share(tmp_path, monkeypatch, files, expected):
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(threads, "CGROUP_ROOT", tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(8)), raising=False)
    assert count_processors() == expected


@pytest.mark.parametrize("jobs", [1, 3])
@pytest.mark.parametrize("ahead", [1, 2, 7])
def test_what_is_made_comes_in_the_order_of_the_items(jobs, ahead):
    def work(item):
        time.sleep(0.001 * (item % 3))
        return item * item

    with OrderedMap(work, range(20), jobs, ahead) as made:
        assert list(made) == [item * item for item in range(20)]


def test_no_more_is_begun_than_is_asked_for_ahead():
    taken = []

    def items():
        for item in range(20):
            taken.append(item)
            yield item

    with OrderedMap(lambda item: item, items(), 2, 3) as made:
        assert taken == [0, 1, 2]
        assert next(made) == 0
        assert taken == [0, 1, 2, 3]


def test_an_error_is_raised_where_its_item_would_have_been():
    done = []

    def work(item):
        if item == 2:
            raise ValueError("two")
        done.append(item)
        return item

    with OrderedMap(work, range(100), 1, 4) as made:
        assert [next(made), next(made)] == [0, 1]
        with pytest.raises(ValueError, match="two"):
            next(made)
    assert max(done) < 10
