"""Every option that takes a mesh takes every format that holds one."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.find_files import clip_suffixes
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.write import Output, write_animation
from cageik_cli.geometry.parts import join_meshes
from cageik_cli.store.result import read_result
from cageik_cli.util.errors import CageError
from cageik_cli.util.progress import ProgressListener
from tests.formats.polygons import encode_polygons

KINDS = {
    "obj": ("rest.obj", "cage.obj"),
    "ply": ("rest.ply", "cage.ply"),
    "off": ("rest.off", "cage.off"),
    "stl": ("rest.stl", "cage.stl"),
    "usd": ("rest.usdc", "cage.usdc"),
    "usd path": ("rest.usdc::/hero/geo", "cage.usdc::/hero"),
    "abc": ("rest.abc", "cage.abc"),
    "glb": ("rest.glb", "cage.glb"),
    "npz": ("rest.npz", "cage.npz"),
    "result": ("cages.h5", "cages.h5"),
    "binding": ("binding.h5", "binding.h5"),
    "named": ("cages.h5::rest", "binding.h5::cage"),
}
READ = [kind for kind in KINDS if f".{kind}" != ".glb" or ".glb" in clip_suffixes()]


@pytest.fixture(scope="session")
def mesh_files(tmp_path_factory, tiny_files, animation):
    """A folder, read only, with the rest pose and the cage of the tiny clip in every format."""
    folder = tmp_path_factory.mktemp("meshes") / "all"
    shutil.copytree(tiny_files, folder, ignore=shutil.ignore_patterns("cache"))
    for name, mesh in (("rest", animation.rest), ("cage", animation.cage)):
        for kind in ("obj", "ply", "off"):
            data = encode_polygons(kind, mesh.vertices, mesh.faces)
            (folder / f"{name}.{kind}").write_bytes(data)
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        solid.export(folder / f"{name}.stl")
        for kind in ("usdc", "abc", "glb", "npz", "pc2", "mdd"):
            model = join_meshes([mesh], [f"/hero/geo/{name}"])
            moved = Animation(model, 2, Scene(), name)
            frames = np.stack([mesh.vertices, mesh.vertices + 1])
            path = folder / f"{name}.{kind}"
            write_animation(Output(path), moved, iter([frames]), ProgressListener())
    (folder / "handles.json").write_text(
        json.dumps({"handles": [{"name": "a", "vertex": 0, "offset": [0.1, 0, 0]}]})
    )
    return folder


@pytest.fixture
def meshes(monkeypatch, mesh_files, coarse_panels):
    """The current folder, with these files: read only."""
    monkeypatch.chdir(mesh_files)
    monkeypatch.setattr("cageik_cli.view.run.run_view", _end)


def _end(session, port, listener):
    raise KeyboardInterrupt


COMMANDS = {
    "extract": "extract frames --rest REST --cage CAGE -o OUT/new.h5",
    "repair": "cage --repair CAGE --rest REST -o OUT/new.obj",
    "check": "check --cage CAGE --rest REST",
    "bind": "bind --cage CAGE --rest REST -o OUT/new.h5",
    "pose": "pose REST handles.json --cage CAGE -o OUT/new.obj",
    "deform": "deform cages.h5 --mesh REST -o OUT/new.npz",
    "view": "view REST --cage CAGE",
    "info": "info REST",
}


def words(command, rest, cage, out="."):
    named = {"REST": rest, "CAGE": cage}
    return [named.get(word, word.replace("OUT", str(out))) for word in COMMANDS[command].split()]


def is_model(command, kind):
    """Whether REST is a model there: of a result, `pose` and `view` take the cage as well."""
    return command not in ("pose", "view") or kind not in ("result", "binding")


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("kind", READ)
def test_every_format_is_taken(run, meshes, tmp_path, animation, kind, command):
    if not is_model(command, kind):
        pytest.skip("a result or a binding is no model there")
    outcome = run(*words(command, *KINDS[kind], tmp_path))
    assert outcome.code == 0, outcome.err
    if command == "extract":
        result = read_result(tmp_path / "new.h5")
        np.testing.assert_allclose(result.rest.vertices, animation.rest.vertices, atol=1e-6)
        found, expected = (mesh.vertices[mesh.faces] for mesh in (result.cage, animation.cage))
        np.testing.assert_allclose(found, expected, atol=1e-6)
        names = [name.rpartition("/")[2] for name in KINDS[kind]]
        assert [result.sources[role]["name"].rpartition("/")[2] for role in ("rest", "cage")] == [
            _name_source(name, role) for name, role in zip(names, ("rest", "cage"), strict=True)
        ]
        assert all(len(result.sources[role]["sha256"]) == 64 for role in ("rest", "cage"))


def _name_source(name, role):
    return f"{name}::{role}" if name.endswith(".h5") else name


@pytest.mark.parametrize("name", ["rest.pc2", "rest.mdd"])
@pytest.mark.parametrize("command", COMMANDS)
def test_positions_without_faces_are_no_mesh(run, meshes, command, name):
    outcome = run(*words(command, name, "cage.obj"))
    if command == "info":
        assert "positions without faces" in outcome.out
        return
    assert outcome.code == 1
    assert outcome.err.splitlines()[-1].startswith(f"Error: {name}: holds no mesh, since it has no")


@pytest.mark.parametrize("kind", READ)
def test_a_cage_is_built_around_every_format(run, meshes, monkeypatch, kind):
    def build(mesh, *others, **options):
        raise CageError(f"model of {len(mesh.vertices)} vertices")

    monkeypatch.setattr("cageik_cli.cages.builder.build.build_cage", build)
    assert "model of 18 vertices" in run("cage", KINDS[kind][0], "-o", "built.obj").err


def test_no_part_of_a_result_has_another_name(run, meshes):
    outcome = run("check", "--cage", "cages.h5::model")
    assert outcome.code == 1
    assert "cages.h5: holds no mesh `model`; choose `rest` or `cage`" in outcome.err


def test_a_mesh_that_is_read_is_not_written_over(run, meshes):
    outcome = run("bind", "--cage", "cages.h5::cage", "--rest", "rest.obj", "-o", "cages.h5")
    assert outcome.code == 1
    assert "cages.h5: is read or written by this command already" in outcome.err


def test_the_first_of_several_frames_is_said_to_be_taken(run, meshes, tmp_path):
    outcome = run(*words("bind", "rest.abc", "cage.obj", tmp_path))
    assert "rest.abc: the first of its 2 frames is taken" in outcome.err


def test_frames_in_stl_have_the_errors_of_the_same_frames_in_obj(
    run, folder, mesh_files, animation
):
    Path("solids").mkdir()
    for k, vertices in enumerate(animation.frames, start=1):
        solid = trimesh.Trimesh(vertices, animation.rest.faces, process=False)
        solid.export(f"solids/frame_{k}.stl")
    assert run("extract", "frames", "--cage", "cage.obj", "-o", "obj.h5").code == 0
    expected = read_result(Path("obj.h5"))
    for name, rest in (("welded", ()), ("as rest", ("--rest", "frames/frame_1.obj"))):
        outcome = run(
            "extract", "solids", *rest, "--cage", mesh_files / "cage.stl", "-o", f"{name}.h5"
        )
        assert outcome.code == 0, outcome.err
        result = read_result(Path(f"{name}.h5"))
        tolerance = 1e-6 * expected.rest.diagonal
        np.testing.assert_allclose(result.metrics.rms, expected.metrics.rms, rtol=0, atol=tolerance)
        is_same = np.array_equal(result.rest.faces, expected.rest.faces)
        assert is_same == (name == "as rest")
