"""`cageik view`, from its words to its end."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cageik_cli.cli import view
from cageik_cli.util.messages import say, spell
from tests.view.client import Client, make_body

DOCUMENT = {
    "handles": [
        {"name": "tip", "vertex": 0, "offset": [0.1, 0.2, -0.3]},
        {"name": "pin", "vertex": 7, "pin": True},
    ]
}


@pytest.fixture
def viewed(monkeypatch):
    """The settings and the port of views, which end at once."""
    seen = []

    def end(session, port, listener):
        seen.append((session.settings, port))
        listener.open("http://127.0.0.1:1/secret/")
        raise KeyboardInterrupt

    monkeypatch.setattr("cageik_cli.view.run.run_view", end)
    return seen


@pytest.fixture(autouse=True)
def opened(monkeypatch):
    """The addresses that a browser was asked to open."""
    addresses = []
    monkeypatch.setattr("webbrowser.open", addresses.append)
    return addresses


@pytest.mark.parametrize(
    "words",
    [
        ("cages.h5",),
        ("cages.h5", "-o", "e.h5", "--handles-out", "h.json"),
        ("binding.h5", "-o", "p.obj", "--cage-out", "c.obj"),
        ("frames/frame_1.obj", "--cage", "cage.obj", "-o", "p.ply"),
        ("frames/frame_1.obj", "--binding", "binding.h5"),
    ],
)
def test_the_address_is_printed_and_opened(run, bound, viewed, opened, words):
    outcome = run("view", *words)
    assert outcome.code == 0, outcome.err
    assert outcome.out == "http://127.0.0.1:1/secret/\n"
    assert opened == ["http://127.0.0.1:1/secret/"]
    assert outcome.err.endswith("stop with Ctrl-C\nstopped\n")


def test_no_browser_is_opened_if_not_wanted(run, bound, viewed, opened):
    outcome = run("view", "cages.h5", "--no-browser", "--port", "8123", "-q")
    assert (outcome.code, outcome.out) == (0, "http://127.0.0.1:1/secret/\n")
    assert (opened, outcome.err) == ([], "stopped\n")
    assert viewed[0][1] == 8123


def test_a_cage_is_built_if_none_is_given(run, bound, viewed, coarse_grids):
    outcome = run("view", "frames/frame_1.obj", "--cage-vertices", "20", "--no-browser")
    assert outcome.code == 0, outcome.err
    assert re.search(r"cage +built, \d+ vertices", outcome.err)


def test_the_outcome_of_an_edit_is_shown(run, bound, monkeypatch):
    def use(session, port, listener):
        with listener.show_edit() as progress:
            rows = session.parse(make_body(DOCUMENT), 3)(progress)
        listener.show_applied(rows, session.written)
        listener.show_failed("handles: are wrong")
        raise KeyboardInterrupt

    monkeypatch.setattr("cageik_cli.view.run.run_view", use)
    words = ("view", "cages.h5", "-o", "e.h5", "--handles-out", "h.json", "--overwrite")
    outcome = run(*words)
    assert outcome.code == 0
    assert re.search(r"handle +tip: moved", outcome.err)
    assert "wrote e.h5, h.json\nError: handles: are wrong\nstopped\n" in outcome.err
    assert run(*words, "-q").err == "Error: handles: are wrong\nstopped\n"


def test_what_the_page_tells_names_the_options(run, bound, monkeypatch):
    worded = []

    def use(session, port, listener):
        worded.append(spell(say("let it rotate with `rigidity=10`"), listener.spell_hint))
        raise KeyboardInterrupt

    monkeypatch.setattr("cageik_cli.view.run.run_view", use)
    assert run("view", "cages.h5").code == 0
    assert worded == ["let it rotate with --rigidity 10"]


def test_an_edit_that_is_dropped_is_told(run, bound, monkeypatch):
    def use(session, port, listener):
        with listener.show_edit():
            raise KeyboardInterrupt

    monkeypatch.setattr("cageik_cli.view.run.run_view", use)
    outcome = run("view", "cages.h5", "-o", "e.h5")
    assert outcome.err.endswith(
        "the edit was dropped; files are complete, or as before it\nstopped\n"
    )


def test_without_a_browser_the_address_is_enough(run, bound, viewed, monkeypatch):
    import webbrowser

    def fail(address):
        raise webbrowser.Error("no browser")

    monkeypatch.setattr("webbrowser.open", fail)
    outcome = run("view", "cages.h5")
    assert (outcome.code, outcome.out) == (0, "http://127.0.0.1:1/secret/\n")


def test_the_help_names_the_default_of_the_port(run):
    assert view.view_command.name == "view"
    assert "any that is free" in run("view", "--help-all").out


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
@pytest.mark.parametrize("rounds", [0, 1000])
def test_ctrl_c_leaves_no_part_of_an_edit(tmp_path, fixtures_folder, rounds):
    """While nothing runs, and in the middle of an edit of many rounds."""
    walker = fixtures_folder / "walker"
    python = [sys.executable, "-m", "cageik_cli"]
    frames = sorted(map(str, (walker / "frames").glob("*.obj")))
    words = ["extract", *frames, "--cage", str(walker / "cage.obj"), "-o", "walker.h5", "-q"]
    subprocess.run([*python, *words], cwd=tmp_path, check=True)
    words = ["view", "walker.h5", "-o", "edited.h5", "--handles-out", "h.json", "--no-browser"]
    process = subprocess.Popen([*python, *words], cwd=tmp_path, stdout=-1, stderr=-1, text=True)
    try:
        client = Client(process.stdout.readline().strip())
        if rounds:
            document = json.loads((walker / "wave.json").read_text())
            assert client.apply(document, f"?rigidity={rounds}").status == 202
            while client.status()["stage"] != "edit":
                time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 0
    assert told.endswith("stopped\n")
    assert ("the edit was dropped" in told) == bool(rounds)
    assert "Traceback" not in told
    assert [path.name for path in Path(tmp_path).iterdir()] == ["walker.h5"]


@pytest.mark.parametrize("words", [("--handles", "h.json"), ("--binding", "binding.h5")])
def test_what_has_no_part_in_editing_a_cage_is_refused(run, bound, viewed, words):
    view = ("view", "frames/frame_1.obj", "--edit-cage")
    outcome = run(*view, *words)
    assert outcome.code == 2
    assert words[0] in outcome.err
    assert run(*view, "--cage", "cage.obj", "-o", "new.obj").code == 0
    assert viewed[0][0].edits_cage
