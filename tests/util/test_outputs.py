"""Outputs: written whole or not at all, whatever the disk does."""

import errno
import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cageik_cli.util import outputs
from cageik_cli.util.errors import OutputError
from cageik_cli.util.files import exchange
from cageik_cli.util.outputs import (
    listen_to_leftovers,
    make_displaced_path,
    make_unfinished_path,
)


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
    with pytest.raises(OutputError) as caught:
        outputs.check_writable(Path(name), overwrite=False)
    assert str(caught.value).startswith(says)
    assert Path("there.h5").read_text() == "old"


def test_an_output_that_can_be_leaves_no_trace(tmp_path):
    outputs.check_writable(tmp_path / "new.h5", overwrite=False)
    assert not list(tmp_path.iterdir())
    (tmp_path / "old.h5").write_text("old")
    outputs.check_writable(tmp_path / "old.h5", overwrite=True)
    assert (tmp_path / "old.h5").read_text() == "old"


@pytest.mark.skipif(os.name != "posix", reason="links need rights elsewhere")
def test_a_link_to_nowhere_is_replaced(tmp_path):
    link = tmp_path / "cages.h5"
    link.symlink_to(tmp_path / "gone" / "cages.h5")
    outputs.write_text(link, "new", overwrite=False)
    assert link.read_text() == "new"
    assert not link.is_symlink()


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
    with outputs.atomic_file(path, overwrite=True) as one:
        one.write(b"one")
        outputs.check_writable(path, overwrite=True)
        with outputs.atomic_file(path, overwrite=True) as other:
            other.write(b"other")
        assert path.read_bytes() == b"other"
    assert path.read_bytes() == b"one"
    assert [item.name for item in tmp_path.iterdir()] == ["cages.h5"]


def test_nobody_elses_file_is_written_into(tmp_path, monkeypatch):
    monkeypatch.setattr("os.urandom", lambda count: bytes.fromhex("0123abcd"))
    taken = make_unfinished_path(tmp_path / "a")
    taken.write_text("somebody else's")
    for attempt in (outputs.check_writable, lambda *how: outputs.write_text(how[0], "b", how[1])):
        with pytest.raises(OutputError, match=r"a: cannot be written \(File exists\)"):
            attempt(tmp_path / "a", True)
    with pytest.raises(OutputError, match=r"a: cannot be written \(File exists\)"):  # noqa: SIM117
        with outputs.atomic_file(tmp_path / "a", True):
            pytest.fail("opened")
    assert taken.read_text() == "somebody else's"


def test_text_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "report.json"
    outputs.write_text(path, "ä\n", overwrite=False)
    assert path.read_bytes() == "ä\n".encode()
    with pytest.raises(OutputError, match=r"report\.json: exists"):
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
    outputs.DeferredErrorFile.__bases__ = (FullAfter,)
    yield
    outputs.DeferredErrorFile.__bases__ = (io.FileIO,)


@pytest.mark.usefixtures("full_disk")
def test_a_failed_write_is_kept_until_it_is_asked_for(tmp_path):
    with outputs.DeferredErrorFile(tmp_path / "a") as file:
        assert file.write(b"12345") == 5
        file.raise_deferred_error()
        assert file.write(b"6789012") == 7
        assert file.write(b"3") == 1
        with pytest.raises(OSError, match="No space"):
            file.raise_deferred_error()
    assert (tmp_path / "a").read_bytes() == b"12345"


@pytest.mark.usefixtures("full_disk")
def test_nothing_is_read_back_after_a_failed_write(tmp_path):
    """A library would take for data what its memory holds where the file is too short."""
    buffer = bytearray(b"???")
    with outputs.DeferredErrorFile(tmp_path / "a") as file:
        file.write(b"12345")
        file.seek(0)
        assert (file.readinto(buffer), buffer) == (3, bytearray(b"123"))
        file.write(b"much more than there is room for")
        file.seek(0)
        with pytest.raises(OSError, match="No space"):
            file.readinto(buffer)


@pytest.mark.usefixtures("full_disk")
def test_a_failed_truncation_is_kept_too(tmp_path):
    with outputs.DeferredErrorFile(tmp_path / "a") as file:
        assert file.truncate(5) == 5
        file.raise_deferred_error()
        assert file.truncate(50) == 50
        with pytest.raises(OSError, match="No space"):
            file.raise_deferred_error()


@pytest.mark.usefixtures("full_disk")
@pytest.mark.parametrize("error", [RuntimeError, ValueError, OSError])
def test_a_full_disk_is_said_whatever_it_led_to(tmp_path, error):
    def fail_on():
        with outputs.atomic_file(tmp_path / "a", overwrite=False) as file:
            file.write(b"longer than the disk")
            raise error("unable to flush a cache that nobody knows")

    with pytest.raises(
        OutputError, match=r"a: cannot be written \(No space left on device\); free some"
    ):
        fail_on()
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("full_disk")
def test_a_text_that_does_not_fit_leaves_the_old_one(tmp_path):
    path = tmp_path / "a"
    path.write_text("old")
    with pytest.raises(
        OutputError, match=r"a: cannot be written \(No space left on device\); free some"
    ):
        outputs.write_text(path, "longer than the disk", overwrite=True)
    assert path.read_text() == "old"
    assert [item.name for item in tmp_path.iterdir()] == ["a"]


def test_an_output_is_no_input_and_no_other_output(tmp_path):
    a, b = tmp_path / "a", tmp_path / "x" / ".." / "a"
    outputs.check_no_overlap([a, None, Path("-"), Path("-")], [tmp_path / "c", None])
    inside = a / "b" / "frame_1"
    outputs.check_no_overlap([a, tmp_path / "ab"], [tmp_path / "abc" / "frame_1"])
    for written, read, says in (
        ([a, b], [], "a: is read or written"),
        ([a], [b], "a: is read or written"),
        ([a, inside], [], "frame_1: is read or written"),
        ([a], [inside], "a: is a folder"),
        ([inside, a], [], "a: is a folder"),
    ):
        with pytest.raises(OutputError, match=says):
            outputs.check_no_overlap(written, read)


def test_what_is_not_a_plain_file_is_never_replaced():
    with pytest.raises(OutputError, match="/dev/null"):
        outputs.check_writable(Path("/dev/null"), overwrite=True)


def numbered(name):
    """Whether a file is one of the frames of these tests."""
    return name.startswith("frame_")


def write_frames(path, texts, overwrite=False):
    with outputs.atomic_folder(path, overwrite, numbered) as folder:
        for k, text in enumerate(texts):
            (folder / f"frame_{k}").write_text(text)


def texts_in(path):
    return {file.name: file.read_text() for file in path.iterdir()}


def test_a_folder_is_replaced_as_a_whole(tmp_path):
    path = tmp_path / "frames"
    write_frames(path, "abc")
    with pytest.raises(OutputError, match=r"frames: exists .*`overwrite=True`"):
        write_frames(path, "x")
    write_frames(path, "de", overwrite=True)
    assert texts_in(path) == {"frame_0": "d", "frame_1": "e"}
    assert [item.name for item in tmp_path.iterdir()] == ["frames"]


@pytest.mark.parametrize("kind", ["file", "path", "folder"])
def test_what_is_written_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch, kind):
    target, synced = tmp_path / "out", []

    def fsync(descriptor):
        synced.append((os.fstat(descriptor).st_ino, target.exists()))

    monkeypatch.setattr("os.fsync", fsync)
    if kind == "file":
        outputs.write_text(target, "a", overwrite=False)
    elif kind == "path":
        with outputs.atomic_path(target, overwrite=False) as path:
            path.write_text("a")
    else:
        write_frames(target, "ab")
    written = target.iterdir() if kind == "folder" else [target]
    assert sorted(synced) == sorted((file.stat().st_ino, False) for file in written)


def test_an_empty_folder_is_nothing_to_lose(tmp_path):
    (tmp_path / "frames").mkdir()
    outputs.check_folder_writable(tmp_path / "frames", False, numbered)
    write_frames(tmp_path / "frames", "a")
    assert texts_in(tmp_path / "frames") == {"frame_0": "a"}


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("other", ["file", "hidden", "folder", "link"])
def test_a_folder_with_anything_else_stays(tmp_path, other, overwrite):
    path = tmp_path / "frames"
    write_frames(path, "a")
    name = {"file": "notes.txt", "hidden": ".hidden"}.get(other, "frame_7")
    if other == "folder":
        (path / name).mkdir()
    elif other == "link":
        (path / name).symlink_to(tmp_path)
    else:
        (path / name).write_text("mine")
    before = sorted(path.iterdir())
    says = f"frames: holds {name},"
    with pytest.raises(OutputError, match=says):
        outputs.check_folder_writable(path, overwrite, numbered)
    with pytest.raises(OutputError, match=says):
        write_frames(path, "b", overwrite)
    assert sorted(path.iterdir()) == before
    assert (path / "frame_0").read_text() == "a"
    assert [item.name for item in tmp_path.iterdir()] == ["frames"]


def test_what_comes_into_the_folder_meanwhile_stays(tmp_path):
    path = tmp_path / "frames"
    write_frames(path, "a")

    def interfere():
        with outputs.atomic_folder(path, True, numbered) as folder:
            (folder / "frame_0").write_text("b")
            (path / "notes.txt").write_text("mine")

    with pytest.raises(OutputError, match=r"frames: holds notes\.txt"):
        interfere()
    assert texts_in(path) == {"frame_0": "a", "notes.txt": "mine"}
    assert [item.name for item in tmp_path.iterdir()] == ["frames"]


def test_a_folder_that_fails_leaves_the_old_one(tmp_path):
    path = tmp_path / "frames"
    write_frames(path, "ab")

    def fail(error):
        with outputs.atomic_folder(path, True, numbered) as folder:
            (folder / "frame_0").write_text("c")
            raise error

    for error in (RuntimeError, KeyboardInterrupt):
        with pytest.raises(error):
            fail(error)
    assert texts_in(path) == {"frame_0": "a", "frame_1": "b"}
    assert [item.name for item in tmp_path.iterdir()] == ["frames"]


@pytest.mark.parametrize("refused", [1, 2])
def test_a_rename_that_is_refused_brings_the_old_folder_back(tmp_path, monkeypatch, refused):
    """The old one moves away first, then the new one moves in."""
    path = tmp_path / "frames"
    write_frames(path, "ab")
    rename, calls = Path.rename, []

    def fail_once(self, target):
        calls.append(target)
        if len(calls) == refused:
            raise PermissionError(errno.EACCES, "Permission denied")
        return rename(self, target)

    monkeypatch.setattr(outputs, "exchange", lambda one, other: False)  # a disk without it
    monkeypatch.setattr(Path, "rename", fail_once)
    with pytest.raises(OutputError, match=r"frames: cannot be written \(Permission denied\)"):
        write_frames(path, "c", overwrite=True)
    assert texts_in(path) == {"frame_0": "a", "frame_1": "b"}
    assert [item.name for item in tmp_path.iterdir()] == ["frames"]


@pytest.mark.skipif(not sys.platform.startswith(("linux", "darwin")), reason="no such call")
def test_a_folder_is_replaced_in_one_step(tmp_path, monkeypatch):
    path = tmp_path / "frames"
    write_frames(path, "ab")
    steps = []

    def watch(one, other):
        steps.append((texts_in(path), exchange(one, other), texts_in(path)))
        return True

    monkeypatch.setattr(outputs, "exchange", watch)
    monkeypatch.setattr(Path, "rename", None)
    write_frames(path, "c", overwrite=True)
    assert steps == [({"frame_0": "a", "frame_1": "b"}, True, {"frame_0": "c"})]
    assert [item.name for item in tmp_path.iterdir()] == ["frames"]


def test_what_cannot_be_exchanged_is_left(tmp_path):
    (tmp_path / "a").mkdir()
    assert not exchange(tmp_path / "a", tmp_path / "b")
    assert [item.name for item in tmp_path.iterdir()] == ["a"]


def test_a_run_killed_between_two_renames_loses_no_folder(tmp_path, monkeypatch):
    """Where folders cannot be exchanged: the next run says so, and puts the old one back."""
    path = tmp_path / "frames"
    write_frames(path, "ab")
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    with monkeypatch.context() as patch:
        patch.setattr(os, "getpid", lambda: process.pid)
        old = make_displaced_path(path)
    path.rename(old)
    said = []
    with listen_to_leftovers(said.append), pytest.raises(OutputError, match="exists already"):
        outputs.check_folder_writable(path, False, numbered)
    assert said == [f"{path.resolve()}: put back, as it was before a run that was killed"]
    assert texts_in(path) == {"frame_0": "a", "frame_1": "b"}


def test_a_folder_behind_a_link_is_written_where_it_is(tmp_path):
    (tmp_path / "far").mkdir()
    write_frames(tmp_path / "far" / "frames", "a")
    (tmp_path / "near").symlink_to(tmp_path / "far" / "frames")
    write_frames(tmp_path / "near", "b", overwrite=True)
    assert (tmp_path / "near").is_symlink()
    assert texts_in(tmp_path / "far" / "frames") == {"frame_0": "b"}
    assert [item.name for item in (tmp_path / "far").iterdir()] == ["frames"]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no such folder")
def test_a_folder_that_cannot_be_made_is_refused_before_any_work():
    with pytest.raises(OutputError, match=r"^/proc/frames: cannot be written \("):
        outputs.check_folder_writable(Path("/proc/frames"), True, numbered)
