"""How many frames memory holds, and memory that is used again, or on the disk."""

import errno
import os

import numpy as np
import pytest

from cageik_cli.util.arrays import (
    Workspace,
    allocate_floats,
    count_frames,
    fill_gaps,
    spread_evenly,
)
from cageik_cli.util.errors import FileAccessError


@pytest.mark.parametrize(
    ("memory", "expected"), [(10 * 24 * 7, 10), (10 * 24 * 7 - 1, 9), (1, 1), (0, 1), (-5, 1)]
)
def test_frames_fit_in_the_memory_one_at_least(memory, expected):
    assert count_frames(memory, 7) == expected


def test_frames_of_several_arrays_or_smaller_items_take_their_bytes():
    frame = np.empty((7, 3), np.float32)
    assert count_frames(12 * frame.nbytes, 7, itemsize=4) == 12
    assert count_frames(12 * frame.nbytes, 7, arrays=3, itemsize=4) == 4


def test_an_array_of_a_workspace_is_allocated_once():
    workspace = Workspace()
    large = workspace.array("a", 4, 5)
    assert np.shares_memory(workspace.array("a", 2, 3), large)
    assert not np.shares_memory(workspace.array("b", 2, 3), large)
    assert workspace.array("a", 5, 5).shape == (5, 5)


def test_rows_are_copied_into_a_workspace():
    workspace, source = Workspace(), np.arange(12.0).reshape(4, 3)
    rows = workspace.take_rows("rows", source, np.array([3, 1]))
    np.testing.assert_array_equal(rows, source[[3, 1]])
    assert np.shares_memory(rows, workspace.array("rows", 1, 3))
    assert not np.shares_memory(rows, source)


@pytest.mark.parametrize("has_fallocate", [True, False])
@pytest.mark.parametrize("memory", [0, 1 << 30])
def test_numbers_are_kept(monkeypatch, has_fallocate, memory):
    if not has_fallocate:
        monkeypatch.delattr(os, "posix_fallocate", raising=False)
    held = allocate_floats(300_000, memory)
    assert isinstance(held, np.memmap) == (memory == 0)
    held[:] = np.arange(300_000)
    assert held.sum() == 300_000 * 299_999 / 2


def test_a_full_disk_is_named_before_anything_is_written(monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", refuse)
    with pytest.raises(FileAccessError, match=r"cannot hold 7 MiB .*No space left.*TMPDIR"):
        allocate_floats(1_000_000, 0)


@pytest.mark.parametrize(
    ("count", "most", "chosen"), [(5, 9, range(5)), (9, 5, range(0, 9, 2)), (0, 3, []), (7, 1, [0])]
)
def test_numbers_are_spread_evenly(count, most, chosen):
    assert spread_evenly(count, most).tolist() == list(chosen)


KNOWN = np.array([1, 2, 5, 6, 7])
FRAMES = np.array([np.nan, 1, 5, np.nan, np.nan, 8, 6, 2, np.nan])[:, None, None]
FILLED = [1, 1, 5, 6, 7, 8, 6, 2, 2]


@pytest.mark.parametrize("size", [1, 2, 4, 9])
def test_blocks_of_any_size_are_filled_alike(size):
    for start in range(0, len(FRAMES), size):
        block = FRAMES[start : start + size].copy()
        fill_gaps(block, start, KNOWN, lambda k: FRAMES[k])
        np.testing.assert_allclose(block.ravel(), FILLED[start : start + size], rtol=1e-15)


def test_what_has_no_gap_is_not_read():
    block = np.ones((3, 1, 1))
    fill_gaps(block, 0, np.arange(3), None)
    assert (block == 1).all()
