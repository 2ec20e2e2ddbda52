"""A signal that interrupts a call of the system costs nothing but the call."""

import errno
import io

import pytest

from cageik_cli.util.interrupts import repeat_if_interrupted, set_size
from cageik_cli.util.outputs import DeferredErrorFile


def failing(errors, call=lambda: "done"):
    """Return a call that raises the errors, one per turn, before it is made."""
    left = list(errors)

    def attempt(*words):
        if left:
            raise left.pop(0)
        return call(*words)

    return attempt


INTERRUPTED = InterruptedError(errno.EINTR, "Interrupted system call")


def test_an_interrupted_call_is_made_again():
    assert repeat_if_interrupted(failing([INTERRUPTED] * 3)) == "done"


@pytest.mark.parametrize("error", [OSError(errno.EIO, "no"), ValueError("no"), KeyboardInterrupt()])
def test_other_errors_are_not_repeated(error):
    with pytest.raises(type(error)):
        repeat_if_interrupted(failing([INTERRUPTED, error]))


def test_the_size_of_a_file_is_set_in_spite_of_a_signal():
    file = io.BytesIO(b"12345")
    file.truncate = failing([INTERRUPTED], file.truncate)
    set_size(file, 3)
    assert file.getvalue() == b"123"


class InterruptedOnce(io.FileIO):
    """A file whose size is set at the second attempt."""

    attempts = 0

    def truncate(self, size=None):
        self.attempts += 1
        if self.attempts == 1:
            raise INTERRUPTED
        return super().truncate(size)


@pytest.fixture
def interrupted_outputs():
    DeferredErrorFile.__bases__ = (InterruptedOnce,)
    yield
    DeferredErrorFile.__bases__ = (io.FileIO,)


@pytest.mark.usefixtures("interrupted_outputs")
def test_an_output_is_not_spoilt_by_a_signal(tmp_path):
    with DeferredErrorFile(tmp_path / "a") as file:
        assert file.truncate(5) == 5
        assert file.attempts == 2
        file.raise_deferred_error()
    assert (tmp_path / "a").read_bytes() == bytes(5)
