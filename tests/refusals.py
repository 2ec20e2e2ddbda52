"""Errors that name what is wrong, for tests."""

from contextlib import contextmanager

import pytest


@contextmanager
def refused(kind, says, at=""):
    """What raises one sentence that begins with a place, such as a file, and says a thing."""
    with pytest.raises(kind) as caught:
        yield
    sentence = str(caught.value)
    assert sentence.startswith(f"{at}: " if at else "")
    assert says in sentence
    assert "\n" not in sentence
