"""Which meshes of a stage are seen: purposes, visibility, instances and point instancers."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.usd.writer import Writer
from tests.clips import frames_of
from tests.formats.scenes import FRAMES, UsdScene, translation
from tests.texts import texts


@pytest.fixture
def scene(tmp_path):
    """A mesh that is seen, and a hat."""
    built = UsdScene(tmp_path)
    built.mesh()
    built.transform([translation(0, 0, 2)], "head")
    built.hat = built.mesh("hat", "head")
    return built


def read(scene, member=""):
    sequence = scene.opened(member)
    names = sequence.first.attributes.parts.names
    return names, [note.removeprefix("clip.usda: ") for note in texts(sequence.notes)]


@pytest.mark.parametrize("purpose", ["guide", "proxy"])
def test_a_mesh_of_another_purpose_is_left_out(scene, purpose):
    scene.hat.CreatePurposeAttr("render")
    assert read(scene)[0] == ("/mesh", "/head/hat")
    UsdGeom.Imageable(scene.stage.GetPrimAtPath("/head")).CreatePurposeAttr(purpose)
    assert read(scene)[0] == ("/mesh", "/head/hat")  # its own purpose is stronger
    scene.hat.GetPrim().RemoveProperty("purpose")
    names, notes = read(scene)
    assert (names, notes[0]) == (("/mesh",), f"left out /head/hat (purpose {purpose})")
    assert read(scene, "::/head/hat")[0] == ("/head/hat",)


def set_visibility(prim, values):
    """Set "invisible" or "inherited" at times, or for all times."""
    attribute = UsdGeom.Imageable(prim).CreateVisibilityAttr()
    for time, value in values.items():
        attribute.Set(value, time)


DEFAULT = Usd.TimeCode.Default()


@pytest.mark.parametrize(
    ("place", "values", "note"),
    [
        ("/head/hat", {DEFAULT: "invisible"}, "left out /head/hat (invisible)"),
        ("/head", {DEFAULT: "invisible"}, "left out /head/hat (invisible)"),
        (
            "/head/hat",
            {1: "invisible", 3: "inherited"},
            "left out /head/hat (invisible until time 3)",
        ),
        ("/head", {1: "invisible", 2: "inherited"}, "left out /head/hat (invisible until time 2)"),
        (
            "/head/hat",
            {1: "inherited", 3: "invisible"},
            "/head/hat: invisible at time 3, but read in all frames",
        ),
    ],
)
def test_a_mesh_that_is_hidden_at_first_is_left_out(scene, place, values, note):
    set_visibility(scene.stage.GetPrimAtPath(place), values)
    names, notes = read(scene)
    assert note in notes
    assert names == (("/mesh",) if "left out" in note else ("/mesh", "/head/hat"))


def test_hidden_meshes_are_read_if_there_are_no_others(scene):
    for path in ("/mesh", "/head"):
        set_visibility(scene.stage.GetPrimAtPath(path), {DEFAULT: "invisible"})
    names, notes = read(scene)
    assert names == ("/mesh", "/head/hat")
    assert notes[0] == "no other mesh than /mesh, /head/hat (invisible)"


@pytest.mark.parametrize("is_below", [False, True])
def test_prototypes_of_a_point_instancer_are_left_out(scene, is_below):
    """They are drawn at its points only, wherever they are."""
    trees = UsdGeom.PointInstancer.Define(scene.stage, "/trees")
    scene.places["trees"] = "/trees"
    scene.places["forms"] = "/forms"
    scene.mesh("leaf", "trees" if is_below else "forms", frames=FRAMES[:1])
    path = "/trees/leaf" if is_below else "/forms/leaf"
    trees.CreatePrototypesRel().SetTargets([path if is_below else "/forms"])
    trees.CreateProtoIndicesAttr([0, 0, 0])
    trees.CreatePositionsAttr([(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    names, notes = read(scene)
    assert names == ("/mesh", "/head/hat")
    assert notes[0] == (
        f"left out {path} (of the point instancer /trees, whose 3 instances are not read: make "
        "them meshes)"
    )
    assert read(scene, f"::{path}")[0] == (path,)
    scene.stage.RemovePrim("/trees")
    if not is_below:
        assert path in read(scene)[0]


def test_instances_are_placed_and_written_under_their_own_paths(tmp_path):
    """Two instances of a prim, of which one is in an instance itself."""
    scene = UsdScene(tmp_path)
    scene.places["proto"] = str(scene.stage.CreateClassPrim("/proto").GetPath())
    scene.transform([translation(1, 0, 0)], "move", "proto")
    scene.mesh("mesh", "move")
    scene.places["outer"] = str(scene.stage.CreateClassPrim("/outer").GetPath())
    inner = scene.stage.DefinePrim("/outer/inner", "Xform")
    UsdGeom.Xformable(inner).AddTranslateOp().Set((0, 0, 5))
    for prim, source in ((inner, "/proto"), (scene.stage.DefinePrim("/b", "Xform"), "/outer")):
        prim.GetReferences().AddInternalReference(source)
        prim.SetInstanceable(True)
    one = scene.stage.DefinePrim("/a", "Xform")
    one.GetReferences().AddInternalReference("/proto")
    one.SetInstanceable(True)
    UsdGeom.Xformable(one).AddTranslateOp().Set((0, 7, 0))
    sequence = scene.opened()
    parts, frames = sequence.first.attributes.parts, frames_of(sequence)
    assert parts.names == ("/b/inner/move/mesh", "/a/move/mesh")
    expected = [FRAMES + np.array([1.0, 0, 5]), FRAMES + np.array([1.0, 7, 0])]
    np.testing.assert_allclose(frames, np.concatenate(expected, axis=1), rtol=1e-15)
    writer = Writer(tmp_path / "out.usdc", Animation(sequence.first, len(frames), Scene(), "x"))
    writer.append(frames)
    writer.complete()
    again = open_sequence([str(tmp_path / "out.usdc")])
    assert again.first.attributes.parts.names == parts.names
    np.testing.assert_array_equal(again.first.attributes.parts.transforms, parts.transforms)
    np.testing.assert_allclose(frames_of(again), frames, rtol=0, atol=1e-6)
