"""Inputs are plain files of a bounded size; calls of the system are repeated after a signal."""

import errno
import io
import os
import socket
from pathlib import Path

import pytest

from cageik_cli.util.errors import FileAccessError, FormatError
from cageik_cli.util.files import (
    check_input,
    open_input,
    read_input,
    repeat_if_interrupted,
    set_size,
)
from cageik_cli.util.outputs import DeferredErrorFile
from tests.refusals import refused


def test_a_plain_file_is_read_whole_up_to_the_limit(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_input(path, 5) == b"12345"
    with open_input(path) as file:
        assert file.read() == b"12345"
    check_input(path)
    with pytest.raises(FileAccessError, match=r"has 5 bytes, expected at most 4 bytes"):
        read_input(path, 4)


def test_a_link_to_a_plain_file_is_followed(tmp_path):
    (tmp_path / "a").write_bytes(b"1")
    (tmp_path / "link").symlink_to("a")
    assert read_input(tmp_path / "link") == b"1"


def test_a_file_without_end_is_not_read_to_memory(tmp_path):
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(FileAccessError, match="expected at most"):
        read_input(tmp_path / "huge")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_page_in_place_of_json_is_refused_as_such(tmp_path, encoding):
    path = tmp_path / "a.json"
    path.write_text("<!DOCTYPE html>\n<html></html>", encoding=encoding)
    with refused(FormatError, "is a web page (HTML)"):
        read_input(path, is_json=True)
    path.write_text('{"handles": []}', encoding=encoding)
    assert read_input(path, is_json=True) == path.read_bytes()


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no such file system")
def test_a_file_that_says_it_is_empty_is_read(tmp_path):
    path = Path("/proc/self/status")
    assert path.stat().st_size == 0
    assert b"Name" in read_input(path)
    with pytest.raises(FileAccessError, match="expected at most"):
        read_input(path, 10)


@pytest.mark.skipif(os.name != "posix", reason="pipes and devices have no names on this system")
@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda path: path.mkdir(), "is a folder"),
        (os.mkfifo, "is a pipe or a device"),
        (lambda path: path.symlink_to("/dev/zero"), "is a pipe or a device"),
        (lambda path: path.symlink_to("nowhere"), "no such file"),
        (lambda path: None, "no such file"),
    ],
)
def test_what_is_no_plain_file_is_refused(tmp_path, make, says):
    path = tmp_path / "a"
    make(path)
    for read in (open_input, check_input, read_input):
        with pytest.raises(FileAccessError, match=says):
            read(path)


@pytest.mark.parametrize("read", [open_input, check_input, read_input])
def test_a_name_that_no_file_can_have_is_that_of_no_file(tmp_path, read):
    """A file may name another with a null character."""
    with refused(FileAccessError, "no such file"):
        read(tmp_path / "a\0b")


@pytest.mark.skipif(os.name != "posix", reason="pipes have no names on this system")
def test_a_socket_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    with socket.socket(socket.AF_UNIX) as one:
        one.bind("a")
        for read in (open_input, check_input, read_input):
            with refused(FileAccessError, "is a pipe or a device"):
                read(Path("a"))


@pytest.mark.skipif(os.name != "posix", reason="pipes have no names on this system")
def test_a_pipe_that_takes_the_place_of_a_file_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "a"
    path.write_text("1")
    checked = os.stat(path)
    path.unlink()
    os.mkfifo(path)
    monkeypatch.setattr(os, "stat", lambda name: checked)
    with pytest.raises(FileAccessError, match="is a pipe or a device"):
        open_input(path)


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
