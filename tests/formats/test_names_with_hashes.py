"""A lone `#` is a character of a name of an output; `####` is the place of frame numbers."""

from pathlib import Path

import pytest

from cageik_cli.formats.write import Output
from cageik_cli.util.errors import OutputError
from tests.refusals import refused

NAMES = {
    "shot#3": ("shot#3", "shot#3_0007.obj"),
    "shot#3/a_####.obj": ("shot#3", "a_0007.obj"),
    "take #1_####.ply": (".", "take #1_0007.ply"),
    "#1": ("#1", "#1_0007.obj"),
    "C#": ("C#", "C#_0007.obj"),
    "cage#.obj": (".", "cage7.obj"),
    "cage_#.obj": (".", "cage_7.obj"),
    "cage_##.obj": (".", "cage_07.obj"),
    "cage#1.usdc": ("cage#1.usdc", None),
    "cage#.usdc": ("cage#.usdc", None),
    "C#.abc": ("C#.abc", None),
    "#.glb": ("#.glb", None),
    "cage #2.MDD": ("cage #2.MDD", None),
}


@pytest.mark.parametrize("name", NAMES)
def test_what_a_name_means(name):
    target, file = NAMES[name]
    output = Output(Path(name))
    assert output.target_path == Path(target)
    names = output.frame_names
    assert (None if names is None else names.file_name(7)) == file


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("shot####", "have no suffix, which is their format; add one, such as shot####.obj"),
        ("shot_%04d", "have no suffix"),
        ("shot_####.usdc", "a `.usdc` file holds all frames; remove the frame number"),
        ("shot_%d.usdc", "a `.usdc` file holds all frames"),
        ("cage#1.obj", "a `.obj` file holds one frame; name files in a folder"),
        ("shot.xyz", "`.xyz` is not an animation format"),
    ],
)
def test_what_means_nothing_is_refused(name, says):
    with refused(OutputError, says, at=name):
        Output(Path(name)).find_writer()


@pytest.mark.parametrize("name", ["shot#3", "cage#1.usdc", "shot#3/cage_####.ply", "C#.glb"])
def test_such_names_are_written(name, tiny_result, tmp_path, monkeypatch, run):
    monkeypatch.chdir(tmp_path)
    outcome = run("export", tiny_result, name, "-q")
    assert outcome.code == 0, outcome
    assert (tmp_path / name).exists() or (tmp_path / "shot#3" / "cage_0001.ply").exists()
    assert run("export", tiny_result, name, "-q", "--overwrite").code == 0
