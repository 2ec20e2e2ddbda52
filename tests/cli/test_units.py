"""Units and axes: each path gives the right positions, or is refused with what to type.

A clip of a little model in a cage, in centimetres with z up, exists as OBJ, which states neither;
its result states both. What is given beside it is in other units and axes, in files that state
them (USD, glTF, .npz) or do not (OBJ, Alembic, PC2).
"""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.scene_conversion import UP_TURNS, SceneConversion
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.formats.write import Output
from cageik_cli.geometry.mesh import TriMesh
from tests.conftest import _use_coarse_panels, run_in_process
from tests.shapes import ball, box

for library in ("pxr", "pygltflib", "alembic3d"):
    pytest.importorskip(library)

FRAMES = 4
HERE = Scene(up_axis="Z", metres_per_unit=0.01)
"""The scene of the result."""


def make_rest() -> TriMesh:
    """A flat, tall body, no side of which is like another; cm, z up."""
    mesh = ball(levels=2, size=1.0)
    x, y, z = mesh.vertices.T
    vertices = np.stack([30 * x + 6 * z, 18 * y + 4 * x * z, 85 * z + 90], axis=1)
    return mesh.move(vertices)


def make_cage() -> TriMesh:
    return box(1.0).move(box(1.0).vertices * [36.0, 23.0, 92.0] + [0, 0, 90.0])


def bend(points: np.ndarray, frame: int) -> np.ndarray:
    x, y, z = points.T
    angle = 0.06 * frame * z / 90
    return np.stack([x + 20 * angle, y + z * np.sin(angle), z * np.cos(angle)], axis=1)


def write_clip(path, mesh: TriMesh, frames: np.ndarray, scene: Scene) -> str:
    """Write an animation as any writer does; without what the format cannot say of the scene."""
    output = Output(path)
    with output.open_writer(Animation(mesh, len(frames), scene, "mesh")) as writer:
        writer.append(np.asarray(frames))
    return str(path)


def write_mesh(path, mesh: TriMesh, scene: Scene) -> str:
    """Write a mesh at rest, converted from the scene of the result."""
    given = SceneHints(up_axis="Z", metres_per_unit=0.01)
    wanted = SceneHints(up_axis=scene.up_axis, metres_per_unit=scene.metres_per_unit)
    moved = SceneConversion.between(given, wanted).convert_mesh(mesh)
    if path.suffix == ".obj":
        lines = ["v {!r} {!r} {!r}".format(*vertex) for vertex in moved.vertices.tolist()]
        lines += ["f " + " ".join(map(str, face)) for face in (moved.faces + 1).tolist()]
        path.write_text("\n".join(lines) + "\n")
        return str(path)
    return write_clip(path, moved, moved.vertices[None], scene)


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """A folder with the clip, and its result."""
    folder = tmp_path_factory.mktemp("units")
    rest, cage = make_rest(), make_cage()
    with pytest.MonkeyPatch.context() as monkeypatch:
        _use_coarse_panels(monkeypatch)
        monkeypatch.setenv("CAGEIK_CACHE", str(folder / "cache"))
        monkeypatch.chdir(folder)
        frames = np.stack([bend(rest.vertices, k) for k in range(FRAMES)])
        write_clip(folder / "frames" / "frame_####.obj", rest, frames, HERE)
        write_clip(folder / "clip.usdc", rest, frames, HERE)
        write_mesh(folder / "cage.obj", cage, HERE)
        extract = ("extract", "frames", "--cage", "cage.obj", "-q")
        done = run_in_process(*extract, "--up-axis", "Z", "--metres-per-unit", "0.01")
        assert done.code == 0, done.err
        assert run_in_process("deform", "cages.h5", "-o", "expected.npz", "-q").code == 0
    return folder


@pytest.fixture
def here(prepared, tmp_path, monkeypatch, coarse_panels):
    """The current folder, with copies of these files."""
    shutil.copytree(prepared, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def read_positions(path) -> np.ndarray:
    return np.stack(list(open_sequence([str(path)])))


def is_near(found: np.ndarray, expected: np.ndarray) -> bool:
    """Whether positions are equal to 1e-6 of the diagonal."""
    diagonal = np.linalg.norm(np.ptp(expected[0], axis=0))
    return found.shape == expected.shape and np.abs(found - expected).max() <= 1e-6 * diagonal


def run_as_typed(run, option: str, *words: str, refused: str = ""):
    """Run a command; if it needs an option, it is refused first, and says what to type.

    The first cage that is `refused` may be another than the one beside the option.
    """
    if option:
        before = set(Path().rglob("*"))
        outcome = run(*(refused if refused and word == "same.obj" else word for word in words))
        assert outcome.code == 1
        assert option in outcome.err
        assert "missing" not in outcome.err
        assert set(Path().rglob("*")) == before
    done = run(*words, *option.split())
    assert done.code == 0, done.err
    return done


SCENES = {
    "m,y": Scene(metres_per_unit=1.0, up_axis="Y"),
    "m,z": Scene(metres_per_unit=1.0, up_axis="Z"),
    "cm,y": Scene(metres_per_unit=0.01, up_axis="Y"),
    "mm,z": Scene(metres_per_unit=0.001, up_axis="Z"),
    "in,y": Scene(metres_per_unit=0.0254, up_axis="Y"),
}

CONVERTED = {
    "cages": [
        *((".usdc", words, "") for words in SCENES),
        (".npz", "m,y", ""),
        (".abc", "m,z", "--from m"),
        (".abc", "m,y", "--from m,y"),
        (".abc", "cm,y", "--from cm,y"),
        (".pc2", "in,y", "--from in,y"),
        (".obj", "mm,z", "--from mm"),
    ],
    "rest": [
        (".usdc", "m,y", ""),
        (".usdc", "in,z", ""),
        (".glb", "cm,z", ""),
        (".obj", "m,z", "--from m"),
        (".obj", "m,y", "--from m,y"),
        (".obj", "mm,z", "--from mm"),
        (".obj", "cm,y", "--from cm,y"),
    ],
    "mesh": [
        (".usdc", "m,y", ""),
        (".glb", "cm,z", ""),
        (".obj", "m,z", "--from m"),
        (".obj", "mm,z", "--from mm"),
        (".obj", "cm,y", "--from cm,y"),
    ],
    "cage": [(".usdc", "in,y", ""), (".obj", "mm,z", "--from mm"), (".obj", "m,z", "--from m")],
}
"""What is given beside the clip or its result, in which format and scene, and what to type."""


@pytest.mark.parametrize(
    ("role", "suffix", "words", "option"),
    [(role, *case) for role, cases in CONVERTED.items() for case in cases],
)
def test_what_is_given_is_converted_or_refused_with_what_to_type(
    here, run, role, suffix, words, option
):
    if role == "cages":
        out = "edit/edit_####.obj" if suffix == ".obj" else f"edit{suffix}"
        assert run("export", "cages.h5", out, "--to", words, "-q").code == 0
        run_as_typed(run, option, "deform", "cages.h5", "--cages", out.split("/")[0], "-o", "n.npz")
    else:
        scene = SceneHints.parse(words).override(Scene())
        mesh = make_cage() if role == "cage" else make_rest()
        path = write_mesh(here / f"other{suffix}", mesh, scene)
        if role == "mesh":
            run_as_typed(run, option, "deform", "cages.h5", "--mesh", path, "-o", "n.npz")
        else:
            # What the file is in is not what the cage is in, which is taken as it stands.
            write_mesh(here / "same.obj", make_cage(), scene if option else HERE)
            given = ("--cage", path) if role == "cage" else ("--cage", "same.obj", "--rest", path)
            words = ("extract", "clip.usdc", *given, "-o", "new.h5")
            run_as_typed(run, option, *words, refused="cage.obj")
            assert run("deform", "new.h5", "-o", "n.npz", "-q").code == 0
    assert is_near(read_positions("n.npz"), read_positions("expected.npz"))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ([], "state it by --from 100"),  # the clip is taken for metres
        (["--metres-per-unit", "0.01"], "--from m"),
    ],
)
def test_a_clip_that_states_no_unit_can_be_given_one(here, run, options, expected):
    write_mesh(here / "rest.obj", make_rest(), SCENES["m,z"])
    words = ("extract", "frames", "--cage", "cage.obj", "--rest", "rest.obj", "-o", "new.h5")
    done = run(*words, *options)
    assert done.code == 1
    assert "in metres instead of centimetres" in done.err
    assert "--metres-per-unit 0.01 and --from m" in done.err or expected in done.err


def test_several_meshes_may_state_one_unit_in_two_ways(here, run):
    """In single precision, as USD from some programs has it."""
    rest, words = make_rest(), []
    for name, unit in (("a", 0.01), ("b", float(np.float32(0.01)))):
        path = write_clip(here / f"{name}.usda", rest, rest.vertices[None], HERE)
        text = (here / path).read_text()
        assert "metersPerUnit = 0.01" in text
        (here / path).write_text(text.replace("metersPerUnit = 0.01", f"metersPerUnit = {unit!r}"))
        words += ["--mesh", path]
    done = run("deform", "cages.h5", *words, "-o", "both.npz")
    assert done.code == 0, done.err
    assert "converted" not in done.err
    expected = read_positions("expected.npz")
    assert is_near(read_positions("both.npz"), np.concatenate([expected, expected], axis=1))


def test_a_file_that_states_a_wrong_unit_is_refused(here, run):
    """Numbers in cm, said to be metres: converted they do not fit."""
    cages = read_positions_of_cages(run)
    write_clip(here / "lie.usdc", make_cage(), cages, Scene(up_axis="Z", metres_per_unit=1.0))
    done = run("deform", "cages.h5", "--cages", "lie.usdc", "-o", "x.npz")
    assert done.code == 1
    assert "--from cm" in done.err
    assert run("deform", "cages.h5", "--cages", "lie.usdc", "-o", "x.npz", "--from", "cm").code == 0
    assert is_near(read_positions("x.npz"), read_positions("expected.npz"))


def read_positions_of_cages(run) -> np.ndarray:
    assert run("export", "cages.h5", "plain.npz", "-q").code == 0
    return read_positions("plain.npz")


def test_poses_props_and_turned_cages_are_taken(here, run):
    """What differs honestly: another pose, a turn about the up axis, a small prop, a large edit."""
    rest, cages = make_rest(), read_positions_of_cages(run)
    write_mesh(here / "posed.obj", rest.move(bend(rest.vertices, -2)), HERE)
    words = ("extract", "clip.usdc", "--cage", "cage.obj", "--outside", "project")
    assert run(*words, "--rest", "posed.obj", "-o", "posed.h5", "-q").code == 0
    prop = rest.move((rest.vertices - [0, 0, 90]) * 0.05 + [5, 4, 120])
    write_mesh(here / "prop.obj", prop, HERE)
    assert run("deform", "cages.h5", "--mesh", "prop.obj", "-o", "prop.npz", "-q").code == 0
    write_mesh(here / "small.obj", rest, SCENES["m,z"])  # in the cage, which is at the origin
    done = run("deform", "cages.h5", "--mesh", "small.obj", "-o", "small.npz", "-q")
    assert "in metres instead of centimetres" in done.err
    turn = np.array([[0, 1.0, 0], [-1, 0, 0], [0, 0, 1]])
    write_clip(here / "turned.pc2", make_cage(), cages @ turn * 1.3, HERE)
    assert run("deform", "cages.h5", "--cages", "turned.pc2", "-o", "turned.npz", "-q").code == 0
    lying = [bend(rest.vertices, k) @ UP_TURNS["Z", "Y"] for k in range(1, 4)]
    write_clip(here / "lying.usdc", rest, np.stack(lying), HERE)
    write_mesh(here / "rest.obj", rest, HERE)
    done = run("extract", "lying.usdc", "--cage", "cage.obj", "--rest", "rest.obj", "-o", "l.h5")
    assert done.code == 0
    assert "is likely with z up instead of y up" in done.err


TO = [
    ("deform", "out.usdc", "m,y"),
    ("deform", "out.npz", "mm"),
    ("deform", "out.abc", "ft,y"),
    ("deform", "out.glb", "m,y"),
    ("deform", "out.glb", "cm,z"),
    ("deform", "out.pc2", "dm,y"),
    ("export", "out.usdc", "in,y"),
    ("export", "out.glb", "km,z"),
]


@pytest.mark.parametrize(("command", "out", "words"), TO)
def test_outputs_are_converted(here, run, command, out, words):
    to = SceneHints.parse(words)
    assert run(command, "cages.h5", "plain.npz", "-q").code == 0 if command == "export" else True
    expected = read_positions("plain.npz" if command == "export" else "expected.npz")
    done = run(command, "cages.h5", *(["-o"] if command == "deform" else []), out, "--to", words)
    assert done.code == 0, done.err
    rest = make_cage() if command == "export" else make_rest()
    scene = Scene(up_axis="Y") if out.endswith(".glb") else to.override(HERE)
    wanted = SceneHints(up_axis=scene.up_axis, metres_per_unit=scene.metres_per_unit)
    given = SceneHints(up_axis="Z", metres_per_unit=0.01)
    write_mesh(here / "rest.obj", rest, scene)
    words = ["rest.obj"] if out.endswith(".pc2") else []
    from cageik_cli.formats.open import load_mesh

    loaded = load_mesh(here / words[0]) if words else None
    clip = open_sequence([out], rest=loaded)
    if out.endswith((".usdc", ".npz")):
        assert (clip.scene.metres_per_unit, clip.scene.up_axis) == (
            pytest.approx(scene.metres_per_unit, rel=1e-6),
            scene.up_axis,
        )
    found = np.stack(list(clip))
    tolerance = 1e-6 if not out.endswith(".glb") else 3e-6  # morph targets of single precision
    converted = SceneConversion.between(given, wanted).apply(expected)
    diagonal = np.linalg.norm(np.ptp(converted[0], axis=0))
    assert len(found) == FRAMES
    assert np.abs(found - converted).max() <= tolerance * diagonal


@pytest.mark.parametrize("to", [[], ["--to", "m,y"], ["--to", "cm,z"]])
def test_other_programs_read_gltf_at_the_right_size_and_upright(here, run, to):
    """The body is 170 cm high along z: 1.7 m along y for trimesh."""
    assert run("deform", "cages.h5", "-o", "out.glb", *to, "-q").code == 0
    scene = trimesh.load("out.glb", process=False)
    low, high = scene.bounds
    expected = SceneConversion((0.01, 1.0), ("Z", "Y")).apply(make_rest().vertices)
    np.testing.assert_allclose([low, high], [expected.min(axis=0), expected.max(axis=0)], atol=1e-5)


@pytest.mark.usefixtures("input_elsewhere")
@pytest.mark.parametrize(("joints", "near"), [("turn", 6e-3), ("translate", 2e-3)])
@pytest.mark.parametrize("suffix", [".usdc", ".glb"])
def test_skeletons_are_converted(here, run, suffix, joints, near):
    """A skeleton in another scene moves its mesh as the cages do."""
    words = ("--skeleton", "-q", "--influences", "8", "--joints", joints)
    assert run("export", "cages.h5", f"out{suffix}", "--to", "m,y", *words).code == 0
    assert run("export", "cages.h5", f"own{suffix}", *words).code == 0
    found, own = (np.stack(list(open_sequence([f"{name}{suffix}"]))) for name in ("out", "own"))
    scene = open_sequence([f"own{suffix}"]).scene
    wanted = SceneHints(up_axis="Y", metres_per_unit=1.0)
    expected = SceneConversion.between(scene, wanted).apply(own)
    np.testing.assert_allclose(found, expected, rtol=0, atol=3e-6)
    mesh = SceneConversion((0.01, 1.0), ("Z", "Y")).apply(read_positions("expected.npz"))
    np.testing.assert_allclose(found, mesh, rtol=0, atol=near)


def test_recentred_positions_and_their_offset_are_converted(here, run):
    words = ("deform", "cages.h5", "-o", "out.npz", "--to", "m,y", "--recentre", "-q")
    assert run(*words).code == 0
    offset = json.loads((here / "out.npz.offset.json").read_text())["offset"]
    expected = SceneConversion((0.01, 1.0), ("Z", "Y")).apply(read_positions("expected.npz"))
    np.testing.assert_allclose(read_positions("out.npz") + offset, expected, rtol=0, atol=1e-12)
    assert abs(np.array(offset)).max() == pytest.approx(0.9, abs=0.2)


def test_a_size_that_no_character_has_is_noted(here, run):
    """The clip in OBJ, without a unit, is said to be in metres by USD and glTF."""
    done = run("extract", "frames", "--cage", "cage.obj", "-o", "plain.h5")
    for shown in (done.err, run("info", "plain.h5").out, run("info", "frames").out):
        assert "184 m large" in shown
        assert "--metres-per-unit 0.01" in shown
    write_mesh(here / "right.usdc", make_rest(), HERE)
    for path in ("cages.h5", "right.usdc"):
        assert "large" not in run("info", path).out
    write_mesh(here / "plain.obj", make_rest(), HERE)
    assert "a unit is taken for 1 m, and so" in run("info", "plain.obj").out
    write_clip(here / "said.usdc", make_rest(), make_rest().vertices[None], Scene())
    assert "the file says that a unit is 1 m" in run("info", "said.usdc").out
    for out in ("out.usdc", "out.glb"):
        done = run("deform", "plain.h5", "-o", out)
        assert "184 m large" in done.err
        assert "--metres-per-unit 0.01" in done.err
    assert "large" not in run("deform", "plain.h5", "-o", "out.pc2").err
    assert "large" not in run("deform", "cages.h5", "-o", "right.usdc").err


@pytest.mark.parametrize("text", ["yard", "cm,x", "cm,", "0", "-1", "nan", "m,y,z"])
def test_a_unit_that_is_none_is_wrong_usage(here, run, text):
    done = run("export", "cages.h5", "out.usdc", "--to", text)
    assert done.code == 2
    assert text in done.err


def test_files_of_one_unit_are_both_converted_to_that_of_a_clip_without_one(here, run):
    """The clip is taken for metres, so what is given in centimetres becomes a hundredth."""
    for name, mesh in (("rest", make_rest()), ("cage", make_cage())):
        big = mesh.move(100 * mesh.vertices)
        write_mesh(here / f"{name}_cm.obj", big, HERE)
    words = ("extract", "frames", "--rest", "rest_cm.obj", "--cage", "cage_cm.obj")
    assert run(*words, "--from", "cm", "-o", "new.h5", "-q").code == 0
    assert run("deform", "new.h5", "-o", "new.npz", "-q").code == 0
    assert is_near(read_positions("new.npz"), read_positions("expected.npz"))
    assert open_sequence(["new.npz"]).scene.metres_per_unit == 1


@pytest.mark.parametrize("name", ["edit.npz", "edit.pc2"])
@pytest.mark.parametrize(
    ("factor", "turn", "typed"),
    [
        (10.0, None, "cm"),
        (0.1, None, "cm"),
        (2.54, None, "cm"),
        (1.0, ("Z", "Y"), "cm,z"),
    ],
)
def test_cages_that_are_meant_to_look_as_in_another_scene_can_be_said_to_be(
    here, run, name, factor, turn, typed
):
    """An animator scaled all by ten, or turned it: refused, until the option says what it is in."""
    matrix = factor * UP_TURNS.get(turn, np.eye(3))
    write_clip(here / name, make_cage(), read_positions_of_cages(run) @ matrix, HERE)
    deform = ("deform", "cages.h5", "--cages", name, "-o", "edited.npz")
    done = run(*deform)
    assert done.code == 1
    assert f"if it is meant to be so, by --from {typed}" in done.err
    done = run(*deform, "--from", typed)
    assert done.code == 0, done.err
    assert "warning" in done.err
    assert "as --from says" in done.err
    assert is_near(read_positions("edited.npz"), read_positions("expected.npz") @ matrix)


def test_what_is_said_of_several_files_is_of_those_that_state_nothing(here, run):
    """One --from for a mesh that states metres, and cages in inches that do not."""
    assert run("export", "cages.h5", "cages.pc2", "--to", "in,y", "-q").code == 0
    write_mesh(here / "stated.usdc", make_rest(), SCENES["m,y"])
    words = ("deform", "cages.h5", "--mesh", "stated.usdc", "--cages", "cages.pc2", "-o", "x.npz")
    done = run(*words)
    assert done.code == 1
    assert "--from in,y" in done.err
    done = run(*words, "--from", "in,y")
    assert done.code == 0, done.err
    assert is_near(read_positions("x.npz"), read_positions("expected.npz"))


def test_of_several_files_one_that_states_a_wrong_unit_is_refused(here, run):
    """The option would not change what it states, and is not offered."""
    cages = read_positions_of_cages(run)
    write_clip(here / "lie.usdc", make_cage(), cages, Scene(up_axis="Z", metres_per_unit=1.0))
    write_mesh(here / "rest.obj", make_rest(), HERE)
    words = ("deform", "cages.h5", "--mesh", "rest.obj", "--cages", "lie.usdc", "-o", "x.npz")
    for option in ((), ("--from", "cm")):
        done = run(*words, *option)
        assert done.code == 1
        assert "state it by" not in done.err
        assert "--from is for files that do not state it" in done.err


POSED = [
    (".usdc", "m,y", ""),
    (".usdc", "in,z", ""),
    (".glb", "m,y", ""),
    (".obj", "cm,z", ""),
    (".obj", "m,z", "--from cm"),
    (".obj", "m,y", "--from cm,z"),
    (".obj", "cm,y", "--from m,z"),
    (".obj", "mm,z", "--from 10"),
    (".ply", "m,y", "--from cm,z"),
]


@pytest.mark.parametrize(("suffix", "words", "option"), POSED)
def test_a_model_is_posed_in_the_cage_of_a_result_of_another_scene(
    here, run, suffix, words, option
):
    """The result states cm, z up; OBJ and PLY state nothing."""
    scene = SceneHints.parse(words).override(Scene())
    conversion = SceneConversion.between(HERE.space, scene.space)
    if suffix == ".ply":
        path = str(here / "model.ply")
        moved = conversion.convert_mesh(make_rest())
        trimesh.Trimesh(moved.vertices, moved.faces, process=False).export(path)
    else:
        path = write_mesh(here / f"model{suffix}", make_rest(), scene)
    write_mesh(here / "same.obj", make_rest(), HERE)
    pose = ["handles.json", "--cage", "cages.h5", "-o", "posed.obj", "--overwrite"]
    handles = {}
    for name, change in (("same.obj", SceneConversion()), (path, conversion)):
        offset = change.apply(np.array([5.0, 9, 3])).tolist()
        handles[name] = [{"name": "top", "vertex": 4, "offset": offset}]
        handles[name].append({"name": "foot", "vertex": 5, "pin": True})
        (here / "handles.json").write_text(json.dumps({"handles": handles[name]}))
        done = run("pose", name, *pose)
        if name == path and option:
            assert done.code == 1
            assert f"state it by {option}" in done.err
            done = run("pose", name, *pose, *option.split())
        assert done.code == 0, done.err
        positions = read_positions("posed.obj")
        if name == "same.obj":
            expected = conversion.apply(positions)
            assert np.abs(positions[0] - make_rest().vertices).max() > 5
    assert is_near(positions, expected)


@pytest.mark.parametrize("is_last", [True, False])
@pytest.mark.parametrize(
    ("words", "option"), [("m,z", "--from m"), ("mm,z", "--from mm"), ("cm,y", "--from cm,y")]
)
def test_of_several_meshes_the_one_in_another_unit_is_named(here, run, words, option, is_last):
    """Beside one that states inches: in metres it is small in the cage, in others outside."""
    write_mesh(here / "stated.usdc", make_rest(), SCENES["in,y"])
    write_mesh(here / "plain.obj", make_rest(), SceneHints.parse(words).override(Scene()))
    names = ["stated.usdc", "plain.obj"][:: 1 if is_last else -1]
    deform = ["deform", "cages.h5", "-o", "both.npz"]
    for name in names:
        deform += ["--mesh", name]
    done = run(*deform)
    assert done.code == 1
    assert re.search(r"plain\.obj: (is in|\d+ of 66)", done.err)
    assert f"state it by {option}" in done.err
    done = run(*deform, *option.split())
    assert done.code == 0, done.err
    expected = np.concatenate([read_positions("expected.npz")] * 2, axis=1)
    assert is_near(read_positions("both.npz"), expected)
