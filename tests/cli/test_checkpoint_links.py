"""A checkpoint is a plain file of ours: what else lies under its name is refused and kept."""

import os
from pathlib import Path

import pytest

from cageik_cli.batch.run import LOCK_FILE

LOG = Path("cages.h5.partial")
TYPED = ("extract", "frames", "--cage", "cage.obj")

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links need rights on this system")


def link_to_file(victim):
    victim.write_text("my diary")
    LOG.symlink_to(victim)


def link_to_empty_file(victim):
    victim.touch()
    LOG.symlink_to(victim)


def link_to_nothing(victim):
    LOG.symlink_to(victim)


def plain_file(victim):
    LOG.write_text("my diary")


def pipe(victim):
    os.mkfifo(LOG)


PLANTS = [link_to_file, link_to_empty_file, link_to_nothing, plain_file, pipe]


def list_contents(folder):
    return {
        path: path.read_bytes() if path.is_file() else os.path.lexists(path)
        for path in sorted(folder.rglob("*"))
    }


@pytest.mark.parametrize("options", [[], ["--overwrite"], ["--resume"]])
@pytest.mark.parametrize("plant", PLANTS)
def test_extract_writes_no_checkpoint_over_what_is_not_its_own(run, folder, plant, options):
    plant(folder / "victim")
    before = list_contents(folder)
    outcome = run(*TYPED, *options)
    assert outcome.code == 1
    assert outcome.err.startswith("Error: cages.h5.partial: ")
    assert "move it away" in outcome.err
    assert list_contents(folder) == before


def test_a_complete_result_deletes_no_link_under_the_name_of_its_checkpoint(run, folder):
    assert run(*TYPED, "-q").code == 0
    link_to_empty_file(folder / "victim")
    outcome = run(*TYPED, "--resume")
    assert (outcome.code, LOG.is_symlink()) == (1, True)
    assert "cages.h5.partial" in outcome.err


@pytest.mark.parametrize("plant", PLANTS)
def test_a_batch_writes_no_checkpoint_over_what_is_not_its_own(run, folder, plant):
    inside = Path("out/clips/frames.h5.partial")
    inside.parent.mkdir(parents=True)
    plant(folder / "victim")
    LOG.rename(inside)
    before = (folder / "victim").exists()
    outcome = run("batch", "frames", "--cage", "cage.obj", "-o", "out", "--overwrite", "--jobs", 1)
    assert outcome.code == 4 or outcome.code == 1
    assert "frames.h5.partial" in outcome.err
    assert (folder / "victim").exists() == before
    assert before is False or (folder / "victim").read_text() in ("", "my diary")


def test_a_batch_opens_no_link_as_its_lock(run, folder):
    lock = Path("out") / LOCK_FILE
    lock.parent.mkdir()
    lock.symlink_to(folder / "victim")
    outcome = run("batch", "frames", "--cage", "cage.obj", "-o", "out", "--overwrite", "--jobs", 1)
    assert (outcome.code, (folder / "victim").exists()) == (1, False)
    assert str(lock) in outcome.err
