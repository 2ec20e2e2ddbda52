"""Options in messages and notes, as they are typed, in place of parameters of the package."""

import ast
import json
import re
import shutil
import struct
from pathlib import Path

import h5py
import pytest

import cageik_cli
from cageik_cli.cli import main
from cageik_cli.cli.deform import deform_command
from cageik_cli.cli.group import spell_message, spell_option
from cageik_cli.cli.output import ProgressBar
from cageik_cli.cli.pose import pose_command
from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import Hint, say


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
        ("few numbers by `fit_rank=`", "few numbers by --fit-rank"),
        ("raise `fit_regularization=`", "raise --fit-regularization"),
        ("attribute `fps`, mesh `cage` of a file", "attribute `fps`, mesh `cage` of a file"),
        ("extract with it (`keep_weights=True`)", "extract with it (without --no-weights)"),
        ("a `.png`, a `vertex` and `Ctrl`", "a `.png`, a `vertex` and `Ctrl`"),
    ],
)
def test_parameters_are_shown_as_options(message, shown):
    assert spell_message(say(message), pose_command) == shown


def test_the_options_of_the_command_come_first():
    assert (
        spell_message(say("no `source=`, no `cages=`"), deform_command) == "no SOURCE, no --cages"
    )


def test_every_parameter_that_a_message_names_is_an_option_of_a_command():
    package = Path(cageik_cli.__file__).parent
    sources = [path.read_text() for path in package.rglob("*.py") if path.name != "messages.py"]
    named = {
        name
        for source in sources
        for name in re.findall(r"`([a-z_]+)=|Hint\(\s*\"([a-z_]+)\"", source)
    }
    names = {keyword or hint for keyword, hint in named}
    commands = list(main.commands.values())
    known = {name for name in names for one in commands if "`" not in spell_option(Hint(name), one)}
    assert len(names) > 40
    assert names == known


def test_a_text_is_made_of_words_that_stand_in_the_code():
    """What a user named must not be taken for a hint."""
    package = Path(cageik_cli.__file__).parent
    said = [
        call.args[0]
        for path in package.rglob("*.py")
        for call in ast.walk(ast.parse(path.read_text()))
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "say"
    ]
    allowed = {"setting.refusal", "message", "packed.removeprefix('warning: ')"}
    assert len(said) > 100
    assert {ast.unparse(one) for one in said if not isinstance(one, ast.Constant)} == allowed


def test_a_name_is_not_taken_for_a_hint(run, here):
    shown = run("info", "`rest=`.obj").err
    assert shown == "Error: `rest=`.obj: no such file or folder; check the path\n"


def test_an_error_names_the_option(monkeypatch, folder, run):
    def refuse(settings, progress):
        raise SettingError(say("wrong; give `outside=project`"))

    monkeypatch.setattr("cageik_cli.run.extraction.extract", refuse)
    done = run("extract", "frames", "--cage", "cage.obj")
    assert done.code == 1
    assert "give --outside project" in done.err


@pytest.mark.parametrize(
    "words", ["report cages.h5 --all", "extract frames --cage cage.obj --overwrite -v"]
)
def test_what_to_do_names_the_option(monkeypatch, folder, run, tiny_result, words):
    shutil.copy(tiny_result, "cages.h5")
    advice = [("to do", say("smooth it by `smooth=auto`"))]
    monkeypatch.setattr("cageik_cli.report.views.text._region_rows", lambda report: advice)
    done = run(*words.split())
    assert "smooth it by --smooth auto" in done.out + done.err


def test_why_a_frame_was_skipped_names_the_option(run, folder):
    lines = Path("frames/frame_2.obj").read_text().splitlines(keepends=True)
    Path("frames/frame_2.obj").write_text("v nan nan nan\n" + "".join(lines[1:]))
    done = run("extract", "frames", "--cage", "cage.obj", "--on-bad-frame", "skip", "-v")
    assert done.code == 0, done.err
    assert "take them as missing with --missing of cageik extract" in done.err
    assert "`missing=" not in done.err


def test_a_note_names_the_option():
    progress = ProgressBar(is_drawn=False)
    progress.note("note", say("it is long; limit it by `memory=`"))
    assert progress.notes == [("note", "it is long; limit it by --memory")]


NOTE = "cage: weights are poor at `accuracy=preview`"
VIEWS = {"--json": "r.json", "--html": "r.html", "--junit": "r.xml", "--markdown": "r.md"}


def test_every_view_of_a_result_names_options(run, tiny_result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(tiny_result, "cages.h5")
    with h5py.File("cages.h5", "r+") as file:
        file.attrs["notes"] = json.dumps([NOTE])
    done = run("report", "--no-player", *(word for view in VIEWS.items() for word in view))
    shown = {name: Path(name).read_text().replace("\\", "") for name in VIEWS.values()}
    for view, text in (shown | {"text": done.out}).items():
        assert "weights are poor at --accuracy preview" in text, view
        assert not re.search("`[a-z_]+=", text), view


def test_pages_and_reports_of_a_batch_name_options(run, folder, animation, here):
    """The times of a clip are uneven, which a note says."""
    frames, times = animation.frames.astype(">f4"), [0.0, 1.0, 1.5, 4.0, 5.0]
    Path("anim").mkdir()
    head = struct.pack(">ii5f", *frames.shape[:2], *times)
    Path("anim/walk.mdd").write_bytes(head + frames.tobytes())
    done = run("batch", "anim", "-o", "out", "--cage", "cage.obj", "--rest", "frames/frame_1.obj")
    assert done.code == 0, done.err
    for name in ("report.json", "junit.xml", "report.md", "clips/walk.mdd.html"):
        text = Path("out", name).read_text().replace("\\", "")
        assert "give --fps" in text, name
        assert "`fps=" not in text, name


def test_more_lines_are_asked_for_by_a_letter():
    assert spell_message(say("`verbose=True` shows all")) == "-v shows all"
