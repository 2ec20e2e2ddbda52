"""The harness notices commands that break a promise, and has nothing against one that does not."""

import json
import subprocess
import sys

import pytest

from tests.faults.interception import is_supported
from tests.faults.process import ROOT

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not is_supported(), reason="calls cannot be intercepted here"),
]
SAYS = {
    "careless": "the output out.txt is neither the older one nor the new one",
    "hasty": "is renamed before the disk has it",
    "raw": "exit code 1: ",
    "silent": "exit code 0, and the output is not the expected one",
    "mute": "exit code 1, and no error",
    "littering": "left over after the next run: work/litter",
    "spoiling": "the input handles.json has changed",
    "stuck": "the next run ends with 1: Error: a run has failed",
    "unsteady": "the next run writes something else",
    "hanging": "it hangs",
    "impatient": "a signal ends the run",
    "whispering": "exit code 0, and stdout is not the expected one",
}


@pytest.fixture(scope="module")
def found():
    """What is violated by each fake, tried in a process of its own, which is forked often."""
    words = [sys.executable, "-m", "tests.faults.fakes"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_all_fakes_are_tried(found):
    assert set(found) == {"sound", *SAYS}


def test_a_sound_command_violates_nothing(found):
    assert found["sound"] == []


@pytest.mark.parametrize(("name", "says"), SAYS.items(), ids=SAYS)
def test_each_broken_promise_is_noticed(found, name, says):
    assert any(says in violation for violation in found[name])
