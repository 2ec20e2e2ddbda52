import numpy as np
import pytest

from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.method.pose.rigidity import Cells, Neighbours
from tests.shapes import ball, concave, finer, rotation

CAGES = {"L": finer(concave(), 1), "ball": ball(1), "coarse": concave()}


@pytest.fixture(params=CAGES.values(), ids=CAGES)
def cage(request):
    return request.param


def neighbours_of(cage):
    found = [set() for _ in cage.vertices]
    for i, j in cage.edges.ends:
        found[i].add(j)
        found[j].add(i)
    return found


def random_moves(cage, seed=2):
    return 0.2 * np.random.default_rng(seed).normal(size=cage.vertices.shape)


def test_rotations_and_rotated_differences_equal_a_loop_over_edges(cage):
    """Sorkine and Alexa 2007, eqs. 5, 6 and 8, with weights of one over the number of edges."""
    pose, move = cage.vertices + 0.1 * random_moves(cage), random_moves(cage, 3)
    moved, neighbours = pose + move, neighbours_of(cage)
    cells = Cells(Neighbours(uniform_laplacian(cage)), pose)
    rotations = cells.fit_rotations(move)
    changes = cells.rotate_differences(rotations)
    expected = np.empty((len(pose), 3, 3))
    for i, cell in enumerate(neighbours):
        products = [np.outer(moved[i] - moved[j], pose[i] - pose[j]) for j in cell]
        expected[i] = nearest_rotations_by_svd(np.mean(products, axis=0)[None])[0]
    np.testing.assert_allclose(rotations.transpose(2, 0, 1), expected, atol=1e-11)
    for i, cell in enumerate(neighbours):
        edges = [pose[i] - pose[j] for j in cell]
        halves = [(expected[i] + expected[j]) / 2 for j in cell]
        right = np.mean([h @ e for h, e in zip(halves, edges, strict=True)], axis=0)
        np.testing.assert_allclose(changes[i], right - np.mean(edges, axis=0), atol=1e-11)


def test_a_rigid_motion_is_the_rotation_of_every_cell(cage):
    """Then b is R L c: the linear system has the motion for its solution."""
    laplacian, turn, rest = uniform_laplacian(cage), rotation(4), cage.vertices
    cells = Cells(Neighbours(laplacian), rest)
    rotations = cells.fit_rotations(rest @ turn.T + [3.0, -1.0, 2.0] - rest)
    np.testing.assert_allclose(rotations.transpose(2, 0, 1) - turn, 0, atol=1e-13)
    expected = laplacian @ rest @ turn.T - laplacian @ rest
    np.testing.assert_allclose(cells.rotate_differences(rotations), expected, atol=1e-13)


def test_motions_without_rotation_change_nothing(cage):
    cells = Cells(Neighbours(uniform_laplacian(cage)), cage.vertices)
    shift = np.tile([5.0, 0.0, -7.0], (len(cage.vertices), 1))
    np.testing.assert_allclose(cells.rotate_differences(cells.fit_rotations(shift)), 0, atol=1e-14)


def test_a_shear_is_no_rotation(cage):
    """The checks above must be able to fail: a motion that is not rigid leaves a remainder."""
    laplacian, rest = uniform_laplacian(cage), cage.vertices
    shear = np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 1]])
    cells = Cells(Neighbours(laplacian), rest)
    changes = cells.rotate_differences(cells.fit_rotations(rest @ shear.T - rest))
    assert np.abs(changes - (laplacian @ rest @ shear.T - laplacian @ rest)).max() > 1e-2


@pytest.mark.parametrize("far", [1e3, 1e6])
def test_far_from_the_origin_only_the_digits_of_the_input_are_lost(cage, far):
    """Positions of size `far` have that many digits less, and edges with them."""
    laplacian, moves = uniform_laplacian(cage), random_moves(cage)
    near = Cells(Neighbours(laplacian), cage.vertices)
    away = Cells(Neighbours(laplacian), cage.vertices + far)
    expected = near.rotate_differences(near.fit_rotations(moves))
    found = away.rotate_differences(away.fit_rotations(moves - 3 * far))
    np.testing.assert_allclose(found, expected, atol=1e-13 * far)


def test_a_cage_far_from_the_origin_has_the_same_rotations(cage):
    """To the last digits, not to those of its positions: on a grid, far away is exact."""
    near = np.round(cage.vertices * 2**20) / 2**20
    neighbours = Neighbours(uniform_laplacian(cage))
    found, expected = Cells(neighbours, near + 1e6), Cells(neighbours, near)
    moves = random_moves(cage)
    rotations = found.fit_rotations(moves), expected.fit_rotations(moves)
    np.testing.assert_allclose(*rotations, rtol=0, atol=1e-12)
    np.testing.assert_allclose(*map(found.rotate_differences, rotations), rtol=0, atol=1e-12)


def test_inputs_are_not_changed(cage):
    """However it lies in memory."""
    moves = np.asfortranarray(random_moves(cage))
    poses = cage.vertices + moves
    kept = moves.copy(), poses.copy()
    Cells(Neighbours(uniform_laplacian(cage)), poses).fit_rotations(moves)
    np.testing.assert_array_equal(moves, kept[0])
    np.testing.assert_array_equal(poses, kept[1])
