"""No error of the system and no kill damages an output, or is taken for a fault of cageik."""

import os

import pytest

from tests.faults.harness import try_faults
from tests.faults.interception import is_supported

pytestmark = pytest.mark.faults


@pytest.mark.skipif(not is_supported(), reason="calls cannot be intercepted here")
def test_no_fault_of_the_system_violates_a_promise():
    seconds = float(os.environ.get("FAULT_SECONDS", "inf"))
    figures = try_faults(seconds, int(os.environ.get("FAULT_KILLS", "200")))
    print(figures.show())
    assert sum(figures.tried.values()) > 0
    assert not figures.violations
