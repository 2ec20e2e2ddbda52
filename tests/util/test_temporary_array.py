import errno
import os

import numpy as np
import pytest

from cageik_cli.util.errors import FileAccessError
from cageik_cli.util.temporary_array import allocate_floats


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
