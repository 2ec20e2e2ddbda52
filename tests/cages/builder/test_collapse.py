"""Shells are thinned without needles, and collapses cost the same in every pose."""

import igl
import numpy as np
import pytest

from cageik_cli.cages.builder.collapse import (
    MAX_NEEDLE_SHARE,
    MIN_EVENNESS,
    NEEDLE_ANGLE,
    ROUND_EVENNESS,
    collapse_costs,
    euler_characteristic,
    simplify_shell,
    vertex_quadrics,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import measure_angles
from tests.shapes import ball, box, changed, finer


def needle_share(mesh):
    angles = measure_angles(mesh.vertices[mesh.faces]).min(axis=1)
    return (angles < NEEDLE_ANGLE).mean()


def test_a_cylinder_is_thinned_without_needles():
    square = finer(box(), 5)
    x, y, z = square.vertices.T
    round_off = np.maximum(np.abs(x), np.abs(y)) / np.maximum(np.hypot(x, y), 1e-9)
    shell = changed(square, vertices=np.stack([x * round_off, y * round_off, 3 * z], axis=1))
    faces = 2 * (400 - euler_characteristic(shell))
    vertices, corners, *_ = igl.qslim(
        np.asfortranarray(shell.vertices), np.asfortranarray(shell.faces.astype(np.int32)), faces
    )
    assert needle_share(TriMesh(vertices, corners)) > MAX_NEEDLE_SHARE
    thin, evenness = simplify_shell(shell, 400)
    assert evenness == ROUND_EVENNESS
    assert needle_share(thin) <= MAX_NEEDLE_SHARE
    assert len(thin.vertices) == pytest.approx(400, abs=2)
    assert thin.is_closed


def test_a_ball_keeps_what_quadrics_leave_of_it():
    thin, evenness = simplify_shell(ball(4), 400)
    assert evenness == MIN_EVENNESS
    assert len(thin.vertices) == pytest.approx(400, abs=2)
    small = ball(3)
    assert simplify_shell(small, 200) == (small, MIN_EVENNESS)


def test_costs_of_poses_add_up():
    mesh = ball(2)
    poses = np.stack([mesh.vertices, mesh.vertices[:, [1, 2, 0]] * 1.3])
    quadrics = np.stack([vertex_quadrics(TriMesh(pose, mesh.faces)) for pose in poses])
    ends = mesh.edges.ends[:20]
    costs, places = collapse_costs(quadrics, poses, ends)
    assert (collapse_costs(quadrics, poses, ends, 1.0)[0] > costs).all()
    single = [collapse_costs(quadrics[[k]], poses[[k]], ends) for k in range(2)]
    np.testing.assert_allclose(costs, single[0][0] + single[1][0], rtol=1e-12)
    for k in range(2):
        np.testing.assert_allclose(places[:, k], single[k][1][:, 0], rtol=0, atol=1e-12)
