"""A cache in USD lies over the asset that it came from: what is drawn is the cache."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade, UsdSkel

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.usd.writer import Writer
from cageik_cli.geometry.parts import split_parts
from tests.clips import frames_of
from tests.formats.clips import faults_of
from tests.formats.scenes import FRAMES, UsdScene, translation
from tests.formats.usd.rigs import Rig, transform

TURN = np.array([[0, 1.0, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [3, 0, 0, 1]])


def write_scene(folder):
    """Meshes below transforms that move, one of them below another, and one that is left out."""
    scene = UsdScene(folder, "asset.usda")
    scene.transform([TURN @ translation(k, 0, 0) for k in range(4)], "hero")
    scene.mesh("body", "hero").AddScaleOp().Set((1, 2, 1))
    scene.transform([TURN], "head", "body")
    scene.mesh("hat", "head")
    scene.mesh("still", "hero", frames=FRAMES[:1])
    scene.mesh("hair", "hero")
    scene.close()
    return scene.path


def write_rig(folder):
    """A mesh that is moved by joints and blend shapes."""
    rig = Rig(folder, "asset.usda")
    rig.skin()
    rig.animate()
    rig.shape()
    return rig.save()


def write_instances(folder):
    """Two instances of a rig."""
    stage = Usd.Stage.CreateNew(str(folder / "asset.usda"))
    rig = Rig(folder, "rig.usda")
    rig.skin()
    rig.animate()
    rig.save()
    for k in range(2):
        above = UsdGeom.Xform.Define(stage, f"/at_{k}")
        above.AddTranslateOp().Set((5.0 * k, 0, 0))
        copy = stage.DefinePrim(f"/at_{k}/copy")
        copy.GetReferences().AddReference("rig.usda", "/hero")
        copy.SetInstanceable(True)
    stage.GetRootLayer().Save()
    return folder / "asset.usda"


def write_cache(asset):
    """Read the asset, and write its frames, lifted by 10; returns them, and the names of parts."""
    sequence = open_sequence([str(asset)])
    frames = frames_of(sequence) + np.array([0, 0, 10.0])
    writer = Writer(
        asset.parent / "cache.usdc", Animation(sequence.first, len(frames), Scene(), "x")
    )
    writer.append(frames)
    writer.complete()
    return frames, sequence.first.attributes.parts


def list_drawn(stage, name, times):
    """The points of a mesh in the space of the stage, as USD draws them without a skin."""
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(name))
    if not mesh:  # other parts are below it
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"{name}/{name.rpartition('/')[2]}Shape"))
    assert mesh
    assert not mesh.GetPrim().IsInstanceProxy()
    assert not UsdSkel.Root.Find(mesh.GetPrim())
    points = mesh.GetPointsAttr()
    return [
        transform(np.array(points.Get(time)), np.array(mesh.ComputeLocalToWorldTransform(time)))
        for time in times
    ]


@pytest.mark.parametrize("write", [write_scene, write_rig, write_instances])
@pytest.mark.parametrize("is_over", [False, True])
def test_a_cache_is_drawn_alone_and_over_its_asset(tmp_path, write, is_over):
    asset = write(tmp_path)
    frames, parts = write_cache(asset)
    shot = tmp_path / "shot.usda"
    stage = Usd.Stage.CreateNew(str(shot))
    stage.GetRootLayer().subLayerPaths[:] = ["cache.usdc"] + ["asset.usda"] * is_over
    stage.GetRootLayer().Save()
    start = 0
    for name, count in zip(parts.names, parts.vertex_counts, strict=True):
        drawn = list_drawn(stage, name, range(1, len(frames) + 1))
        np.testing.assert_allclose(drawn, frames[:, start : start + count], rtol=0, atol=4e-6)
        start += count
    sequence = open_sequence([str(shot)])
    assert sequence.first.attributes.parts.names == parts.names
    np.testing.assert_allclose(frames_of(sequence), frames, rtol=0, atol=4e-6)


def test_what_a_cache_leaves_out_stays_where_it_is(tmp_path):
    asset = write_scene(tmp_path)
    before = frames_of(open_sequence([f"{asset}::/hero/hair"]))
    sequence = open_sequence([f"{asset}::/hero/body"])
    assert sequence.first.attributes.parts.names == ("/hero/body", "/hero/body/head/hat")
    writer = Writer(tmp_path / "cache.usdc", Animation(sequence.first, 4, Scene(), "x"))
    writer.append(frames_of(sequence))
    writer.complete()
    stage = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    stage.GetRootLayer().subLayerPaths[:] = ["cache.usdc", "asset.usda"]
    stage.GetRootLayer().Save()
    after = frames_of(open_sequence([f"{tmp_path / 'shot.usda'}::/hero/hair"]))
    np.testing.assert_array_equal(after, before)


def find_material(stage, path):
    """The path of the material that is bound to a prim."""
    binding = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(path))
    return str(binding.ComputeBoundMaterial()[0].GetPath())


@pytest.mark.parametrize("is_referenced", [False, True])
def test_an_asset_keeps_its_materials_and_the_cache_alone_has_its_own(tmp_path, is_referenced):
    """The body has a material, and the hat two for its faces; the asset may be a reference."""
    scene = UsdScene(tmp_path, "asset.usda")
    scene.transform([np.eye(4)], "hero")
    paths = ["/hero/body", "/hero/hat/top", "/hero/hat/brim"]
    body, hat = (scene.mesh(name, "hero") for name in ("body", "hat"))
    top, brim = (
        UsdShade.MaterialBindingAPI.Apply(hat.GetPrim()).CreateMaterialBindSubset(name, faces)
        for name, faces in (("top", [0, 1, 2]), ("brim", [3, 4, 5, 6, 7]))
    )
    for prim, name in ((body, "skin"), (top, "top"), (brim, "brim")):
        material = UsdShade.Material.Define(scene.stage, f"/hero/looks/{name}")
        UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(material)
    scene.close()
    if is_referenced:
        UsdScene(tmp_path, "shot.usda").close()
        shot = Usd.Stage.Open(str(tmp_path / "shot.usda"))
        shot.DefinePrim("/hero").GetReferences().AddReference("asset.usda", "/hero")
        shot.GetRootLayer().Save()
        scene.path = tmp_path / "shot.usda"
    write_cache(scene.path)
    over = Usd.Stage.CreateNew(str(tmp_path / "over.usda"))
    over.GetRootLayer().subLayerPaths[:] = ["cache.usdc", scene.path.name]
    found = [find_material(over, path) for path in paths]
    assert found == [f"/hero/looks/{name}" for name in ("skin", "top", "brim")]
    alone = Usd.Stage.Open(str(tmp_path / "cache.usdc"))
    found = [find_material(alone, path) for path in paths]
    assert found == [f"/hero/cache_materials/{name}" for name in ("skin", "top", "brim")]
    again = split_parts(open_sequence([str(tmp_path / "cache.usdc")]).first)
    first = split_parts(open_sequence([str(scene.path)]).first)
    for mine, part in zip(again, first, strict=True):
        look, expected = mine.mesh.attributes.materials, part.mesh.attributes.materials
        assert look.names == expected.names
        np.testing.assert_array_equal(look.indices, expected.indices)
    assert faults_of(tmp_path / "cache.usdc") == []
