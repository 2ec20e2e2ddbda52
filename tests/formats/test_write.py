"""Names of outputs: what they mean, and which are refused before any work; one mesh out."""

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.write import Output, check_mesh_output, write_mesh
from cageik_cli.util.errors import InputError, MissingLibraryError, OutputError, SettingError
from tests.formats.written import write
from tests.shapes import ball


@pytest.mark.parametrize(
    ("name", "kind", "place"),
    [
        ("x/cage.npz", None, "x/cage.npz"),
        ("x/cage.PC2", None, "x/cage.PC2"),
        ("x/cage_####.obj", None, "x"),
        ("x/cage_####.obj", "obj", "x"),
        ("x.y/cage.$F4.ply", None, "x.y"),
        ("x/cage", None, "x/cage"),
        ("x/cage/", "ply", "x/cage"),
        ("x/cage.v2", "ply", "x/cage.v2"),
        ("x#/cage", None, "x#/cage"),
    ],
)
def test_what_is_written(name, kind, place):
    assert Output(Path(name), kind).target_path == Path(place)


@pytest.mark.parametrize(("kind", "files"), [(None, "obj"), ("obj", "obj"), ("ply", "ply")])
def test_a_folder_alone_gives_its_files_its_name(tmp_path, animation, kind, files):
    described = Animation(animation.rest, 5, Scene(start=0), "a")
    with Output(tmp_path / "v1.walk", kind or "obj").open_writer(described) as writer:
        writer.append(animation.frames)
    found = sorted(item.name for item in (tmp_path / "v1.walk").iterdir())
    assert found == [f"v1.walk_{k:04d}.{files}" for k in range(5)]


@pytest.mark.parametrize(
    ("name", "kind", "says"),
    [
        ("a.gif", None, "a.gif: `.gif`"),
        ("v1.walk", None, "v1.walk: `.walk`"),
        ("a_####", None, "a_####: ``"),
        ("a.obj", None, "a.obj: a `.obj` file holds one frame"),
        ("x/a_##.npz", None, "x/a_##.npz: a `.npz` file holds all frames"),
        ("x/a_##_##.obj", None, "x/a_##_##.obj: a_##_##.obj has 2"),
        ("x/a_##.ply", "obj", "x/a_##.ply: has another suffix than `file_format=obj`"),
        ("a.glb", "obj", "a.glb: has another suffix than `file_format=obj`"),
        ("a_####.obj", None, ".: is the current folder"),
        ("../a_####.obj", None, "..: is the current folder"),
        (".", None, ".: is the current folder"),
        ("no/where/a_#.obj", None, "no/where: the folder no does not exist; create it first"),
        ("there.txt/a_#.obj", None, "there.txt: is a file, expected the name of a folder"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_before_any_work(tmp_path, monkeypatch, name, kind, says):
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    Path("there.txt").write_text("")
    with pytest.raises(InputError) as caught:
        Output(Path(name), kind, True).check_writable()
    assert str(caught.value).startswith(says)
    assert [item.name for item in Path().iterdir()] == ["there.txt"]


@pytest.mark.parametrize(
    ("module", "name", "says"),
    [
        (
            "pygltflib",
            "a.glb",
            "a.glb: writing .glb needs pygltflib, which is not installed: pip install pygltflib",
        ),
        (
            "pxr",
            "a.usdc",
            "a.usdc: writing USD needs usd-core, which is not installed: pip install usd-core",
        ),
        (
            "alembic3d",
            "a.abc",
            "a.abc: writing .abc needs alembic3d, which is not installed: pip install alembic3d",
        ),
    ],
)
def test_a_library_that_is_missing_is_named_before_any_work(monkeypatch, module, name, says):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingLibraryError) as caught:
        Output(Path(name)).check_writable()
    assert str(caught.value) == says
    Output(Path("a.pc2")).check_writable()


def test_nothing_is_left_of_preparing(tmp_path):
    for name in ("a.glb", "a/a_#.obj", "b"):
        Output(tmp_path / name).check_writable()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "wrong", [{"start": -1.0}, {"start": 0.5}, {"frame_step": 0.5}, {"frame_step": 2.5}]
)
def test_files_are_numbered_by_whole_numbers(tmp_path, animation, wrong):
    ((name, value),) = wrong.items()
    with pytest.raises(SettingError, match=rf" {value:g}, .*`{name}=`"):
        write(tmp_path / "a/a_#.obj", animation.rest, animation.frames, scene=Scene(**wrong))
    assert not list(tmp_path.iterdir())


MESH = ball(levels=1)
MOVED = 2 * MESH.vertices + 1


@pytest.mark.parametrize("name", ["posed.obj", "posed.ply", "POSED.OBJ"])
def test_trimesh_reads_it(tmp_path, name):
    write_mesh(tmp_path / name, MESH, MOVED, overwrite=False)
    kind = name[-3:].lower()
    read = trimesh.load(tmp_path / name, file_type=kind, process=False, maintain_order=True)
    np.testing.assert_allclose(read.vertices, MOVED, rtol=1e-6, atol=0)
    np.testing.assert_array_equal(read.faces, MESH.faces)
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["posed.npz", "posed.abc", "posed", "posed.fbx"])
def test_files_that_hold_no_single_mesh_are_refused(tmp_path, name):
    with pytest.raises(OutputError, match=rf"{name}: .*expected \.obj, \.ply"):
        check_mesh_output(tmp_path / name, overwrite=False)


def test_what_is_there_is_kept(tmp_path):
    (tmp_path / "posed.obj").write_text("mine")
    for refused in (
        check_mesh_output,
        lambda path, overwrite: write_mesh(path, MESH, MOVED, overwrite),
    ):
        with pytest.raises(OutputError, match="exists already"):
            refused(tmp_path / "posed.obj", overwrite=False)
    assert (tmp_path / "posed.obj").read_text() == "mine"
