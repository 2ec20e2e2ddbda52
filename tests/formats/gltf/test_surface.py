"""Materials and texture coordinates: vertices are cut at seams, and move as they did."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.gltf.surface import cut_surface
from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.settings import MorphSettings, Scene
from cageik_cli.formats.write import Output
from tests.assets import SIDES, asset_text, parse_asset
from tests.formats.gltf.decoded import Glb
from tests.formats.gltf.painted import paint
from tests.surfaces import ASSET

NAMES = ("red", "glass")
RANDOM = np.random.default_rng(2)


def save(path, rest, frames, has_normals=True):
    morphs = MorphSettings(has_normals=has_normals)
    described = Animation(rest, len(frames), Scene(), "thing", morphs=morphs)
    with Output(path).open_writer(described) as out:
        out.append(frames)
    return Glb(path)


def test_each_material_has_its_triangles(tmp_path, animation):
    faces, count = animation.rest.faces, len(animation.rest.faces)
    material = np.arange(count) % 2
    file = save(tmp_path / "a.glb", paint(animation.rest, None, material, NAMES), animation.frames)
    assert [primitive["material"] for primitive in file.primitives] == [0, 1]
    for k in range(2):
        moved = file.morph("POSITION", k)[:, file.faces(k)]
        expected = animation.frames[:, faces[material == k]]
        np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-5)
        used = len(np.unique(faces[material == k]))
        assert len(file.attribute("POSITION", k)) == used
        assert "TEXCOORD_0" not in file.primitives[k]["attributes"]
    assert [material["name"] for material in file.json["materials"]] == ["red", "glass"]


def test_every_corner_keeps_its_uv(tmp_path, animation):
    """Some corners share them with others, and so a vertex."""
    faces = animation.rest.faces
    uv = RANDOM.integers(0, 2, (len(faces), 3, 2)) / 4
    file = save(tmp_path / "a.glb", paint(animation.rest, uv), animation.frames)
    found = file.attribute("TEXCOORD_0")[file.faces()]
    np.testing.assert_array_equal(found, np.stack([uv[..., 0], 1 - uv[..., 1]], axis=-1))
    moved = file.morph("POSITION")[:, file.faces()]
    np.testing.assert_allclose(moved, animation.frames[:, faces], rtol=0, atol=1e-5)
    pairs = {(v, *c) for v, c in zip(faces.ravel(), uv.reshape(-1, 2).tolist(), strict=True)}
    assert len(file.attribute("POSITION")) == len(pairs) > len(animation.rest.vertices)


def test_seams_do_not_break_the_shading(tmp_path, animation):
    """Both sides of a seam have the normal of the vertex."""
    uv = RANDOM.random((len(animation.rest.faces), 3, 2))
    cut = save(tmp_path / "a.glb", paint(animation.rest, uv), animation.frames)
    whole = save(tmp_path / "b.glb", animation.rest, animation.frames)
    np.testing.assert_allclose(
        cut.morph("NORMAL")[:, cut.faces()], whole.morph("NORMAL")[:, whole.faces()],
        rtol=0, atol=1e-4,
    )  # fmt: skip


def test_triangles_have_what_the_text_says_of_their_polygons():
    surface, text = cut_surface(ASSET, has_normals=False), parse_asset(asset_text())
    found, expected = [], []
    for part in surface.primitives:
        for triangle in part.faces + part.start:
            uvs = (surface.layers["uvs"][triangle] * [1, -1] + [0, 1]).round(5).tolist()
            found.append(
                (surface.materials[part.material], surface.origins[triangle].tolist(), uvs)
            )
    polygons = np.repeat(np.arange(len(text.polygons)), [len(p) - 2 for p in text.polygons])
    for triangle, number in zip(ASSET.faces.tolist(), polygons, strict=True):
        places = [text.polygons[number].index(vertex) for vertex in triangle]
        uvs = np.round([text.corner_uvs[number][place] for place in places], 5).tolist()
        expected.append((text.names[number][2], triangle, uvs))
    assert sorted(found) == sorted(expected)


def test_corners_without_uvs_are_at_zero(animation):
    mesh = paint(animation.rest, np.full((len(animation.rest.faces), 3, 2), 0.25))
    indices = mesh.attributes.uvs.indices.copy()
    indices[0] = -1
    uvs = replace(mesh.attributes.uvs, indices=indices)
    surface = cut_surface(replace(mesh, attributes=replace(mesh.attributes, uvs=uvs)), True)
    (primitive,) = surface.primitives
    assert surface.layers["uvs"][primitive.faces[0]].tolist() == [
        [0, 1],
        [0.25, 0.75],
        [0.25, 0.75],
    ]


def test_uv_of_vertices_cut_nothing(animation):
    uv = RANDOM.random((len(animation.rest.vertices), 2))[animation.rest.faces]
    surface = cut_surface(paint(animation.rest, uv), has_normals=True)
    np.testing.assert_array_equal(surface.origins, np.arange(len(animation.rest.vertices)))
    np.testing.assert_array_equal(surface.primitives[0].faces, animation.rest.faces)


@pytest.mark.parametrize("has_uv", [False, True])
def test_triangles_without_a_material_are_plain(tmp_path, animation, has_uv):
    faces = animation.rest.faces
    material = np.where(np.arange(len(faces)) < 3, -1, 1)
    uv = RANDOM.random((len(faces), 3, 2)) if has_uv else None
    file = save(tmp_path / "a.glb", paint(animation.rest, uv, material, NAMES), animation.frames)
    assert [material["name"] for material in file.json["materials"]] == ["red", "glass", "plain"]
    assert [primitive["material"] for primitive in file.primitives] == [1, 2]
    assert [len(file.faces(k)) for k in range(2)] == [len(faces) - 3, 3]


def test_a_mesh_without_any_is_not_a_metal(tmp_path, animation):
    file = save(tmp_path / "a.glb", animation.rest, animation.frames)
    (material,) = file.json["materials"]
    assert material["pbrMetallicRoughness"]["metallicFactor"] == 0
    np.testing.assert_array_equal(file.faces(), animation.rest.faces)


def test_trimesh_reads_uvs_and_materials(tmp_path, animation):
    faces = animation.rest.faces
    material = np.arange(len(faces)) % 2
    uv = RANDOM.random((len(faces), 3, 2))
    save(tmp_path / "a.glb", paint(animation.rest, uv, material, NAMES), animation.frames)
    parts = list(trimesh.load(tmp_path / "a.glb", process=False).geometry.values())
    assert [part.visual.material.name for part in parts] == ["red", "glass"]
    for k, part in enumerate(parts):
        np.testing.assert_allclose(part.visual.uv[part.faces], uv[material == k], atol=1e-6)
        corners = animation.rest.vertices[faces[material == k]]
        np.testing.assert_allclose(part.vertices[part.faces], corners, atol=1e-6)


# --- normals and colours


def bend(mesh, count=4):
    """Frames of a mesh that bends more and more."""
    x, y, z = mesh.vertices.T
    return np.array([np.stack([x + 0.3 * k * z**2, y, z], axis=1) for k in range(count)])


def expect_normals(text, positions):
    """The normals of the corners of triangles, from the lines of an OBJ text, one by one."""
    asset, sums = parse_asset(text), {}
    areas = []
    for polygon in asset.polygons:
        a = positions[polygon]
        areas.append(np.cross(a - a[0], np.roll(a, -1, axis=0) - a[0]).sum(axis=0))
    for polygon, normals, area in zip(asset.polygons, asset.corner_normals, areas, strict=True):
        for key in zip(polygon, normals, strict=True):
            sums[key] = sums.get(key, 0) + area
    return asset, {key: value / np.linalg.norm(value) for key, value in sums.items()}


def test_hard_edges_stay_hard(tmp_path):
    """A vertex at the edge of a cap has the normal of the cap, and that of the side."""
    text = asset_text()
    (tmp_path / "tube.obj").write_text(text)
    rest = load_mesh(tmp_path / "tube.obj").mesh
    frames = bend(rest)
    file = save(tmp_path / "a.glb", rest, frames)
    names = [material["name"] for material in file.json["materials"]]
    for frame, positions in enumerate(frames):
        asset, expected = expect_normals(text, positions)
        for k, primitive in enumerate(file.primitives):
            name = names[primitive["material"]]
            wanted = {
                key
                for polygon, normals, labels in zip(
                    asset.polygons, asset.corner_normals, asset.names, strict=True
                )
                if labels[2] == name
                for key in zip(polygon, normals, strict=True)
            }
            found = set()
            places, normals = file.morph("POSITION", k)[frame], file.morph("NORMAL", k)[frame]
            for place, normal in zip(places, normals, strict=True):
                vertex = int(np.linalg.norm(positions - place, axis=1).argmin())
                misses = {
                    key: np.abs(expected[key] - normal).max() for key in wanted if key[0] == vertex
                }
                found.add(min(misses, key=misses.get))
                assert min(misses.values()) < 0.02
            assert found == wanted


def test_flat_meshes_are_not_cut_at_hard_edges(tmp_path):
    (tmp_path / "tube.obj").write_text(asset_text())
    rest = load_mesh(tmp_path / "tube.obj").mesh
    plain = replace(rest, attributes=replace(rest.attributes, uvs=None, materials=None))
    file = save(tmp_path / "a.glb", plain, bend(plain), has_normals=False)
    assert set(file.primitives[0]["attributes"]) == {"POSITION"}
    assert len(file.attribute("POSITION")) == len(rest.vertices)
    hard = save(tmp_path / "b.glb", plain, bend(plain))
    assert len(hard.attribute("POSITION")) == len(rest.vertices) + 2 * SIDES


def test_corners_without_a_normal_are_flat(tmp_path, animation):
    """Each triangle of a mesh whose corners have no normals but one has its own."""
    faces = animation.rest.faces
    fans = np.full(faces.size, -1)
    fans[0] = 0
    rest = replace(animation.rest, attributes=replace(animation.rest.polygons, normal_fans=fans))
    file = save(tmp_path / "a.glb", rest, animation.frames)
    a, b, c = (animation.rest.vertices[corner] for corner in faces.T)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = file.attribute("NORMAL")[file.faces()]
    np.testing.assert_allclose(found, np.repeat(normals[:, None], 3, axis=1), atol=1e-6)


@pytest.mark.parametrize(("alpha", "mode"), [(None, "OPAQUE"), (1.0, "OPAQUE"), (0.5, "BLEND")])
def test_vertices_keep_their_colours(tmp_path, animation, alpha, mode):
    uv = RANDOM.random((len(animation.rest.faces), 3, 2))
    mesh = paint(animation.rest, uv)
    colours = RANDOM.random((len(mesh.vertices), 3))
    colours[0, 0] = 3.0
    if alpha is not None:
        colours = np.insert(colours, 3, alpha, axis=1)
    rest = replace(mesh, attributes=replace(mesh.attributes, colours=colours))
    file = save(tmp_path / "a.glb", rest, animation.frames)
    found = file.attribute("COLOR_0")[file.faces()]
    np.testing.assert_allclose(found, colours.clip(0, 1)[rest.faces], atol=1e-6)
    (material,) = file.json["materials"]
    assert material["alphaMode"] == mode
    assert material["pbrMetallicRoughness"]["baseColorFactor"] == [1, 1, 1, 1]


def test_colours_of_materials_are_base_colours(tmp_path, animation):
    count = len(animation.rest.faces)
    material = np.where(np.arange(count) < 3, -1, np.arange(count) % 2)
    rest = paint(animation.rest, None, material, NAMES)
    colours = [[0.5, 0.25, 0, 1], [2, 0.5, -1, 0.5]]
    rest = replace(rest, attributes=replace(rest.attributes, material_colours=colours))
    file = save(tmp_path / "a.glb", rest, animation.frames)
    found = [
        (m["name"], m["pbrMetallicRoughness"]["baseColorFactor"], m["alphaMode"])
        for m in file.json["materials"]
    ]
    assert found == [
        ("red", [0.5, 0.25, 0, 1], "OPAQUE"),
        ("glass", [1, 0.5, 0, 0.5], "BLEND"),
        ("plain", [0.8, 0.8, 0.8, 1], "OPAQUE"),
    ]
    parts = trimesh.load(tmp_path / "a.glb", process=False).geometry.values()
    shown = {part.visual.material.name: part.visual.material.baseColorFactor for part in parts}
    np.testing.assert_allclose(np.array(shown["red"]) / 255, colours[0], atol=1 / 255)
