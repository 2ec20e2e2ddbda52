"""The check of refusals fails where it must."""

import pytest

from tests.refusals import refused

FAULTS = {
    "of another place": "b.obj: is cut short",
    "of another fault": "a.obj: is empty",
    "of several lines": "a.obj: is cut short\nat its end",
}


def test_what_is_expected_passes():
    with refused(ValueError, "cut short", at="a.obj"):
        raise ValueError("a.obj: is cut short")


@pytest.mark.parametrize("sentence", FAULTS.values(), ids=FAULTS)
def test_another_sentence_fails(sentence):
    with pytest.raises(AssertionError), refused(ValueError, "cut short", at="a.obj"):
        raise ValueError(sentence)


def test_no_error_fails():
    with pytest.raises(pytest.fail.Exception), refused(ValueError, "cut short"):
        pass
