import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse import csgraph

from cageik_cli.geometry.attributes import SurfaceAttributes, fan_triangulate
from cageik_cli.geometry.mesh import TriMesh, find_groups, signed_volumes
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.util.errors import FormatError
from tests.shapes import TETRAHEDRON, ball, box, concave, octahedron, quad_box


def test_volume_is_that_of_the_formula_and_of_trimesh():
    assert TETRAHEDRON.volume == pytest.approx(1 / 6, rel=1e-14)
    assert box().volume == pytest.approx(8, rel=1e-14)
    assert concave().volume == pytest.approx(3, rel=1e-14)
    mesh = ball(3)
    other = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert mesh.volume == pytest.approx(other.volume, rel=1e-12)


def test_volume_changes_sign_when_flipped():
    assert box().flip().volume == pytest.approx(-8, rel=1e-14)


@settings(max_examples=30)
@given(st.floats(-1e4, 1e4), st.floats(1e-3, 1e3))
def test_volume_does_not_depend_on_the_origin_and_scales_cubed(shift, scale):
    mesh = ball(1)
    frames = scale * (mesh.vertices + shift)[None]
    tolerance = 1e-13 * max(1, abs(shift))
    assert signed_volumes(frames, mesh.faces)[0] == pytest.approx(
        scale**3 * mesh.volume, rel=tolerance
    )


def test_closedness_and_components():
    mesh = box()
    assert mesh.is_closed
    assert not TriMesh(mesh.vertices, mesh.faces[1:]).is_closed
    turned = mesh.faces.copy()
    turned[0] = turned[0, ::-1]
    assert not TriMesh(mesh.vertices, turned).is_closed
    two = TriMesh(
        np.concatenate([mesh.vertices, mesh.vertices + 5]),
        np.concatenate([mesh.faces, mesh.faces + 8]),
    )
    assert two.is_closed
    assert np.bincount(two.components).tolist() == [8, 8]
    assert len(set(mesh.components)) == 1


def test_edges_follow_euler_and_their_sides():
    mesh = concave()
    edges = mesh.edges
    assert len(mesh.vertices) - len(edges.ends) + len(mesh.faces) == 2
    assert (edges.face_counts == 2).all()
    for face, sides in zip(mesh.faces, edges.side_edges, strict=True):
        for corner, side in enumerate(sides):
            assert set(edges.ends[side]) == set(np.delete(face, corner))


def test_sides_are_those_of_the_polygons():
    """A cube of quads has 12 sides, one of triangles 18; a pentagon beside a triangle has 7."""
    sides = [quad_box().polygon_sides, box().polygon_sides]
    assert [len(ends) for ends in sides] == [12, 18]
    lengths = [np.ptp(box().vertices[ends], axis=1).astype(bool).sum(axis=1) for ends in sides]
    assert [sorted(set(count.tolist())) for count in lengths] == [[1], [1, 2]]
    corners = np.array([0, 1, 2, 3, 4, 0, 4, 5])
    polygons = SurfaceAttributes(np.array([5, 3]), corners)
    mesh = TriMesh(np.eye(6, 3), fan_triangulate(corners, polygons.corner_counts), polygons)
    assert mesh.polygon_sides.tolist() == [[0, 1], [0, 4], [0, 5], [1, 2], [2, 3], [3, 4], [4, 5]]


def test_laplacian_kills_constants_and_is_the_mean_of_neighbours():
    mesh = octahedron()
    laplacian = uniform_laplacian(mesh)
    np.testing.assert_allclose(laplacian.sum(axis=1), 0, atol=1e-15)
    # Every vertex of an octahedron neighbours all but its opposite; their mean is the origin.
    np.testing.assert_allclose(laplacian @ mesh.vertices, mesh.vertices, atol=1e-15)


@pytest.mark.parametrize(
    ("vertices", "faces", "says"),
    [
        (np.zeros((4, 2)), [[0, 1, 2]], "vertices have shape"),
        (np.zeros((0, 3)), [[0, 1, 2]], "vertices have shape"),
        ([[0, 0, 0], [0, np.nan, 0], [0, 0, np.inf]], [[0, 1, 2]], "vertex 1 is .* and 2 of 3"),
        ([[0, 0, 0], [0, -1e51, 0], [0, 0, 0]], [[0, 1, 2]], r"vertex 1 is .* at most 1e\+50"),
        (np.zeros((3, 3)), [[0, 1, 3]], "face 0 names vertices 0, 1, 3"),
        (np.zeros((3, 3)), [[0, 1, -1]], "face 0 names vertices"),
        (np.zeros((3, 3)), [[0, 1, 2, 0]], "faces have shape"),
        (np.zeros((3, 3)), np.zeros((0, 3), int), "faces have shape"),
        (np.zeros((3, 3)), [[0.0, 1.0, 2.0]], "expected integers"),
    ],
)
def test_what_is_not_a_mesh_is_refused(vertices, faces, says):
    with pytest.raises(FormatError, match=says):
        TriMesh(np.array(vertices, float), np.array(faces))


def test_the_largest_coordinates_overflow_nowhere():
    mesh = TriMesh(1e50 * box().vertices, box().faces)
    assert mesh.volume == pytest.approx(8e150, rel=1e-12)
    assert mesh.diagonal == pytest.approx(np.sqrt(12) * 1e50, rel=1e-12)


def test_numbers_too_large_to_convert_are_refused_without_a_warning():
    vertices = np.full((3, 3), np.finfo(np.longdouble).max, np.longdouble)
    with pytest.raises(FormatError, match="vertex 0 is"):
        TriMesh(vertices, np.array([[0, 1, 2]]))


def test_arrays_are_copied_once_and_read_only():
    vertices = box().vertices.copy()
    mesh = TriMesh(vertices, box().faces)
    vertices[0] = 7
    assert mesh.vertices[0, 0] == -1
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0] = 7
    assert TriMesh(mesh.vertices, mesh.faces).vertices is mesh.vertices


@pytest.mark.parametrize("pair_count", [0, 1, 30, 100, 150, 400])
def test_groups_are_connected_components(pair_count):
    generator = np.random.default_rng(pair_count)
    pairs = generator.integers(0, 200, (pair_count, 2))
    graph = sparse.coo_array((np.ones(pair_count), tuple(pairs.T)), shape=(200, 200))
    expected = csgraph.connected_components(graph, directed=False)[1]
    np.testing.assert_array_equal(find_groups(pairs, 200), expected)


@pytest.mark.parametrize("order", ["up", "down", "mixed"])
def test_a_long_chain_is_one_group(order):
    numbers = np.arange(20_000)
    if order == "down":
        numbers = numbers[::-1]
    elif order == "mixed":
        numbers = np.random.default_rng(0).permutation(numbers)
    pairs = np.stack([numbers[:-1], numbers[1:]], axis=1)
    assert not find_groups(pairs, len(numbers)).any()
