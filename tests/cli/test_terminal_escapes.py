"""Names and contents of files cannot control the terminal that messages are printed on."""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.cli.terminal import print_on_terminal

EVIL = "e\x1b]0;owned\x07\x1b[2J\x9b31m\u202etxt\x7f\x08"
CONTROLS = [chr(k) for k in (*range(9), 11, 12, *range(14, 32), *range(127, 160))]
CONTROLS += ["\u202a", "\u202b", "\u202d", "\u202e", "\u2066", "\u2067", "\u2068", "\u200f"]
BASE = ["extract", "frames", "--cage", "cage.obj"]


def find_controls(text):
    # The progress bar's own: carriage returns are not among the controls.
    return sorted({mark for mark in text if mark in CONTROLS})


def frame_in_odd_folder():
    shutil.move("frames/frame_2.obj", f"frames/{EVIL}.obj")
    Path(f"frames/{EVIL}.obj").write_text("v 1 2\n")
    return [*BASE, "--allow-gaps", "-v"]


def odd_folder():
    shutil.move("frames", EVIL)
    return ["extract", EVIL, "--cage", "cage.obj", "-o", f"{EVIL}.h5"]


def odd_line():
    Path("cage.obj").write_text(f"v 1 {EVIL} 2\n")
    return BASE


def odd_key():
    Path("a.toml").write_text(f'[extract]\n"{EVIL}" = 1\n'.replace(EVIL, escape_toml(EVIL)))
    return [*BASE, "--config", "a.toml"]


def odd_table():
    Path("a.toml").write_text(f'["{escape_toml(EVIL)}"]\nalpha = 1\n')
    return [*BASE, "--config", "a.toml"]


def odd_value():
    Path("a.toml").write_text(f'[extract]\nalpha = "{escape_toml(EVIL)}"\n')
    return [*BASE, "--config", "a.toml"]


def escape_toml(text):
    return "".join(f"\\U{ord(mark):08x}" for mark in text)


def odd_clip():
    with h5py.File("a.h5", "w") as file:
        file["faces"] = np.array([[0, 1, 2]])
        file[EVIL], file["other"] = np.zeros((3, 3, 2)), np.zeros((3, 3, 2))
    return ["extract", "a.h5", "--cage", "cage.obj"]


def odd_batch():
    shutil.move("frames", f"clips/{EVIL}") if Path("clips").mkdir() is None else None
    Path(f"clips/{EVIL}/frame_3.obj").write_text(EVIL)
    return ["batch", "clips", "--cage", "cage.obj", "-o", "out", "--jobs", "1"]


def odd_argument():
    return ["info", EVIL]


def odd_option():
    return ["extract", f"--{EVIL}"]


def odd_command():
    return [EVIL]


def odd_group_option():
    return [f"--{EVIL}"]


CASES = [
    frame_in_odd_folder, odd_folder, odd_line, odd_key, odd_table, odd_value, odd_clip, odd_batch,
    odd_argument, odd_option, odd_command, odd_group_option,
]  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_no_control_character_reaches_the_terminal(folder, here, case):
    drawn = print_on_terminal(*case())
    assert "owned" in drawn
    assert find_controls(drawn) == []


def set_attribute(name, value):
    with h5py.File("cages.h5", "r+") as file:
        file.attrs[name] = value


ODD_ATTRIBUTES = {
    "notes": '["EVIL"]',
    "settings": '{"EVIL": "EVIL"}',
    "sources": '{"EVIL": {"name": "EVIL"}}',
    "version": "EVIL",
}


@pytest.mark.parametrize("name", ODD_ATTRIBUTES)
@pytest.mark.parametrize("command", ["info", "report"])
def test_attributes_of_a_result_cannot_control_the_terminal(run, folder, name, command):
    assert run(*BASE, "-q").code == 0
    text = "".join(f"\\u{ord(mark):04x}" for mark in EVIL)
    value = ODD_ATTRIBUTES[name]
    set_attribute(name, EVIL if value == "EVIL" else value.replace("EVIL", text))
    assert find_controls(print_on_terminal(command, "cages.h5")) == []


def test_names_of_frames_in_tables_cannot_control_the_terminal(run, folder):
    for path in list(Path("frames").iterdir()):
        path.rename(path.with_name(f"{EVIL}{path.name}"))
    assert run(*BASE, "-q").code == 0
    drawn = print_on_terminal("report", "cages.h5", "--csv", "-")
    assert "\ufffd" in drawn
    assert find_controls(drawn) == []
    # Who reads a pipe gets the same bytes as in a file.
    assert run("report", "cages.h5", "--csv", "a.csv").code == 0
    assert EVIL in Path("a.csv").read_text()
    assert run("report", "cages.h5", "--csv", "-").out == Path("a.csv").read_text()


def test_names_of_usd_prims_cannot_control_the_terminal(folder):
    pytest.importorskip("pxr")
    Path("a.usda").write_text(f'#usda 1.0\ndef Mesh "{EVIL}" {{}}\n')
    Path("b.usda").write_text(f'#usda 1.0\n(subLayers = [@{EVIL[:-2]}.usda@])\ndef Mesh "a" {{}}\n')
    for name in ("a.usda", "b.usda"):
        drawn = print_on_terminal("info", name)
        assert "Error" in drawn
        assert find_controls(drawn) == []


def test_a_stream_of_ascii_is_printable_too(run_process, folder, monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    outcome = run_process("-m", "cageik_cli", *odd_argument())
    assert find_controls(outcome.err) == []
    assert "\ufffd" in outcome.err


def test_a_traceback_is_printable(folder):
    drawn = print_on_terminal(*odd_line(), "-vv")
    assert "Traceback" in drawn
    assert find_controls(drawn) == []


def test_a_message_stays_on_its_line(run, folder):
    outcome = run("extract", "a\nError: b", "--cage", "cage.obj")
    assert outcome.err.count("\n") == 1
    outcome = run("extract", "frames", "--cage", "cage.obj", "--config", "a\nError: b.toml")
    assert not any(line.startswith("Error: b") for line in outcome.err.splitlines())
