import pytest

from cageik_cli.cli.deform import deform_command
from cageik_cli.cli.group import word_options
from cageik_cli.cli.output import ProgressBar
from cageik_cli.cli.pose import pose_command
from cageik_cli.util.errors import SettingError


@pytest.mark.parametrize(
    ("message", "shown"),
    [
        ("choose another with `cage=`", "choose another with --cage"),
        ("give `outside=project` or `memory=2 GiB`", "give --outside project or --memory 2 GiB"),
        ("of extract: `on_bad_frame=skip`", "of extract: --on-bad-frame skip"),
        ("choose others by `selection=`", "choose others by --frames"),
        ("has no part of `handles=`", "has no part of HANDLES"),
        ("`rigidity=2000` is too much", "--rigidity 2000 is too much"),
        ("replace it with `overwrite=True`", "replace it with --overwrite"),
        ("attribute `fps`, mesh `cage` of a file", "attribute `fps`, mesh `cage` of a file"),
        ("extract with it (`keep_weights=True`)", "extract with it (without --no-weights)"),
        ("a `.png`, a `vertex` and `Ctrl`", "a `.png`, a `vertex` and `Ctrl`"),
    ],
)
def test_parameters_are_shown_as_options(message, shown):
    assert word_options(message, pose_command) == shown


def test_the_options_of_the_command_come_first():
    assert word_options("no `source=`, no `cages=`", deform_command) == "no SOURCE, no --cages"


def test_an_error_names_the_option(monkeypatch, folder, run):
    def refuse(settings, progress):
        raise SettingError("wrong; give `outside=project`")

    monkeypatch.setattr("cageik_cli.workflows.extract.extract", refuse)
    done = run("extract", "frames", "--cage", "cage.obj")
    assert done.code == 1
    assert "give --outside project" in done.err


def test_a_note_names_the_option():
    progress = ProgressBar(is_drawn=False)
    progress.note("note", "it is long; limit it by `memory=`")
    assert progress.notes == [("note", "it is long; limit it by --memory")]
