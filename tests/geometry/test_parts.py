"""Models of several meshes: joined into one mesh, split again, named in sentences."""

from dataclasses import fields, replace

import numpy as np
import pytest

from cageik_cli.geometry.attributes import (
    NONE,
    FaceLabels,
    Parts,
    Subdivision,
    SurfaceAttributes,
    UvMap,
    number_normal_fans,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import (
    PartShare,
    count_by_part,
    describe_by_part,
    get_parts,
    join_meshes,
    name_part,
    name_vertex,
    split_parts,
)
from cageik_cli.util.errors import FormatError
from tests.shapes import box, octahedron

PLAIN = octahedron()
MOVED = np.array([[0, 2.0, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [3, 4, 5, 1]])


def square(name, colour, **extra):
    """A square with all that a file can say of it, and a vertex in no face at either end."""
    corners = np.array([1, 2, 3, 4])
    given = {
        "corner_counts": np.array([4]),
        "corners": corners,
        "uvs": UvMap(np.array([[0, 0], [1, 0], [0, 1.0]]), np.array([0, 1, 2, NONE])),
        "normal_fans": number_normal_fans(corners, np.array([0, 0, NONE, 1])),
        "materials": FaceLabels((name,), np.array([0])),
        "material_colours": np.array([colour]),
        "groups": FaceLabels(("front",), np.array([0])),
        "material_library": "all.mtl",
        "subdivision": Subdivision(
            "catmullClark", corners[:3], np.array([3]), np.array([1.0, 2]), corners[:1], np.ones(1)
        ),
    }
    vertices = np.array([[9, 9, 9], [0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [8, 8, 8.0]])
    return TriMesh(vertices, [[1, 2, 3], [1, 3, 4]], SurfaceAttributes(**given | extra))


BODY = square("skin", (1, 0, 0, 1))
JACKET = square("cloth", (0, 1, 0, 0.5), colours=np.full((6, 3), 0.25))


def list_content(mesh):
    """Everything that a mesh holds, as plain lists."""
    found = {"vertices": mesh.vertices.tolist(), "faces": mesh.faces.tolist()}

    def add(holder, place):
        for each in fields(holder):
            value = getattr(holder, each.name)
            if hasattr(value, "__dataclass_fields__"):
                add(value, f"{place}{each.name}/")
            else:
                found[place + each.name] = value.tolist() if hasattr(value, "tolist") else value

    if mesh.attributes is not None:
        add(mesh.attributes, "")
    return found


def test_parts_are_split_as_they_were_joined():
    meshes, names = [BODY, PLAIN, JACKET], ("/hero/body", "eye", "/hero/jacket")
    joined = join_meshes(meshes, names, [np.eye(4), MOVED, np.eye(4)])
    parts = split_parts(joined)
    assert tuple(part.name for part in parts) == names
    for part, mesh in zip(parts, meshes, strict=True):
        assert list_content(part.mesh) == list_content(mesh)
    np.testing.assert_array_equal(parts[1].transform, MOVED)


def test_parts_are_moved_back_to_their_own_space():
    joined = join_meshes([BODY, PLAIN], ("body", "eye"), [np.eye(4), MOVED])
    frames = np.random.default_rng(1).normal(size=(3, 12, 3))
    body, eye = split_parts(joined)
    np.testing.assert_array_equal(body.select(frames), frames[:, :6])
    own = np.concatenate([eye.select(frames), np.ones((3, 6, 1))], axis=2)
    np.testing.assert_allclose((own @ MOVED)[..., :3], frames[:, 6:], atol=1e-14)


def test_a_mesh_that_came_as_one_is_its_own_part():
    (part,) = split_parts(BODY)
    assert part.mesh is BODY
    assert not part.name


def test_names_that_are_alike_get_numbers():
    joined = join_meshes([PLAIN] * 4, ("eye", "eye_2", "eye", "eye"))
    assert joined.attributes.parts.names == ("eye", "eye_2", "eye_3", "eye_4")


def test_materials_of_one_name_and_two_colours_stay_apart():
    others = [square("skin", colour) for colour in [(1, 0, 0, 1), (0, 0, 1, 1)]]
    joined = join_meshes([BODY, *others], ("a", "b", "c"))
    assert joined.attributes.materials.names == ("skin", "skin_2")
    assert joined.attributes.materials.indices.tolist() == [0, 0, 1]
    assert joined.attributes.material_colours.tolist() == [[1, 0, 0, 1], [0, 0, 1, 1]]


def test_creases_of_two_kinds_are_joined_by_edge():
    single = replace(BODY.attributes.subdivision, crease_sharpness=np.array([4.0]))
    other = square("skin", (1, 0, 0, 1), subdivision=single)
    joined = join_meshes([BODY, other], ("a", "b")).attributes.subdivision
    assert joined.crease_sharpness.tolist() == [1, 2, 4, 4]
    assert split_parts(join_meshes([BODY, other], ("a", "b")))[1].mesh.attributes is not None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"names": ("a", "a")}, "there twice"),
        ({"names": ("a",)}, "other counts"),
        ({"vertex_counts": np.array([6, 5])}, "vertices"),
        ({"vertex_counts": np.array([4, 8])}, "a face of one part has a vertex of another"),
        ({"polygon_counts": np.array([1, 7])}, "polygons"),
        ({"transforms": np.zeros((2, 4, 4))}, "cannot be inverted"),
        ({"transforms": np.full((2, 4, 4), np.nan)}, "transforms"),
    ],
)
def test_parts_of_another_mesh_are_refused(change, says):
    joined = join_meshes([BODY, PLAIN], ("a", "b"))

    def change_parts():
        parts = replace(joined.attributes.parts, **change)
        return replace(joined, attributes=replace(joined.attributes, parts=parts))

    with pytest.raises(FormatError, match=says):
        change_parts()


def test_parts_need_as_many_of_each():
    with pytest.raises(FormatError, match="other counts"):
        Parts(("a",), np.array([1]), np.array([1]), np.eye(4)[:3])


@pytest.mark.parametrize("schemes", [("none",), ("none", "odd"), ("none", "loop", "loop")])
def test_a_scheme_is_that_of_each_part(schemes):
    joined = join_meshes([BODY, PLAIN], ("a", "b")).attributes
    assert joined.subdivision.part_schemes == ("catmullClark", "none")
    with pytest.raises(FormatError, match="scheme"):
        replace(joined, subdivision=Subdivision(part_schemes=schemes))


MODEL = join_meshes([box(), octahedron(), box()], ["/a/box", "/a/ball", "last"])


def test_the_place_of_a_vertex_is_its_part_and_its_number_there():
    places = {0: "0 (/a/box[0])", 7: "7 (/a/box[7])", 8: "8 (/a/ball[0])", 21: "21 (last[7])"}
    assert {vertex: name_vertex(MODEL, vertex) for vertex in places} == places
    assert [name_part(MODEL, vertex) for vertex in (7, 13, 14)] == ["/a/box", "/a/ball", "last"]


def test_vertices_are_counted_by_part_the_most_first():
    found = count_by_part(MODEL, np.array([1, 14, 15, 20]))
    assert found == [PartShare("last", 3, 8), PartShare("/a/box", 1, 8)]
    assert describe_by_part(found) == " (last 3 of 8, /a/box 1 of 8)"
    assert count_by_part(MODEL, np.empty(0, np.int64)) == []


@pytest.mark.parametrize("mesh", [box(), join_meshes([box()], ["/a"])], ids=["none", "one part"])
def test_a_model_of_one_part_is_not_named(mesh):
    assert get_parts(mesh) is None
    assert (name_vertex(mesh, 3), name_part(mesh, 3)) == ("3", None)
    assert describe_by_part(count_by_part(mesh, np.array([3]))) == ""


def test_a_sentence_names_few_parts():
    many = [PartShare(f"part{k}", 1, 2) for k in range(60)]
    assert describe_by_part(many) == (" (part0 1 of 2, part1 1 of 2, part2 1 of 2 and 57 more)")
