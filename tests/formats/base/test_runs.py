"""Frames in runs: each is right, and a run is read once by threads that go forward."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.formats.base import binary_frames as runs
from cageik_cli.formats.base.binary_frames import ChunkedFrames


class Counted(ChunkedFrames):
    """Frames that are their own number, of one vertex of 3 bytes."""

    def __init__(self, count, layer):
        self.reads = []
        super().__init__(count, 1, layer, 1)

    def read_chunk(self, start, stop):
        self.reads.append((start, stop))
        return np.arange(start, stop)


@given(st.integers(1, 40), st.integers(1, 50))
def test_each_frame_is_given_and_each_run_read_once(count, size):
    frames = Counted(count, size)
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(frames.read_frame, range(count))) == list(range(count))
    assert len(frames.reads) <= 3 * -(-count // size)
    assert {k for run in frames.reads for k in range(*run)} == set(range(count))
    assert max(stop - start for start, stop in frames.reads) <= size


def test_both_sides_of_a_border_are_kept():
    frames = Counted(20, 5)
    for k in (4, 5, 4, 6, 3, 9, 0):
        assert frames.read_frame(k) == k
    assert frames.reads == [(0, 5), (5, 10)]
    frames.read_frame(10)
    frames.read_frame(0)
    assert frames.reads == [(0, 5), (5, 10), (10, 15), (0, 5)]


@pytest.mark.parametrize(("layer", "bound", "size"), [(7, 1000, 7), (70, 30, 10), (70, 1, 1)])
def test_a_run_has_a_layer_and_no_more_bytes_than_the_bound(monkeypatch, layer, bound, size):
    monkeypatch.setattr(runs, "MAX_CHUNK_BYTES", bound)
    frames = Counted(70, layer)
    frames.read_frame(0)
    assert frames.reads == [(0, size)]
