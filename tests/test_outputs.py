"""Outputs: written whole or not at all, whatever the disk does."""

import errno
import io
import os
from pathlib import Path

import pytest

from cageik_cli import outputs
from cageik_cli.errors import InputError


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("there.h5", "there.h5: exists already; choose another name, or replace it"),
        ("folder", "folder: is a folder, expected the name of a file"),
        ("nowhere/cages.h5", "nowhere/cages.h5: the folder nowhere does not exist"),
        ("there.h5/cages.h5", "there.h5/cages.h5: the folder there.h5 does not exist"),
        pytest.param(
            "/proc/cages.h5",
            "/proc/cages.h5: cannot be written (",
            marks=pytest.mark.skipif(not Path("/proc/self").exists(), reason="no such folder"),
        ),
    ],
)
def test_an_output_that_cannot_be_is_refused_before_any_work(tmp_path, monkeypatch, name, says):
    monkeypatch.chdir(tmp_path)
    Path("there.h5").write_text("old")
    Path("folder").mkdir()
    with pytest.raises(InputError) as caught:
        outputs.prepare(Path(name), overwrite=False)
    assert str(caught.value).startswith(says)
    assert Path("there.h5").read_text() == "old"


def test_an_output_that_can_be_leaves_no_trace(tmp_path):
    outputs.prepare(tmp_path / "new.h5", overwrite=False)
    assert not list(tmp_path.iterdir())
    (tmp_path / "old.h5").write_text("old")
    outputs.prepare(tmp_path / "old.h5", overwrite=True)
    assert (tmp_path / "old.h5").read_text() == "old"


@pytest.mark.skipif(os.name != "posix", reason="permissions are POSIX's")
@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_permissions_are_those_of_any_new_file(tmp_path, mask):
    before = os.umask(mask)
    try:
        outputs.write_text(tmp_path / "ours", "", overwrite=False)
        (tmp_path / "plain").touch()
    finally:
        os.umask(before)
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_runs_of_one_process_number_do_not_meet(tmp_path):
    """As in two containers that share a folder."""
    path = tmp_path / "cages.h5"
    with outputs.whole_file(path, overwrite=True) as one:
        one.write(b"one")
        outputs.prepare(path, overwrite=True)
        with outputs.whole_file(path, overwrite=True) as other:
            other.write(b"other")
        assert path.read_bytes() == b"other"
    assert path.read_bytes() == b"one"
    assert [item.name for item in tmp_path.iterdir()] == ["cages.h5"]


def test_nobody_elses_file_is_written_into(tmp_path, monkeypatch):
    monkeypatch.setattr(outputs.secrets, "token_hex", lambda count: "taken")
    taken = tmp_path / "a.taken.partial"
    taken.write_text("somebody else's")
    for attempt in (outputs.prepare, lambda *how: outputs.write_text(how[0], "b", how[1])):
        with pytest.raises(InputError, match=r"a: cannot be written \(File exists\)"):
            attempt(tmp_path / "a", True)
    with pytest.raises(InputError, match=r"a: cannot be written \(File exists\)"):  # noqa: SIM117
        with outputs.whole_file(tmp_path / "a", True):
            pytest.fail("opened")
    assert taken.read_text() == "somebody else's"


def test_text_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "report.json"
    outputs.write_text(path, "ä\n", overwrite=False)
    assert path.read_bytes() == "ä\n".encode()
    with pytest.raises(InputError, match="exists already"):
        outputs.write_text(path, "b", overwrite=False)
    with pytest.raises(UnicodeEncodeError):
        outputs.write_text(path, "\ud800", overwrite=True)
    assert path.read_bytes() == "ä\n".encode()
    outputs.write_text(path, "c", overwrite=True)
    assert path.read_text() == "c"
    assert [item.name for item in tmp_path.iterdir()] == ["report.json"]


class FullAfter(io.FileIO):
    """A disk with room for so many bytes, that takes a write in two parts."""

    room = 10

    def write(self, data):
        if self.tell() + len(data) > self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data[: max(1, len(data) // 2)])

    def truncate(self, size=None):
        if (size or 0) > self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().truncate(size)


@pytest.fixture
def full_disk():
    outputs.PatientFile.__bases__ = (FullAfter,)
    yield
    outputs.PatientFile.__bases__ = (io.FileIO,)


@pytest.mark.usefixtures("full_disk")
def test_a_failed_write_is_kept_until_it_is_asked_for(tmp_path):
    with outputs.PatientFile(tmp_path / "a") as file:
        assert file.write(b"12345") == 5
        file.check()
        assert file.write(b"6789012") == 7
        assert file.write(b"3") == 1
        with pytest.raises(OSError, match="No space"):
            file.check()
    assert (tmp_path / "a").read_bytes() == b"12345"


@pytest.mark.usefixtures("full_disk")
def test_a_failed_truncation_is_kept_too(tmp_path):
    with outputs.PatientFile(tmp_path / "a") as file:
        assert file.truncate(5) == 5
        file.check()
        assert file.truncate(50) == 50
        with pytest.raises(OSError, match="No space"):
            file.check()


@pytest.mark.usefixtures("full_disk")
@pytest.mark.parametrize("error", [RuntimeError, ValueError, OSError])
def test_a_full_disk_is_said_whatever_it_led_to(tmp_path, error):
    def fail_on():
        with outputs.whole_file(tmp_path / "a", overwrite=False) as file:
            file.write(b"longer than the disk")
            raise error("unable to flush a cache that nobody knows")

    with pytest.raises(InputError, match=r"a: cannot be written \(No space left on device\)"):
        fail_on()
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("full_disk")
def test_a_text_that_does_not_fit_leaves_the_old_one(tmp_path):
    path = tmp_path / "a"
    path.write_text("old")
    with pytest.raises(InputError, match=r"a: cannot be written \(No space left on device\)"):
        outputs.write_text(path, "longer than the disk", overwrite=True)
    assert path.read_text() == "old"
    assert [item.name for item in tmp_path.iterdir()] == ["a"]


def test_an_output_is_no_input_and_no_other_output(tmp_path):
    a, b = tmp_path / "a", tmp_path / "x" / ".." / "a"
    outputs.keep_apart([a, None, Path("-"), Path("-")], [tmp_path / "c", None])
    for written, read in (([a, b], []), ([a], [b])):
        with pytest.raises(InputError, match="read or written by this command already"):
            outputs.keep_apart(written, read)


def test_what_is_not_a_plain_file_is_never_replaced():
    with pytest.raises(InputError, match="is not a plain file"):
        outputs.prepare(Path("/dev/null"), overwrite=True)
