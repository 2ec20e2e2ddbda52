"""Materials and texture coordinates: vertices are cut at seams, and move as they did."""

from functools import partial

import numpy as np
import pytest
import trimesh

from cageik_cli.formats.base.settings import MorphSettings
from cageik_cli.formats.base.writer import Animation
from cageik_cli.formats.gltf.surface import Appearance, Material, cut_surface
from cageik_cli.formats.gltf.writer import Writer
from cageik_cli.formats.scene import Scene
from cageik_cli.formats.write import open_writer
from tests.formats.gltf.decoded import Glb

RED, GLASS = Material("red", (1, 0, 0, 1)), Material("glass", (0.1, 0.2, 0.3, 0.5))
RANDOM = np.random.default_rng(2)


def save(path, animation, appearance, has_normals=True):
    described = Animation(
        animation.rest, 5, Scene(), "thing", morphs=MorphSettings(has_normals=has_normals)
    )
    with open_writer(path, described, False, None, partial(Writer, appearance=appearance)) as out:
        out.append(animation.frames)
    return Glb(path)


def test_each_material_has_its_triangles(tmp_path, animation):
    faces, count = animation.rest.faces, len(animation.rest.faces)
    material = np.arange(count) % 2
    file = save(tmp_path / "a.glb", animation, Appearance(None, material, (RED, GLASS)))
    assert [primitive["material"] for primitive in file.primitives] == [0, 1]
    for k in range(2):
        moved = file.morph("POSITION", k)[:, file.faces(k)]
        expected = animation.frames[:, faces[material == k]]
        np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-5)
        used = len(np.unique(faces[material == k]))
        assert len(file.attribute("POSITION", k)) == used
        assert "TEXCOORD_0" not in file.primitives[k]["attributes"]
    found = [
        (m["name"], m["pbrMetallicRoughness"]["baseColorFactor"], m["alphaMode"])
        for m in file.json["materials"]
    ]
    assert found == [("red", [1, 0, 0, 1], "OPAQUE"), ("glass", [0.1, 0.2, 0.3, 0.5], "BLEND")]


def test_every_corner_keeps_its_uv(tmp_path, animation):
    """Some corners share them with others, and so a vertex."""
    faces = animation.rest.faces
    uv = RANDOM.integers(0, 2, (len(faces), 3, 2)) / 4
    file = save(tmp_path / "a.glb", animation, Appearance(uv))
    found = file.attribute("TEXCOORD_0")[file.faces()]
    np.testing.assert_array_equal(found, np.stack([uv[..., 0], 1 - uv[..., 1]], axis=-1))
    moved = file.morph("POSITION")[:, file.faces()]
    np.testing.assert_allclose(moved, animation.frames[:, faces], rtol=0, atol=1e-5)
    pairs = {(v, *c) for v, c in zip(faces.ravel(), uv.reshape(-1, 2).tolist(), strict=True)}
    assert len(file.attribute("POSITION")) == len(pairs) > len(animation.rest.vertices)


def test_seams_do_not_break_the_shading(tmp_path, animation):
    """Both sides of a seam have the normal of the vertex."""
    uv = RANDOM.random((len(animation.rest.faces), 3, 2))
    cut = save(tmp_path / "a.glb", animation, Appearance(uv))
    whole = save(tmp_path / "b.glb", animation, None)
    np.testing.assert_allclose(
        cut.morph("NORMAL")[:, cut.faces()], whole.morph("NORMAL")[:, whole.faces()],
        rtol=0, atol=1e-4,
    )  # fmt: skip


def test_uv_of_vertices_cut_nothing(animation):
    uv = RANDOM.random((len(animation.rest.vertices), 2))[animation.rest.faces]
    surface = cut_surface(animation.rest.faces, len(animation.rest.vertices), Appearance(uv))
    np.testing.assert_array_equal(surface.origins, np.arange(len(animation.rest.vertices)))
    np.testing.assert_array_equal(surface.parts[0].faces, animation.rest.faces)


@pytest.mark.parametrize("has_uv", [False, True])
def test_triangles_without_a_material_are_plain(tmp_path, animation, has_uv):
    faces = animation.rest.faces
    material = np.where(np.arange(len(faces)) < 3, -1, 1)
    uv = RANDOM.random((len(faces), 3, 2)) if has_uv else None
    file = save(tmp_path / "a.glb", animation, Appearance(uv, material, (RED, GLASS)))
    assert [material["name"] for material in file.json["materials"]] == ["red", "glass", "plain"]
    assert [primitive["material"] for primitive in file.primitives] == [1, 2]
    assert [len(file.faces(k)) for k in range(2)] == [len(faces) - 3, 3]


def test_a_mesh_without_any_is_not_a_metal(tmp_path, animation):
    file = save(tmp_path / "a.glb", animation, None)
    (material,) = file.json["materials"]
    assert material["pbrMetallicRoughness"]["metallicFactor"] == 0
    np.testing.assert_array_equal(file.faces(), animation.rest.faces)


def test_trimesh_reads_uvs_and_colours(tmp_path, animation):
    faces = animation.rest.faces
    material = np.arange(len(faces)) % 2
    uv = RANDOM.random((len(faces), 3, 2))
    save(tmp_path / "a.glb", animation, Appearance(uv, material, (RED, GLASS)))
    parts = list(trimesh.load(tmp_path / "a.glb", process=False).geometry.values())
    assert [part.visual.material.name for part in parts] == ["red", "glass"]
    for k, part in enumerate(parts):
        np.testing.assert_allclose(part.visual.uv[part.faces], uv[material == k], atol=1e-6)
        corners = animation.rest.vertices[faces[material == k]]
        np.testing.assert_allclose(part.vertices[part.faces], corners, atol=1e-6)
