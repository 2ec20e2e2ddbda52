"""Whether a clip's vertices come in the order of a mesh: what may differ, and what may not."""

import re

import numpy as np
import pytest

from cageik_cli.formats.base.mesh_data import check_vertex_order
from cageik_cli.formats.open import open_sequence
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import InputError
from tests.shapes import QUADS, ball, box


@pytest.fixture
def refusal(tmp_path, write_obj):
    """What is said against a frame of these faces in place of a mesh; empty if it is taken."""

    def of(vertices, faces, expected):
        path = write_obj(tmp_path / "frame.obj", vertices, np.asarray(faces))
        try:
            check_vertex_order(open_sequence([str(path)]).first, expected, "the result's cage")
        except InputError as error:
            return str(error)
        return ""

    return of


def fanned(quads):
    return np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def test_the_same_faces_are_taken(refusal):
    mesh = ball(levels=1, size=1.0)
    assert refusal(3 * mesh.vertices, mesh.faces, mesh) == ""


def test_faces_in_another_order_turned_and_rotated_are_the_same(refusal):
    mesh = ball(levels=1, size=1.0)
    random = np.random.default_rng(1)
    faces = random.permutation([np.roll(f, random.integers(3)) for f in mesh.faces])
    assert refusal(mesh.vertices, faces, mesh) == ""
    assert refusal(mesh.vertices, faces[:, ::-1], mesh) == ""


@pytest.mark.parametrize("seed", range(5))
def test_quads_may_be_cut_along_either_diagonal(refusal, seed):
    cage = box(1.0)
    random = np.random.default_rng(seed)
    expected = TriMesh(cage.vertices, fanned(QUADS))
    turned = [tuple(np.roll(quad, random.integers(4))) for quad in QUADS]
    assert refusal(cage.vertices, random.permutation(turned), expected) == ""


def test_vertices_in_another_order_are_refused(refusal):
    mesh = ball(levels=1, size=1.0)
    order = np.random.default_rng(2).permutation(len(mesh.vertices))
    said = refusal(mesh.vertices[order], np.argsort(order)[mesh.faces], mesh)
    assert said.startswith("as many vertices and triangles as the result's cage")


def test_two_vertices_swapped_are_enough(refusal):
    mesh = ball(levels=1, size=1.0)
    order = np.arange(len(mesh.vertices))
    order[[3, 7]] = 7, 3
    said = refusal(mesh.vertices, order[mesh.faces], mesh)
    assert "in another order" in said


def test_quads_in_another_order_are_refused(refusal):
    cage = box(1.0)
    order = np.array([1, 0, 2, 3, 4, 5, 6, 7])
    expected = TriMesh(cage.vertices, fanned(QUADS))
    assert refusal(cage.vertices, order[np.array(QUADS)], expected) != ""


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda v, f: (v[:-1], f % (len(v) - 1)), "17 vertices, the result's cage has 18"),
        (lambda v, f: (v, f[:-1]), "31 triangles, the result's cage has 32"),
        (
            lambda v, f: (v, np.where(f == f[0, 0], f[-1, 1], f)),
            r"triangle 0 joins vertices .*, in the result's cage ",
        ),
    ],
)
def test_another_mesh_is_refused(refusal, change, says):
    mesh = ball(levels=1, size=1.0)
    assert re.search(says, refusal(*change(mesh.vertices, mesh.faces), mesh))
