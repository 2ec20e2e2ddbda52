"""Files as people bring them, kind by kind: each is read right, or a sentence says what it is.

Parts below parts, whose files USD poses, are in `tests/run/test_nested_parts.py`.
"""

import shlex
from pathlib import Path

import alembic3d  # noqa: F401  # before imath, which is its own
import numpy as np
import pytest
from alembic3d.AbcGeom import GeometryScope
from pxr import Usd, UsdGeom

from cageik_cli.formats.open import open_sequence
from cageik_cli.geometry.mesh import TriMesh
from tests.clips import frames_of
from tests.formats.gltf.built import Built
from tests.formats.scenes import FRAMES, AlembicScene, UsdScene
from tests.formats.test_alembic_surface import make_archive, make_uvs
from tests.formats.test_off import off
from tests.formats.test_other_geometry import SubdividedScene
from tests.formats.test_ply_layouts import QUAD_LISTS, make
from tests.formats.written import write
from tests.shapes import box, finer

BOX = box(1.0)
NOTHING = np.zeros((1, 0, 3), np.float32)


def write_box(path, mesh=BOX, shift=0.0):
    rows = [
        f"v {x:g} {y:g} {z:g}" for x, y, z in (mesh.vertices + np.array([shift, 0, 0])).tolist()
    ]
    rows += ["f " + " ".join(map(str, face)) for face in (mesh.faces + 1).tolist()]
    path.write_text("\n".join([*rows, ""]))


def series(*stems):
    """Write a box for each name, which moves on; others are of another model."""

    def write():
        for k, stem in enumerate(stems):
            write_box(Path(f"{stem}.obj"), shift=k / 10)
        return "."

    return write


def text(name, content):
    """Write a file of this content, a text or bytes."""

    def write():
        data = content if isinstance(content, bytes) else content.encode()
        Path(name).write_bytes(data)
        return name

    return write


def obj(more="", encoding="utf-8"):
    write_box(Path("plain.obj"))
    return (Path("plain.obj").read_text() + more).encode(encoding)


def write_turntable():
    scene = UsdScene(Path())
    scene.mesh(frames=FRAMES[:1])
    turn = UsdGeom.Xformable(scene.stage.GetPrimAtPath("/mesh")).AddRotateYOp()
    turn.Set(0.0, 0)
    turn.Set(90.0, 24)
    scene.stage.SetStartTimeCode(0)
    scene.stage.SetEndTimeCode(24)
    scene.stage.SetTimeCodesPerSecond(24)
    scene.close()
    return scene.path


def write_float_times():
    scene = UsdScene(Path())
    scene.mesh(times=[k * (1 + 5.2e-8) for k in (1, 2, 3, 4)])
    scene.close()
    return scene.path


def write_float_unit():
    path = Path("unit.usdc")
    scene = UsdScene(Path(), path.name)
    scene.mesh()
    scene.stage.GetRootLayer().pseudoRoot.SetInfo("metersPerUnit", 123.0)
    scene.close()
    del scene
    held = np.float32(123).tobytes() + bytes.fromhex("00000940")  # a double, in place
    single = np.float32(0.01).tobytes() + bytes.fromhex("00000840")
    path.write_bytes(path.read_bytes().replace(held, single))
    return path


def write_placeholder(scene):
    scene.mesh("body")
    scene.mesh("placeholder", frames=NOTHING, faces=[])
    scene.close()
    return scene.path


def write_sphere():
    scene = UsdScene(Path())
    scene.mesh("body")
    UsdGeom.Sphere.Define(scene.stage, "/eye")
    scene.close()
    return scene.path


def write_hair(*others):
    scene = SubdividedScene(Path())
    for name in others:
        scene.mesh(name)
    scene.subdivide()
    scene.close()
    return scene.path


def write_misstated_uvs():
    make_archive(Path("uvs.abc"), make_uvs(24, GeometryScope.kConstantScope))
    return "uvs.abc"


def write_variables():
    """A layer's variable names a file, which a stronger layer names otherwise."""
    scene = UsdScene(Path(), "man.usda")
    scene.mesh()
    scene.close()
    named = '@`"./${N}.usda"`@</mesh>'
    Path("mid.usda").write_text(
        '#usda 1.0\n( expressionVariables = { string N = "nobody" } )\n'
        f'def Mesh "mesh" ( references = {named} ) {{}}\n'
    )
    Path("outer.usda").write_text(
        '#usda 1.0\n( expressionVariables = { string N = "man" } )\n'
        'def Mesh "mesh" ( references = @./mid.usda@</mesh> ) {}\n'
    )
    return "outer.usda"


def write_teapots():
    """Two instances on the graphics processor, whose mesh is in the file once."""
    file = Built()
    attributes = {"POSITION": file.array(BOX.vertices)}
    primitive = {"attributes": attributes, "indices": file.array(BOX.faces.ravel(), "H")}
    places = file.array([[0, 0, 0], [5, 0, 0]])
    held = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}}
    file.add("nodes", {"mesh": file.add("meshes", {"primitives": [primitive]}), "extensions": held})
    return file.save(Path("teapots.glb"))


def write_reference(kind):
    """A layer that draws a file in which is not there."""

    def write():
        Path("shot.usda").write_text(
            {
                "reference": '#usda 1.0\ndef "man" ( references = @./gone/man.usd@ ) {}\n',
                "payload": '#usda 1.0\ndef "man" ( payload = @./gone/man.usd@ ) {}\n',
                "sublayer": "#usda 1.0\n( subLayers = [@./gone/man.usd@] )\n",
            }[kind]
        )
        return "shot.usda"

    return write


def write_curves():
    scene = UsdScene(Path())
    UsdGeom.BasisCurves.Define(scene.stage, "/hair")
    scene.close()
    return scene.path


def write_nothing():
    scene = UsdScene(Path())
    scene.mesh("placeholder", frames=NOTHING, faces=[])
    scene.close()
    return scene.path


def write_stride():
    """An animation whose keys lie further apart than any number of the machine."""
    file = Built()
    attributes = {"POSITION": file.array(BOX.vertices)}
    primitive = {"attributes": attributes, "indices": file.array(BOX.faces.ravel(), "H")}
    file.add("meshes", {"primitives": [primitive]})
    file.add("nodes", {"mesh": 0})
    file.animate("", (0, "translation", np.arange(2), np.zeros((2, 3)), "LINEAR"))
    file.json["bufferViews"][-2]["byteStride"] = 10**25
    return file.save(Path("stride.glb"))


STAMPS = [f"cap_2024-01-05_12-{30 + k // 60}-{k % 60:02d}" for k in range(57, 63)]

RIGHT = {
    "a copy of a browser": (
        series(*(f"walk_{k:04d}" for k in range(1, 7)), "walk_0003 (1)"),
        ["6, walk_0001.obj to walk_0006.obj", "from frame 1", "walk_0003 (1).obj"],
    ),
    "copies of a desktop, of a cloud, of an editor": (
        series(
            *(f"walk_{k:04d}" for k in range(1, 7)),
            "walk_0003 - Kopie",
            "walk_0002 (conflicted copy)",
            "walk_0004.bak",
            "walk_rest",
        ),
        ["6, walk_0001.obj to walk_0006.obj", "from frame 1", "and 1 more"],
    ),
    "a number and a time": (
        series(*(f"cap_{k + 1:05d}_t{k / 30:.3f}" for k in range(6)), "rest"),
        ["6, cap_00001_t0.000.obj to cap_00006_t0.167.obj", "from frame 1", "rest.obj"],
    ),
    "fractions": (
        series("sim_0.05", "sim_0.1", "sim_0.15", "sim_0.2", "sim_0.25", "sim_0.3"),
        ["6, sim_0.05.obj to sim_0.3.obj"],
    ),
    "a dash of all names": (
        series(*(f"take -{k:03d}" for k in range(1, 5))),
        ["4, take -001.obj to take -004.obj", "from frame 1"],
    ),
    "time stamps over a minute": (
        series(*STAMPS),
        [f"6, {STAMPS[0]}.obj to {STAMPS[-1]}.obj"],
    ),
    "a turntable of two keys": (write_turntable, ["25, clip.usda[0] to clip.usda[24]"]),
    "times in single precision": (write_float_times, ["4, clip.usda[1] to clip.usda[4]"]),
    "a unit in single precision": (write_float_unit, ["0.01 m per unit"]),
    "a placeholder in USD": (
        lambda: write_placeholder(UsdScene(Path())),
        ["1 part", "left out /placeholder (no points or no faces)"],
    ),
    "a placeholder in Alembic": (
        lambda: write_placeholder(AlembicScene(Path())),
        ["1 part", "left out /placeholder (no points or no faces)"],
    ),
    "a sphere beside a mesh": (write_sphere, ["1 part", "1 Sphere (/eye)"]),
    "a surface to subdivide": (write_hair, ["1 part", "scheme"]),
    "a surface to subdivide beside a mesh": (lambda: write_hair("body"), ["2 parts"]),
    "UVs of another scope": (
        write_misstated_uvs,
        ["texture coordinates", "24 values of its surface are stated as kConstantScope"],
    ),
    "variables of a stronger layer": (write_variables, ["4, outer.usda[1] to outer.usda[4]"]),
    "instances of a glTF file": (write_teapots, ["16", "/node_0/instance_1"]),
    "strips of PLY": (text("strips.ply", make()), ["12 of 12 polygons"]),
    "lists of vertices of PLY": (
        text(
            "lists.ply",
            make(lists=None, neighbours=[[1, 2], [], [3]], faces=QUAD_LISTS),
        ),
        ["8", "12 of 6 polygons"],
    ),
    "OFF, glued": (text("a.off", off("OFF8 6 12\n")), ["12 of 6 polygons"]),
    "OFF with a mark": (text("a.off", "\ufeff" + off()), ["12 of 6 polygons"]),
    "OFF in Latin-1": (
        text("a.off", off("OFF\n# W\u00fcrfel\n8 6 12\n").encode("latin-1")),
        ["12 of 6 polygons"],
    ),
    "OFF over lines": (text("a.off", off("OFF\n8\n6\n12\n")), ["12 of 6 polygons"]),
    "a face of two corners": (
        lambda: text("edge.obj", obj("f 1 2\n"))(),
        ["8", "1 face of fewer than 3 corners left out"],
    ),
    "UTF-16": (lambda: text("wide.obj", obj(encoding="utf-16"))(), ["closed, volume 8"]),
}
"""What writes the input and returns its name, and what `info` says of it."""


@pytest.mark.parametrize(("write", "says"), RIGHT.values(), ids=RIGHT)
def test_what_is_sound_is_read(run, tmp_path, monkeypatch, write, says):
    monkeypatch.chdir(tmp_path)
    outcome = run("info", str(write()))
    assert outcome.code == 0, outcome.err
    for words in says:
        assert words in outcome.out


LODS = series(*(f"walk_{k:04d}{end}" for k in range(1, 7) for end in ("", "_lod1")))

REFUSED = {
    "a stride beyond its view": (write_stride, "byteStride is 1"),
    "hair alone, as curves": (write_curves, "holds no mesh, but 1 BasisCurves (/hair)"),
    **{
        f"a missing {kind}": (write_reference(kind), "gone/man.usd")
        for kind in ("reference", "payload", "sublayer")
    },
    "a pointer of Git LFS": (
        text("man.glb", "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"),
        "man.glb: is a pointer of Git LFS",
    ),
    "a placeholder alone": (write_nothing, "/placeholder: the mesh has no points"),
    "OFF of a point less": (text("a.off", off("OFF\n9 6 12\n")), "a.off: "),
}
"""What writes the input and returns its name, and what `info` says of it."""


@pytest.mark.parametrize(("write", "says"), REFUSED.values(), ids=REFUSED)
def test_what_is_not_sound_is_refused_in_a_sentence(run, tmp_path, monkeypatch, write, says):
    monkeypatch.chdir(tmp_path)
    outcome = run("info", str(write()))
    assert outcome.code == 1
    assert says in outcome.err
    assert "internal error" not in outcome.err


def test_models_of_less_detail_beside_frames_are_a_choice_of_globs_that_work(
    run, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    LODS()
    outcome = run("info", ".")
    assert outcome.code == 1
    assert "holds 2 series of numbered meshes, walk_*, walk_*_lod1" in outcome.err
    globs = [word for word in shlex.split(outcome.err) if word.endswith(".obj")]
    assert len(globs) == 2
    for glob in globs:
        found = run("info", glob)
        assert found.code == 0
        assert "  frames         6, walk_0001" in found.out


def test_a_turntable_is_the_scene_between_its_keys(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write_turntable()
    found = frames_of(open_sequence([str(path)]))
    stage = Usd.Stage.Open(str(path))
    for time in (0, 7, 12, 24):
        matrix = np.array(
            UsdGeom.Xformable(stage.GetPrimAtPath("/mesh")).ComputeLocalToWorldTransform(time)
        )
        expected = FRAMES[0] @ matrix[:3, :3] + matrix[3, :3]
        np.testing.assert_allclose(found[time], expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".usdc", ".abc"])
def test_a_model_that_is_split_at_its_edges_does_not_crack(
    run, tmp_path, monkeypatch, coarse_panels, suffix
):
    """Each face has vertices of its own, which a fit follows as those of one surface."""
    monkeypatch.chdir(tmp_path)
    whole = finer(BOX, 2)
    corners = whole.faces.ravel()
    split = TriMesh(whole.vertices[corners], np.arange(len(corners)).reshape(-1, 3))
    x, y, z = split.vertices.T
    frames = [split.vertices + np.stack([k * z**2, k * x, 0 * y], 1) / 30 for k in range(6)]
    is_series = suffix in (".obj", ".ply")
    path = Path(f"split/split_####{suffix}" if is_series else f"split{suffix}")
    write(path, split, np.array(frames))
    write_box(Path("cage.obj"), BOX.move(1.6 * BOX.vertices))
    given = "split" if is_series else f"split{suffix}"
    words = ("extract", given, "--cage", "cage.obj", "--fit", "-o", "s.h5", "-v")
    outcome = run(*words)
    assert outcome.code == 0, outcome.err
    places = len(whole.vertices)
    assert f"{len(corners)} vertices at {places} places never come apart" in outcome.err
    assert run("deform", "s.h5", "-o", "s.npz", "-q").code == 0
    with np.load("s.npz") as moved:
        found = moved["vertices"]
    for vertex in range(places):
        copies = found[:, corners == vertex]
        np.testing.assert_array_equal(copies, np.broadcast_to(copies[:, :1], copies.shape))


def test_a_number_sign_is_a_character_of_a_name(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("shot#3").mkdir()
    series("walk_1", "walk_2")()
    write_box(Path("cage.obj"), BOX.move(1.6 * BOX.vertices))
    result = "shot#3/cage#1.h5"
    assert run("extract", "walk_1.obj", "walk_2.obj", "--cage", "cage.obj", "-o", result).code == 0
    for name in ("shot#3/cage#1.usdc", "take#4/cage_##.obj"):
        assert run("export", result, name).code == 0
    assert run("deform", result, "-o", "moved#2.npz").code == 0
    found = sorted(str(path) for folder in ("shot#3", "take#4") for path in Path(folder).iterdir())
    assert found[:2] == ["shot#3/cage#1.h5", "shot#3/cage#1.usdc"]
    assert found[2:] == ["take#4/cage_01.obj", "take#4/cage_02.obj"]
    assert Path("moved#2.npz").is_file()
