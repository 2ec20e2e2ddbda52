"""Axes that turn with the surface: the turn of a model that turns rigidly, at any point of it."""

import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface_distance import SurfaceDistances
from cageik_cli.method.pose.anchors import point_at_vertex
from cageik_cli.method.pose.local_axes import LocalAxes
from tests.shapes import ball, rotation


def fan(count):
    """A cone of so many sides; its tip is vertex 0."""
    turn = 2 * np.pi * np.arange(count) / count
    rim = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    sides = 1 + np.arange(count)
    faces = np.stack([0 * sides, sides, np.roll(sides, -1)], axis=1)
    return TriMesh(np.concatenate([[[0, 0, 0.5]], rim]), faces)


@pytest.mark.parametrize("count", [3, 8, 12, 13, 32, 64])
def test_the_tip_of_a_fan_turns(count):
    """All its neighbours are equally far away."""
    check_turn(fan(count), 0)


def test_a_smooth_surface_turns():
    check_turn(ball(levels=3), 17)


def test_doubled_vertices_are_no_neighbours():
    mesh = fan(12)
    vertices = np.concatenate([mesh.vertices, np.repeat(mesh.vertices[:1], 20, axis=0)])
    check_turn(TriMesh(vertices, mesh.faces), 0)


def check_turn(mesh, vertex):
    weights, turn = np.eye(len(mesh.vertices)), rotation(2)
    axes = LocalAxes(
        point_at_vertex(mesh, vertex), mesh, weights, np.zeros_like(mesh.vertices),
        SurfaceDistances(mesh),
    )  # fmt: skip
    found = axes.find_turns((mesh.vertices @ turn + 3)[None], axes.base)
    np.testing.assert_allclose(found[0], turn, rtol=0, atol=1e-7)
