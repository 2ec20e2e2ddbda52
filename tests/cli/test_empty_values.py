"""Values without a letter: messages name the option, and print no empty quotes."""

import itertools
from pathlib import Path

import click
import numpy as np
import pytest

from cageik_cli.cli import main
from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.util.errors import InputError
from tests.formats.gltf.built import Built
from tests.formats.scenes import AlembicScene, UsdScene
from tests.shapes import box

BOX = box(1.0)

QUOTES = ("``", "''", '""', "' '", '" "', "` `", ": :")

COMMANDS = main.list_commands(click.Context(main))


@pytest.mark.parametrize("name", COMMANDS)
def test_empty_values_are_wrong_usage(name, run):
    command = main.get_command(click.Context(main), name)
    arguments = [one for one in command.params if isinstance(one, click.Argument)]
    options = [
        max(one.opts, key=len)
        for one in command.params
        if isinstance(one, click.Option) and not one.is_flag and not one.is_eager and not one.count
    ]
    typed = [[option, value] for option in options for value in ("", " ")]
    for words in [*typed, *([[""], [" "]] if arguments else [])]:
        outcome = run(name, *words)
        assert outcome.code == 2, (words, outcome)
        assert "given a value without any letter" in outcome.err
        assert not any(quotes in outcome.err for quotes in QUOTES)


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("extract", ("output", "cache", "fps")),
        ("batch", ("output", "cache", "fps")),
        ("cage", ("output", "fps")),
        ("export", ("cache", "fps")),
    ],
)
def test_empty_values_of_a_file_of_options_name_it(name, keys, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for key, value in itertools.product(keys, ('""', '" "', '[""]')):
        Path("all.toml").write_text(f"[{name}]\n{key} = {value}\n")
        outcome = run(name, "x.obj", "--config", "all.toml")
        assert outcome.code == 2
        assert f"all.toml: {key}: given a value without any letter" in outcome.err
        assert not any(quotes in outcome.err for quotes in QUOTES)


def write_gltf(names):
    file = Built()
    for k, name in enumerate(names):
        attributes = {"POSITION": file.array(BOX.vertices + 3 * k)}
        primitive = {"attributes": attributes, "indices": file.array(BOX.faces.ravel(), "H")}
        mesh = file.add("meshes", {"name": name, "primitives": [primitive]})
        file.add("nodes", {"mesh": mesh, "name": name})
        file.animate(name, (k, "translation", np.arange(2), np.zeros((2, 3)), "LINEAR"))
    return file.save(Path("boxes.glb"))


def write_groups(letter):
    """Write what makes a file of boxes of these names, each behind the letter."""

    def write(names):
        rows = []
        for k, name in enumerate(names):
            rows.append(f"{letter} {name}")
            rows += ["v {:g} {:g} {:g}".format(*place) for place in BOX.vertices + 3 * k]
            rows += ["f {} {} {}".format(*face) for face in BOX.faces + 1 + k * len(BOX.vertices)]
        Path("boxes.obj").write_text("\n".join([*rows, ""]))
        return "boxes.obj"

    return write


KINDS = {"glTF": write_gltf, "OBJ, o": write_groups("o"), "OBJ, g": write_groups("g")}
NAMES = [("", ""), ("a", " "), (" ", "  "), ("\t", "a")]


@pytest.mark.parametrize("names", NAMES, ids=repr)
@pytest.mark.parametrize("kind", KINDS)
def test_blank_names_in_files_leave_no_empty_quotes(kind, names, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = KINDS[kind](names)
    outcomes = [run("info", path, "-v"), run("info", f"{path}::x"), run("info", f"{path}::/x")]
    outcomes += [run("extract", path, "--cage", f"{path}::x", "-o", "a.h5")]
    outcomes += [run("extract", path, "--exclude", "x", "-o", "a.h5")]
    assert outcomes[0].code == 0
    assert outcomes[-1].code == 1
    for outcome in outcomes:
        assert not any(quotes in outcome.out + outcome.err for quotes in QUOTES), outcome


def write_scene(kind):
    scene = kind(Path())
    scene.mesh()
    scene.close()
    return scene.path


MEMBERS = {
    "glTF": lambda: write_gltf(("a", "b")),
    "OBJ": lambda: write_groups("o")(("a", "b")),
    "USD": lambda: write_scene(UsdScene),
    "Alembic": lambda: write_scene(AlembicScene),
}


@pytest.mark.parametrize("kind", MEMBERS)
def test_nothing_behind_a_file_is_refused(kind, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = MEMBERS[kind]()
    for behind in ("::", ":: ", "::::", "::::x", "::\t::x"):
        outcome = run("info", f"{path}{behind}")
        assert outcome.code == 1
        assert f"{path}: given `::` without a name behind it" in outcome.err
        for load in (load_mesh, lambda name: open_sequence([name])):
            with pytest.raises(InputError, match="without a name behind it"):
                load(f"{path}{behind}")


def test_names_behind_later_marks_may_be_empty(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("info", f"{write_gltf(('a', 'b'))}::a::").code == 0


@pytest.mark.parametrize("load", [load_mesh, lambda name: open_sequence([name])])
def test_blank_names_are_refused_by_the_api(load):
    for name in ("", " ", "\t"):
        with pytest.raises(InputError, match="the name of an input is blank"):
            load(name)
