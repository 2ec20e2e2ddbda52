"""What a command takes is its own."""

import sys

import numpy as np
import pytest

from tests.measured import run_measured

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="measures as Linux does")


def test_memory_of_the_tests_is_not_counted():
    held = np.ones(1 << 25)  # 256 MiB
    found = run_measured(["--version"])
    assert (found.code, held[-1]) == (0, 1)
    assert "cageik" in found.text
    assert 0 < found.size < 200 << 20
    assert 0 < found.seconds < 30


def test_limits_are_those_of_the_command():
    assert run_measured(["--version"], RLIMIT_AS=1 << 24).code != 0
