"""A check that a clip has its vertices in the order of a mesh, as far as the faces tell."""

import numpy as np

from cageik_cli.formats.base.sequence import MeshSequence, check_connectivity
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Integers
from cageik_cli.util.errors import ConnectivityError


def check_vertex_order(sequence: MeshSequence, expected: TriMesh, expected_name: str) -> None:
    """Refuse a clip whose faces do not join the vertices that those of `expected` join.

    Other programs write faces in another order, from another corner or reversed, and cut quads
    along the other diagonal: the vertices keep their numbers, so that is accepted.

    Raises
    ------
    InputError
        Naming the first difference from the mesh called `expected_name`.
    """
    found = sequence.first.fan_triangulated
    counts = [(len(mesh.vertices), len(mesh.faces)) for mesh in (found, expected)]
    if counts[0] == counts[1]:
        if any(_has_same_edges(mesh, expected) for mesh in (found, sequence.first)):
            return
        if np.array_equal(_sorted_valences(found), _sorted_valences(expected)):
            raise ConnectivityError(
                f"as many vertices and triangles as {expected_name}, in another order; export it "
                "again from the mesh that cageik export wrote, and keep the vertex order"
            )
    check_connectivity(len(found.vertices), found.faces, expected, expected_name)


def _has_same_edges(mesh: TriMesh, expected: TriMesh) -> bool:
    """Return whether both have the same edges, apart from the diagonals of quads."""
    ours, theirs = mesh.edges.ends, expected.edges.ends
    new, lost = ~_rows_in(ours, theirs), ~_rows_in(theirs, ours)
    face, corner = np.nonzero(new[mesh.edges.side_edges])
    # The other diagonal joins the two corners opposite a new edge.
    edge = mesh.edges.side_edges[face, corner]
    facing = mesh.faces[face, corner][np.argsort(edge, kind="stable")]
    if (mesh.edges.face_counts[new] != 2).any():
        return False
    others = np.sort(facing.reshape(-1, 2), axis=1)
    return len(others) == np.count_nonzero(lost) and bool(_rows_in(theirs[lost], others).all())


def _sorted_valences(mesh: TriMesh) -> Integers:
    """Return the number of faces at each vertex, sorted."""
    return np.sort(np.bincount(mesh.faces.ravel()))


def _rows_in(pairs: Integers, others: Integers) -> np.ndarray:
    """Return which rows of `pairs` (a, 2) are rows of `others` (b, 2)."""
    base = int(max(pairs.max(initial=0), others.max(initial=0))) + 1
    return np.isin(pairs @ [base, 1], others @ [base, 1])
