import numpy as np
import pytest

from cageik_cli.cages.repair.tidy import PolygonMesh
from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import QUADS, box

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
