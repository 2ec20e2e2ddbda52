import numpy as np
import pytest

from cageik_cli.cages.repair.tidy import (
    PolygonMesh,
    close_hole,
    count_topology_faults,
    drop_unreferenced,
    find_coincident,
    find_fins,
    find_holes,
    find_inward_facing,
    find_misoriented,
    find_repeated,
    replace_corners,
)
from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import QUADS, TETRAHEDRON, ball, box


def polygons(mesh, faces=None):
    return PolygonMesh.from_fans(mesh if faces is None else TriMesh(mesh.vertices, faces))


@pytest.mark.parametrize("seed", range(5))
def test_turned_faces_are_found_whichever_they_are(seed):
    """The fewer of them are turned: those that were, or if they were most, the others."""
    chosen = np.random.default_rng(seed).uniform(size=len(ball(2).faces)) < 0.3
    mesh = polygons(ball(2)).turn(chosen)
    np.testing.assert_array_equal(find_misoriented(mesh), chosen)
    np.testing.assert_array_equal(find_misoriented(mesh.turn(np.ones(len(chosen), bool))), chosen)


def test_components_are_turned_outward_one_by_one():
    faces = np.concatenate([box().faces, box().faces[:, ::-1] + 8])
    mesh = polygons(TriMesh(np.concatenate([box().vertices, 3 + box().vertices]), faces))
    assert not find_misoriented(mesh).any()
    np.testing.assert_array_equal(find_inward_facing(mesh), np.arange(24) >= 12)


def test_an_open_component_has_no_inside():
    assert not find_inward_facing(polygons(box(), box().faces[1:, ::-1])).any()


def test_coincident_vertices_are_one_and_others_are_not():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1e-9], [1, 0, 1e-3], [0, 0, 0]])
    assert find_coincident(vertices, np.arange(5)).tolist() == [0, 1, 0, 3, 0]
    assert find_coincident(vertices, np.array([1, 2, 4])).tolist() == [0, 1, 2, 3, 2]


def test_corners_that_become_one_go():
    mesh = PolygonMesh.from_rings(
        box().vertices, [np.array(ring) for ring in ([0, 1, 3, 2], [4, 5, 6])]
    )
    merged = replace_corners(mesh, np.array([0, 0, 2, 3, 4, 4, 6, 7]))
    assert [ring.tolist() for ring in merged.rings] == [[0, 3, 2]]


def test_a_polygon_that_would_touch_itself_goes():
    mesh = PolygonMesh.from_rings(box().vertices, [np.array([0, 1, 3, 2]), np.array([4, 5, 6])])
    merged = replace_corners(mesh, np.array([0, 1, 2, 0, 4, 5, 6, 7]))
    assert [ring.tolist() for ring in merged.rings] == [[4, 5, 6]]


def test_repetitions_are_found_from_either_side_and_corner():
    faces = np.concatenate(
        [box().faces, np.roll(box().faces[[2]], 1, axis=1), box().faces[[5], ::-1]]
    )
    assert np.flatnonzero(find_repeated(polygons(box(), faces))).tolist() == [12, 13]


def test_vertices_in_no_face_go():
    mesh, numbers = drop_unreferenced(polygons(box(), np.array([[1, 3, 5], [3, 5, 7]])))
    assert numbers.tolist() == [-1, 0, -1, 1, -1, 2, -1, 3]
    np.testing.assert_array_equal(mesh.vertices, box().vertices[[1, 3, 5, 7]])
    assert mesh.corners.tolist() == [0, 1, 2, 1, 2, 3]


def test_a_fin_of_two_faces_is_found():
    vertices = np.concatenate([box().vertices, [[5.0, 0, 0], [6, 0, 0]]])
    faces = np.concatenate([box().faces, [[*box().faces[0, :2], 8], [box().faces[0, 0], 8, 9]]])
    assert np.flatnonzero(find_fins(polygons(TriMesh(vertices, faces)))).tolist() == [12, 13]


def test_an_open_cage_has_no_fins():
    assert not find_fins(polygons(box(), box().faces[2:])).any()


@pytest.mark.parametrize(
    ("mesh", "faults"),
    [
        (box(), 0),
        (TriMesh(box().vertices, box().faces[1:]), 3),
        (TriMesh(box().vertices, np.concatenate([box().faces, box().faces[:1]])), 3),
    ],
)
def test_edges_without_two_faces_are_counted(mesh, faults):
    assert count_topology_faults(polygons(mesh)) == faults


def test_a_vertex_at_which_two_bodies_touch_is_counted():
    """Two tetrahedra with one common corner."""
    vertices = np.concatenate([TETRAHEDRON.vertices, -TETRAHEDRON.vertices[1:]])
    other = np.where(TETRAHEDRON.faces == 0, 0, TETRAHEDRON.faces + 3)[:, ::-1]
    mesh = TriMesh(vertices, np.concatenate([TETRAHEDRON.faces, other]))
    assert count_topology_faults(polygons(mesh)) == 1


def test_the_hole_of_a_missing_face_is_that_face():
    mesh = polygons(box(), box().faces[1:])
    (hole,) = find_holes(mesh)
    assert set(hole.tolist()) == set(box().faces[0].tolist())
    closed = close_hole(mesh, hole)
    assert count_topology_faults(closed) == 0
    assert closed.triangles.is_closed
    assert closed.triangles.volume == pytest.approx(8)


def test_a_hole_around_a_vertex_is_closed_flat():
    """The top of an octahedron is gone: what is left is half of it."""
    mesh = polygons(ball(0))
    top = (mesh.triangles.faces == 4).any(axis=1)
    (hole,) = find_holes(mesh.keep(~top))
    closed = close_hole(mesh.keep(~top), hole).triangles
    assert closed.is_closed
    assert closed.volume == pytest.approx(ball(0).volume / 2)


def test_the_least_area_is_taken():
    """A hole of six edges in a sphere: no filling has less area than that by trying all."""
    mesh = polygons(ball(2))
    hub = int(np.bincount(ball(2).faces.ravel()).argmax())
    around = (ball(2).faces == hub).any(axis=1)
    (hole,) = find_holes(mesh.keep(~around))
    assert len(hole) == 6
    added = close_hole(mesh.keep(~around), hole).triangles.faces[-4:]

    def area(faces):
        a, b, c = (ball(2).vertices[faces[:, k]] for k in range(3))
        return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()

    fans = [np.roll(hole, k) for k in range(6)]
    best = min(area(np.array([[f[0], f[k], f[k + 1]] for k in range(1, 5)])) for f in fans)
    assert area(added) <= best * (1 + 1e-12)


def test_holes_that_meet_in_a_vertex_are_left():
    """Two faces gone that share one corner."""
    faces = ball(1).faces
    pairs = [
        (i, j)
        for i in range(len(faces))
        for j in range(i)
        if len(set(faces[i]) & set(faces[j])) == 1
    ]
    mesh = polygons(ball(1), np.delete(faces, pairs[0], axis=0))
    assert find_holes(mesh) == []


def test_a_hole_is_closed_by_no_chord_that_is_an_edge_elsewhere():
    """A pentagon whose lower faces share the corner 0; the same chords would be the shortest."""
    points = np.array([[0.0, 0, 0], [1, -2, 1], [1, -0.5, 0], [1, 0.5, 0], [1, 2, 1]])
    below = [np.array(face) for face in ([0, 2, 1], [0, 3, 2], [0, 4, 3])]
    closed = close_hole(PolygonMesh.from_rings(points, below), np.arange(5)).triangles
    assert len(closed.faces) == 6
    assert (closed.edges.face_counts == 2).all()


READ = FileMesh.from_polygons(
    box().vertices, [*QUADS[:5], QUADS[5][:3], QUADS[5][2:] + QUADS[5][:1]]
)
COUNTS, MIXED = READ.corner_counts, TriMesh(READ.vertices, READ.fans)


def test_rings_of_fans_are_the_polygons():
    mesh = PolygonMesh.from_fans(MIXED, COUNTS)
    assert [tuple(ring) for ring in mesh.rings[:5]] == list(QUADS[:5])
    np.testing.assert_array_equal(mesh.triangles.faces, MIXED.faces)
    assert mesh.triangle_polygons.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 6]
    assert mesh.next_corners[:4].tolist() == [1, 3, 2, 0]


def test_triangles_alone_are_polygons():
    mesh = PolygonMesh.from_fans(box())
    assert mesh.corner_counts.tolist() == [3] * 12
    np.testing.assert_array_equal(mesh.triangles.faces, box().faces)


@pytest.mark.parametrize("counts", [[4] * 5, [4] * 7, [2, *[4] * 6]])
def test_counts_of_another_mesh_are_refused(counts):
    with pytest.raises(ValueError, match="numbers of corners"):
        PolygonMesh.from_fans(MIXED, np.array(counts))


def test_triangles_that_are_no_fans_are_refused():
    with pytest.raises(ValueError, match="fans"):
        PolygonMesh.from_fans(TriMesh(MIXED.vertices, np.roll(MIXED.faces, 1, axis=0)), COUNTS)


def test_turned_polygons_are_cut_along_the_same_diagonals():
    mesh = PolygonMesh.from_fans(MIXED, COUNTS)
    turned = mesh.turn(np.arange(len(COUNTS)) < 3)
    sets = [{frozenset(face) for face in m.triangles.faces.tolist()} for m in (mesh, turned)]
    assert sets[0] == sets[1]
    assert turned.rings[0].tolist() == [0, 2, 3, 1]
    assert turned.rings[3].tolist() == mesh.rings[3].tolist()


def dart(depth):
    """A quad whose corner 2 is pulled towards corner 0: beyond −0.5 its fan folds over."""
    return np.array([[0.0, 0, 0], [1, 0, 0], [depth, depth, 0], [0, 1, 0]])


@pytest.mark.parametrize(("depth", "folded"), [(1.0, False), (0.3, False)])
def test_a_quad_that_its_diagonal_cuts_well_is_not_folded(depth, folded):
    mesh = PolygonMesh.from_rings(dart(depth), [np.arange(4)])
    assert mesh.is_folded.tolist() == [folded]


def test_a_folded_quad_starts_at_another_corner_as_readers_cut_it():
    """The corner that points inward is 1: the diagonal from 0 to 2 is outside the quad."""
    vertices = np.roll(dart(0.3), 1, axis=0)
    mesh = PolygonMesh.from_rings(vertices, [np.array([0, 1, 2, 3])])
    assert mesh.is_folded.all()
    unfolded = mesh.unfold()
    assert unfolded.corner_counts.tolist() == [4]
    assert not unfolded.is_folded.any()
    fans = unfolded.triangles
    read = FileMesh.from_polygons(fans.vertices, unfolded.rings).make_mesh()
    np.testing.assert_array_equal(read.faces, unfolded.triangles.faces)


def test_a_polygon_that_folds_from_every_corner_is_cut():
    """A Z of six corners: no corner sees all others."""
    points = np.array([[0, 0], [3, 0], [3, 2], [2.9, 0.1], [0.1, 0.1], [0, -2]], float)
    vertices = np.column_stack([points, np.zeros(6)])
    mesh = PolygonMesh.from_rings(vertices, [np.arange(6)]).unfold()
    assert mesh.corner_counts.tolist() == [3] * 4
