"""Parts below parts: no mesh is below another in USD, each is skinned, and read by its name."""

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from cageik_cli.formats.base.skeleton import Skin, compute_skin_weights
from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.usd import writer
from cageik_cli.geometry.parts import join_meshes
from tests.clips import frames_of
from tests.formats.clips import faults_of
from tests.formats.scenes import UsdScene, translation
from tests.shapes import box
from tests.texts import texts

CAGE = box(4.0)
SLIDE = np.linspace(0, 1, 5)[:, None, None]

TREES = {
    "wheel": ["/truck/body", "/truck/body/wheel"],
    "deep": ["/hero/body", "/hero/body/neck/head", "/hero/body/neck/head/hat", "/hero/shoe"],
    "top": ["/body", "/body/wheel", "/body/axle/wheel"],
    "alone at the top": ["/body", "/other"],
    "its own name": ["/a/body", "/a/body/body", "/a/body/body/body"],
    "taken": ["/a/body", "/a/body/bodyShape", "/a/body/bodyShape/wheel", "/a/body/bodyShape_2"],
    "beside transforms": ["/a/body", "/a/body/bodyShape/wheel"],
    "child first": ["/a/body/wheel", "/a/body"],
    "no scene": ["body", "body/wheel", "body 2", "body_2/wheel"],
    "materials": ["/a/b", "/a/materials/b", "/a/skeleton/b"],
    "cage": ["/cage/cage/wheel", "/cage/other"],
}


def make_model(names):
    """Boxes of the names, beside one another, each with a transform of its own."""
    meshes, transforms = [], []
    for k in range(len(names)):
        mesh = box(0.5)
        shift = np.array([0.7 * k - 1, 0.1 * k, 0])
        meshes.append(mesh.move(mesh.vertices + shift))
        turn = translation(*shift)
        turn[:2, :2] = [[0, 1], [-1, 0]]
        transforms.append(turn)
    return join_meshes(meshes, names, transforms)


def move(points):
    """Frames (5, m, 3) in which parts move apart."""
    return points * (1 + SLIDE * [1.0, 0.5, 0]) + SLIDE * [0, 0, 1.0]


def list_nested(path):
    """The meshes that are below a mesh."""
    stage = Usd.Stage.Open(str(path))
    prims = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    paths = {prim.GetPath() for prim in prims}
    return [path for path in paths if paths & set(path.GetPrefixes()[:-1])]


def write_skeleton(path, model, has_cage=False):
    """Write the model, moved by trilinear weights; return its frames, and the notes."""
    corners = CAGE.vertices
    weights = ((model.vertices[:, None] / corners + 1) / 2).prod(axis=2)
    animation = Animation(CAGE, 5, Scene(start=3.0), "cage", guide="cage" if has_cage else "")
    still = np.tile(np.eye(3), (5, 1, 1))
    skin = Skin(model, compute_skin_weights(weights), still, np.tile(np.eye(3), (5, 8, 1, 1)))
    made = writer.SkeletonWriter(path, animation, skin, has_cage=has_cage)
    cages = corners + SLIDE * np.random.default_rng(7).normal(0, 0.4, (8, 3))
    made.append(cages)
    made.complete()
    return weights @ cages, texts(made.notes)


@pytest.mark.parametrize("names", TREES.values(), ids=TREES)
@pytest.mark.parametrize("suffix", [".usdc", ".usdz"])
def test_no_mesh_of_a_cache_is_below_another(tmp_path, names, suffix):
    model, path = make_model(names), tmp_path / f"cache{suffix}"
    made = writer.Writer(path, Animation(model, 5, Scene(), "hero"))
    made.append(move(model.vertices))
    made.complete()
    assert list_nested(path) == []
    assert faults_of(path) == []
    again = open_sequence([str(path)])
    expected = writer.choose_prim_paths(names, "hero")
    assert sorted(again.first.attributes.parts.names) == sorted(expected)
    order = [again.first.attributes.parts.names.index(name) for name in expected]
    found = frames_of(again).reshape(5, len(names), -1, 3)[:, order].reshape(5, -1, 3)
    np.testing.assert_allclose(found, move(model.vertices), rtol=0, atol=1e-6)


@pytest.mark.parametrize("names", TREES.values(), ids=TREES)
@pytest.mark.parametrize("has_cage", [False, True])
def test_usd_itself_skins_every_part(tmp_path, names, has_cage):
    model, path = make_model(names), tmp_path / "rig.usdc"
    expected, notes = write_skeleton(path, model, has_cage)
    assert not notes
    assert list_nested(path) == []
    assert faults_of(path) == []
    stage = Usd.Stage.Open(str(path))
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetDefaultPrim()))
    bound = [p for p in stage.Traverse() if p.HasAPI(UsdSkel.BindingAPI) and p.IsA(UsdGeom.Mesh)]
    assert len(bound) == len(names)
    points = [UsdGeom.Mesh(prim).GetPointsAttr() for prim in bound]
    found = np.array([np.concatenate([each.Get(3 + k) for each in points]) for k in range(5)])
    by_place = [frame[np.lexsort(frame.round(4).T)] for frame in found]
    wanted = [frame[np.lexsort(frame.round(4).T)] for frame in expected]
    np.testing.assert_allclose(by_place, wanted, rtol=0, atol=1e-5)


def test_a_skin_that_usd_does_not_pose_is_measured(tmp_path, monkeypatch, file_faults):
    """As files were before, with meshes below meshes: the error is that of the file."""
    monkeypatch.setattr(writer, "place_meshes", lambda paths: paths)
    model, path = make_model(TREES["child first"]), tmp_path / "rig.usdc"
    expected, (note,) = write_skeleton(path, model)
    (fault,) = file_faults
    assert "ancestor prim that is also a Gprim" in fault
    file_faults.clear()
    apart = np.linalg.norm(expected - model.vertices, axis=2)
    apart[:, 8:] = 0  # the body
    rms, largest = np.sqrt(np.square(apart).mean()), apart.max()
    percent = 100 / model.diagonal
    assert note == (
        f"as USD poses the file, vertices are off by an rms of {percent * rms:.2g} % of the "
        f"diagonal, {percent * largest:.2g} % at most"
    )


def test_a_part_is_named_by_its_path_and_by_that_of_its_mesh(tmp_path):
    path = tmp_path / "rig.usdc"
    write_skeleton(path, make_model(TREES["deep"]))
    for member in ("/hero/body", "/hero/body/bodyShape", "body"):
        names = open_sequence([f"{path}::{member}"]).first.attributes.parts.names
        assert names == ("/hero/body", "/hero/body/neck/head", "/hero/body/neck/head/hat")
    (name,) = open_sequence([f"{path}::hat"]).first.attributes.parts.names
    assert name == "/hero/body/neck/head/hat"


def test_a_name_that_is_no_parents_alone_is_that_of_the_mesh(tmp_path):
    """At the top of a stage, below another mesh, or of two that state the same parent."""
    scene = UsdScene(tmp_path)
    scene.transform([np.eye(4)], "a")
    paths = ["/top", "/a/mesh", "/a/mesh/body", "/b/one", "/b/two", "/c/d/mesh"]
    for path in paths:
        scene.places[path] = path
        scene.places[None] = path.rpartition("/")[0]
        scene.mesh(path.rpartition("/")[2])
        if path != "/a/mesh":
            prim = scene.stage.GetPrimAtPath(Sdf.Path(path))
            prim.SetCustomDataByKey("isParentPart", True)
    names = scene.opened().first.attributes.parts.names
    assert sorted(names) == sorted([*paths[:-1], "/c/d"])
