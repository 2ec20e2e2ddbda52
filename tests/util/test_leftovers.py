"""What killed runs left is removed by the next run to the same output, and nothing else is."""

import os
import subprocess
import sys

import pytest

from cageik_cli.util import outputs
from cageik_cli.util.outputs import clear_leftovers, listen_to_leftovers, make_unfinished_path

pytestmark = pytest.mark.skipif(os.name != "posix", reason="processes cannot be asked for here")


@pytest.fixture
def dead():
    """The number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@pytest.fixture
def of_dead(monkeypatch, dead):
    """Make names as that process made them."""

    def make(path, suffix="", make=make_unfinished_path):
        with monkeypatch.context() as patch:
            patch.setattr(os, "getpid", lambda: dead)
            return make(path, suffix) if suffix else make(path)

    return make


def clear(path):
    said = []
    with listen_to_leftovers(said.append):
        clear_leftovers(path)
    return said


def test_files_and_folders_of_dead_processes_are_removed_and_said(tmp_path, of_dead):
    path = tmp_path / "a.npz"
    left = [of_dead(path), of_dead(path, ".npz")]
    for file in left:
        file.write_text("half")
    folder = of_dead(tmp_path / "a.npz")
    folder.mkdir()
    (folder / "a_1.obj").write_text("half")
    packing = left[1].with_name(f"{left[1].stem}.abc_123x")  # of a .usdz
    packing.mkdir()
    said = clear(path)
    assert list(tmp_path.iterdir()) == []
    assert len(said) == 4
    assert all("removed, a run that was killed had left it" in sentence for sentence in said)


def test_nothing_else_is_removed(tmp_path, of_dead, monkeypatch):
    path = tmp_path / "a.npz"
    kept = [
        path, make_unfinished_path(path), make_unfinished_path(path, ".npz"),
        of_dead(tmp_path / "b.npz"), of_dead(tmp_path / "a.npzx"), tmp_path / "a.npz.partial",
        tmp_path / "a.npz.0123.partial", of_dead(path).with_suffix(".txt"),
    ]  # fmt: skip
    monkeypatch.setattr(outputs, "_identify_machine", lambda: 7)
    kept += [of_dead(path)]
    monkeypatch.undo()
    for file in kept:
        file.write_text("mine")
    assert clear(path) == []
    assert sorted(tmp_path.iterdir()) == sorted(kept)


def test_a_link_is_removed_and_not_what_it_leads_to(tmp_path, of_dead):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/a").write_text("mine")
    of_dead(tmp_path / "a").symlink_to(tmp_path / "mine")
    assert len(clear(tmp_path / "a")) == 1
    assert [item.name for item in tmp_path.iterdir()] == ["mine"]
    assert (tmp_path / "mine/a").read_text() == "mine"


def test_a_link_is_not_put_back_as_a_folder(tmp_path, of_dead):
    """The files in the folder it leads to would be replaced."""
    (tmp_path / "mine").mkdir()
    path = tmp_path / "frames"
    of_dead(path, make=outputs.make_displaced_path).symlink_to(tmp_path / "mine")
    assert "removed" in clear(path)[0]
    assert [item.name for item in tmp_path.iterdir()] == ["mine"]


def test_a_displaced_folder_is_put_back_unless_it_was_replaced(tmp_path, of_dead):
    path = tmp_path / "frames"
    for _ in range(2):
        old = of_dead(path, make=outputs.make_displaced_path)
        old.mkdir()
        (old / "a_1.obj").write_text("old")
        said = clear(path)
        assert (path / "a_1.obj").read_text() == "old"
        assert [item.name for item in tmp_path.iterdir()] == ["frames"]
    assert "removed" in said[0]
