"""The frame of a model: the same coordinates however a file states the surface."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cageik_cli.cages.builder.frame import (
    AXIS_TURNS,
    MAX_UNEVENNESS,
    PLACE_STEP,
    Frame,
    break_ties,
    sort_mesh,
)
from cageik_cli.cages.builder.judge import Demand
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import box, concave, finer

TURN = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
TURN_OVER = np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])


@pytest.fixture(scope="module")
def model():
    """A shape without symmetry."""
    mesh = finer(concave(), 2)
    x, y, z = mesh.vertices.T
    return TriMesh(np.stack([x + 0.1 * x**2, y + 0.2 * z**2, 3 * z + 0.3 * z**2], 1), mesh.faces)


def shuffle(mesh, seed=0):
    """Return the surface with other numbers of vertices and faces, and other first corners."""
    generator = np.random.default_rng(seed)
    order, rows = (generator.permutation(len(part)) for part in (mesh.vertices, mesh.faces))
    faces = np.roll(np.argsort(order)[mesh.faces[rows]], 1, axis=1)
    return TriMesh(mesh.vertices[order], faces)


def place(mesh):
    return sort_mesh(TriMesh(Frame(mesh).to_units(mesh.vertices), mesh.faces))


@pytest.mark.parametrize("turn", [np.eye(3), TURN, TURN.T, TURN_OVER])
@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_a_model_that_is_moved_has_the_same_coordinates_in_its_frame(model, turn, scale):
    changed = TriMesh(scale * model.vertices @ turn.T + [5, -3, 2], model.faces)
    placed = place(shuffle(changed))
    np.testing.assert_allclose(placed.vertices, place(model).vertices, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(placed.faces, place(model).faces)


@pytest.mark.parametrize(("order", "signs"), AXIS_TURNS)
def test_a_letter_that_is_turned_over_reads_as_the_letter_in_its_frame(order, signs):
    """An S is the same when turned by 180 degrees, and leans to no side; turned over it is a Z."""
    x, y, z = finer(box(), 2).vertices.T
    letter = TriMesh(np.stack([3 * x, y + x**3 - 3 * x, z / 2], axis=1), finer(box(), 2).faces)
    turned = TriMesh(letter.vertices[:, order] * signs, letter.faces)
    found, expected = (Frame(m).to_units(m.vertices) for m in (turned, letter))
    assert cKDTree(expected).query(found)[0].max() < 1e-12


def test_vertices_that_are_split_do_not_turn_the_frame(model):
    half = model.faces[: len(model.faces) // 2]
    corners = np.arange(half.size).reshape(-1, 3) + len(model.vertices)
    vertices = np.concatenate([model.vertices, model.vertices[half].reshape(-1, 3)])
    split = TriMesh(vertices, np.concatenate([corners, model.faces[len(half) :]]))
    found, expected = (Frame(m).to_units(model.vertices) for m in (split, model))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_a_model_without_area_has_a_frame():
    line = TriMesh(np.array([[0.0, 0, 0], [0, 1, 0], [0, 3, 0]]), np.array([[0, 1, 2]]))
    units = Frame(line).to_units(line.vertices)
    np.testing.assert_allclose(np.sort(np.abs(units[[0, 2], 0])), 0.5, rtol=1e-12)


@pytest.mark.parametrize("change", ["order", "turn", "place", "scale"])
def test_no_change_of_the_file_changes_a_bit_of_what_a_cage_must_do(model, change):
    changed = {
        "order": lambda: shuffle(model),
        "turn": lambda: TriMesh(model.vertices @ TURN.T, model.faces),
        "place": lambda: TriMesh(model.vertices + np.array([5.1, -3.3, 2.7]), model.faces),
        "scale": lambda: TriMesh(0.01 * model.vertices, model.faces),
    }[change]()
    first, second = (Demand(m, BuildSettings()) for m in (model, changed))
    np.testing.assert_array_equal(first.surface.vertices, second.surface.vertices)
    np.testing.assert_array_equal(first.surface.faces, second.surface.faces)
    np.testing.assert_array_equal(first.samples, second.samples)
    np.testing.assert_allclose(
        first.surface.vertices, place(model).vertices, rtol=0, atol=PLACE_STEP
    )


def test_the_axes_of_a_cube_stay_as_they_are():
    frame = Frame(box())
    units = frame.to_units(np.eye(3)) - frame.to_units(np.zeros((1, 3)))
    np.testing.assert_allclose(units, np.eye(3) / np.sqrt(12), rtol=0, atol=1e-12)


@pytest.mark.parametrize("turn", [np.eye(3), TURN, TURN_OVER])
def test_a_frame_turns_and_never_mirrors(model, turn):
    frame = Frame(TriMesh(model.vertices @ turn.T, model.faces))
    axes = frame.to_units(np.eye(3)) - frame.to_units(np.zeros((1, 3)))
    assert np.linalg.det(axes) > 0
    points = model.vertices[:9]
    np.testing.assert_allclose(frame.to_file_units(frame.to_units(points)), points, rtol=1e-12)


def test_ties_are_broken_by_more_than_rounding_and_less_than_a_shape_shows():
    turn = 2 * np.pi * np.arange(24) / 24
    ring = 0.3 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    broken = break_ties(ring)
    assert np.abs(broken - ring).max() <= MAX_UNEVENNESS
    lengths = np.linalg.norm(broken - np.roll(broken, 1, axis=0), axis=1)
    assert np.diff(np.sort(lengths)).min() > 1e-9


def test_a_plane_is_bumpy_over_the_cells_of_a_grid_by_more_than_single_precision():
    side = 0.007 * np.arange(60)
    x, y = np.meshgrid(side, side, indexing="ij")
    height = break_ties(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3))[:, 2].reshape(60, 60)
    bumps = np.abs(height[1:-1] - (height[:-2] + height[2:]) / 2)
    assert np.median(bumps) > 50 * np.finfo(np.float32).eps / 4
