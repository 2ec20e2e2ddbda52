"""Polygons and their attributes: the same surface however it is turned, cut or split."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.geometry.attributes import (
    MAX_NAMES,
    FaceLabels,
    Subdivision,
    SurfaceAttributes,
    UvMap,
    number_normal_fans,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import compute_area_vectors, compute_fan_normals
from cageik_cli.util.errors import FormatError
from tests.shapes import box
from tests.surfaces import ASSET

QUADS = np.array([0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3])
PLAIN = SurfaceAttributes(np.full(6, 4), QUADS)


def test_a_reversed_surface_shows_its_other_side_and_twice_is_itself():
    turned = ASSET.flip()
    assert turned.volume == pytest.approx(-ASSET.volume, rel=1e-12)
    assert turned.fan_triangulated.volume == pytest.approx(-ASSET.volume, rel=1e-12)
    turned.attributes.check_cut(turned.faces)
    areas = compute_area_vectors(ASSET.attributes, ASSET.vertices)
    np.testing.assert_allclose(
        compute_area_vectors(turned.attributes, ASSET.vertices), -areas, atol=1e-15
    )
    back = turned.attributes.reverse()
    for name in ("corners", "normal_fans"):
        np.testing.assert_array_equal(getattr(back, name), getattr(ASSET.attributes, name))
    np.testing.assert_array_equal(back.uvs.indices, ASSET.attributes.uvs.indices)


def test_corners_keep_their_uvs_when_reversed():
    def pairs(attributes):
        return set(zip(attributes.corners.tolist(), attributes.uvs.indices.tolist(), strict=True))

    assert pairs(ASSET.attributes.reverse()) == pairs(ASSET.attributes)


def test_areas_of_polygons_are_the_sums_of_their_triangles():
    a, b, c = (ASSET.vertices[corner] for corner in ASSET.faces.T)
    sums = np.zeros((len(ASSET.attributes.corner_counts), 3))
    np.add.at(sums, ASSET.attributes.triangle_polygons, np.cross(b - a, c - a))
    found = compute_area_vectors(ASSET.attributes, ASSET.vertices)
    np.testing.assert_allclose(found, sums, atol=1e-15)


def test_normals_are_units_that_turn_with_the_mesh():
    normals = compute_fan_normals(ASSET.attributes, ASSET.vertices)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-12)
    turn = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0.0]])
    np.testing.assert_allclose(
        compute_fan_normals(ASSET.attributes, 1e-60 * ASSET.vertices @ turn),
        normals @ turn,
        atol=1e-9,
    )


def test_a_normal_without_area_has_some_direction():
    normals = compute_fan_normals(ASSET.attributes, np.zeros(ASSET.vertices.shape))
    np.testing.assert_array_equal(normals, np.tile([0, 0, 1.0], (len(normals), 1)))


def test_normals_of_several_vertices_are_told_apart():
    fans = number_normal_fans(np.array([5, 5, 7, 7, 5]), np.array([0, 0, 0, 1, -1]))
    assert fans.tolist() == [0, 0, 1, 2, -1]
    assert number_normal_fans(np.array([1]), np.array([-1])).tolist() == [-1]


def test_names_with_their_polygons():
    labels = FaceLabels(("a", "unused", "b"), np.array([2, 0, -1, 2]))
    found = [(name, polygons.tolist()) for name, polygons in labels.list_members()]
    assert found == [("a", [1]), ("b", [0, 3])]
    assert FaceLabels.from_members(2, [("a", np.array([], int))]) is None
    members = [("hidden", slice(None)), ("a", np.array([3, 2])), ("b", slice(2)), ("a", [0, 1])]
    made = FaceLabels.from_members(5, [*members, ("b", np.array([0, 3]))])
    assert (made.names, made.indices.tolist()) == (("b", "a", "hidden"), [0, 1, 1, 0, 2])


def test_what_is_plain():
    assert SurfaceAttributes(np.full(12, 3), box().faces.ravel()).is_plain
    assert not PLAIN.is_plain
    for change in (
        {"subdivision": Subdivision("catmullClark")},
        {"material_library": "a.mtl"},
        {"colours": np.zeros((8, 3))},
    ):
        assert not replace(
            SurfaceAttributes(np.full(12, 3), box().faces.ravel()), **change
        ).is_plain


WRONG = {
    "too many names": lambda: FaceLabels(tuple(map(str, range(MAX_NAMES + 1))), np.zeros(1, int)),
    "UVs as a list": lambda: UvMap(np.zeros(4), np.zeros(1, int)),
    "UVs of text": lambda: UvMap(np.zeros((2, 2)), np.array(["0"])),
    "normals of others": lambda: replace(PLAIN, normal_fans=np.zeros(3, int)),
    "UVs of others": lambda: replace(PLAIN, uvs=UvMap(np.zeros((1, 2)), np.zeros(3, int))),
    "labels of others": lambda: replace(PLAIN, groups=FaceLabels(("a",), np.zeros(5, int))),
    "colours of two": lambda: replace(PLAIN, colours=np.zeros((8, 2))),
    "sharp vertices": lambda: Subdivision("none", corner_vertices=np.array([1])),
    "other triangles": lambda: TriMesh(box().vertices, box().faces[:-1], PLAIN),
    "other vertices": lambda: TriMesh(box().vertices[:-1], box().faces[:2] * 0, PLAIN),
    "other colours": lambda: replace(box(), attributes=replace(PLAIN, colours=np.zeros((7, 3)))),
}


@pytest.mark.parametrize("make", WRONG.values(), ids=WRONG)
def test_parts_that_do_not_agree_are_refused(make):
    with pytest.raises(FormatError):
        make()


def test_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        ASSET.attributes.corners[0] = 1


def test_a_description_names_what_there_is():
    assert PLAIN.description == "6 polygons"
    assert ASSET.attributes.description == (
        "27 polygons with texture coordinates, normals, 3 materials, 3 groups, 1 part"
    )
    whole = SurfaceAttributes(np.array([24]), QUADS)
    rich = replace(whole, colours=np.zeros((8, 3)), subdivision=Subdivision("loop"))
    assert rich.description == "1 polygon with colours, scheme loop"
