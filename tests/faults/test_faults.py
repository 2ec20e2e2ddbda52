"""No error of the system and no kill damages an output, or is taken for a fault of cageik."""

import os
import shutil

import pytest

from tests.faults.harness import try_faults

pytestmark = pytest.mark.faults


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace injects the errors")
def test_no_fault_of_the_system_violates_a_promise():
    seconds = float(os.environ.get("FAULT_SECONDS", "120"))
    figures = try_faults(seconds, int(os.environ.get("FAULT_KILLS", "40")))
    print(figures.show())
    assert sum(figures.tried.values()) > 0
    assert not figures.violations
