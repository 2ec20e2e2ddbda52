from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cageik_cli import bind, load_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.method.pose.anchors import Anchor, SurfacePoint, anchor_matrix, point_at_vertex
from cageik_cli.method.pose.constraints import CageConstraints
from cageik_cli.method.pose.poser import Poser
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.errors import HandlesError, NumericalError, SettingError
from tests.shapes import ball, box, concave, finer, octahedron, rotation

FreePoser = partial(Poser, hold=False)
"""A poser whose model follows its anchors everywhere, as in the paper."""

CAGE = finer(concave(), 1)
FACES = np.arange(60).reshape(-1, 3)
WALKER = Path(__file__).parents[3] / "data_fixtures/walker"


def bound(cage, seed=0):
    """A cage and 60 points of random convex weights; the method asks no more of a binding."""
    weights = np.random.default_rng(seed).dirichlet(np.full(len(cage.vertices), 0.2), 60)
    return Binding(TriMesh(weights @ cage.vertices, FACES), cage, weights)


def joined(*meshes):
    """One mesh of several parts."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return TriMesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def some_anchors(count, seed=1, hard=()):
    """On random faces, with random weights."""
    generator = np.random.default_rng(seed)
    shares = generator.dirichlet(np.ones(3), count)
    faces = FACES[generator.integers(0, len(FACES), count)]
    counts = generator.uniform(0.5, 2, count)
    return [
        Anchor(f"a{k}", SurfacePoint(faces[k], shares[k]), counts[k], hard=k in hard)
        for k in range(count)
    ]


def some_moves(count, seed=2):
    return 0.3 * np.random.default_rng(seed).normal(size=(count, 3))


def stacked(poser):
    """Both terms' rows, (n + l, n), and the roots that targets are multiplied with, (l, 1)."""
    rows = anchor_matrix(poser.anchors, poser.binding.weights)
    roots = [np.sqrt(poser.beta / len(rows) * anchor.weight) for anchor in poser.anchors]
    smooth = uniform_laplacian(poser.binding.cage) * np.sqrt(poser.alpha / rows.shape[1])
    scale = np.array(roots)[:, None]
    return np.vstack([smooth, scale * rows]), scale


def least_squares(poser, displacements):
    """The cage by numpy's lstsq on the stacked system, in positions, as in the paper."""
    matrix, scale = stacked(poser)
    rest, n = poser.binding.cage.vertices, len(poser.binding.cage.vertices)
    rows = anchor_matrix(poser.anchors, poser.binding.weights)
    right = np.vstack([matrix[:n] @ rest, scale * (rows @ rest + displacements)])
    return np.linalg.lstsq(matrix, right, rcond=None)[0]


@pytest.fixture(scope="module")
def binding():
    return bound(CAGE)


@pytest.mark.parametrize("count", [1, 3, 8, 41, 42, 60])
@pytest.mark.parametrize("alpha", [1e-6, 1e-3, 1.0, 100.0])
def test_the_cage_is_the_least_squares_solution_of_the_stacked_system(binding, alpha, count):
    poser = FreePoser(binding, some_anchors(count), alpha, beta=0.7)
    moves = some_moves(count)
    expected = least_squares(poser, moves)
    np.testing.assert_allclose(poser.solve_cage(moves), expected, atol=1e-9 * CAGE.diagonal)
    expected = binding.rest.vertices + binding.weights @ (expected - CAGE.vertices)
    np.testing.assert_allclose(poser.solve_mesh(moves), expected, atol=1e-9 * CAGE.diagonal)


def test_an_anchor_of_larger_weight_is_met_better(binding):
    """The oracle must be able to fail: other weights are another minimum."""
    anchors, moves = some_anchors(8), some_moves(8)
    heavy = [Anchor("a0", anchors[0].point, 50.0), *anchors[1:]]
    light, heavy = (FreePoser(binding, chosen, alpha=1.0) for chosen in (anchors, heavy))

    def miss(poser):
        return np.linalg.norm(reached(poser, moves)[0] - moves[0])

    assert miss(heavy) < 0.2 * miss(light)
    assert np.abs(heavy.solve_cage(moves) - least_squares(light, moves)).max() > 1e-3


def reached(poser, moves, rigidity=0):
    """How far the anchors went."""
    cage = poser.solve_cage(moves, rigidity) - poser.binding.cage.vertices
    return anchor_matrix(poser.anchors, poser.binding.weights) @ cage


@pytest.mark.parametrize("rigidity", [0, 5])
def test_anchors_are_met_when_beta_is_large_and_exactly_when_hard(binding, rigidity):
    moves = some_moves(8)
    soft = FreePoser(binding, some_anchors(8), alpha=1e-8)
    assert np.abs(reached(soft, moves, rigidity) - moves).max() < 1e-6 * binding.rest.diagonal
    hard = FreePoser(binding, some_anchors(8, hard=range(8)), alpha=1.0)
    assert np.abs(reached(hard, moves, rigidity) - moves).max() < 1e-12 * binding.rest.diagonal
    weak = FreePoser(binding, some_anchors(8), alpha=1.0)
    assert np.abs(reached(weak, moves, rigidity) - moves).max() > 1e-3


@pytest.mark.parametrize("alpha", [1e-6, 1.0])
def test_hard_and_soft_anchors_together_solve_the_system_of_lagrange(binding, alpha):
    anchors, moves = some_anchors(9, hard=(1, 4, 5)), some_moves(9)
    poser = FreePoser(binding, anchors, alpha)
    rows, n = anchor_matrix(anchors, binding.weights), len(CAGE.vertices)
    soft, hard = [0, 2, 3, 6, 7, 8], [1, 4, 5]
    counts = np.array([anchor.weight for anchor in anchors]) / len(anchors)
    laplacian = uniform_laplacian(CAGE)
    pull = rows[soft].T * counts[soft]
    normal = alpha / n * laplacian.T @ laplacian + pull @ rows[soft]
    system = np.block([[normal, rows[hard].T], [rows[hard], np.zeros((3, 3))]])
    moved = np.linalg.solve(system, np.vstack([pull @ moves[soft], moves[hard]]))[:n]
    np.testing.assert_allclose(poser.solve_cage(moves), CAGE.vertices + moved, atol=1e-8)


SHELLS = joined(box(2.0), octahedron(0.5), ball(1, 0.2))
CAGES = {"one": CAGE, "two": joined(CAGE, octahedron(0.1)), "three": SHELLS}


@pytest.mark.parametrize("cage", CAGES.values(), ids=CAGES)
@pytest.mark.parametrize("rigidity", [0, 3])
@pytest.mark.parametrize("count", [1, 2, 3, 8])
@pytest.mark.parametrize("hard", [True, False])
def test_one_translation_of_all_anchors_moves_all_by_it(cage, rigidity, count, hard):
    poser = FreePoser(bound(cage), some_anchors(count, hard=range(count) if hard else ()))
    shift = np.array([3.0, -2.0, 0.5])
    moves = np.tile(shift, (count, 1))
    rest = poser.binding
    np.testing.assert_allclose(
        poser.solve_cage(moves, rigidity), rest.cage.vertices + shift, atol=1e-12
    )
    np.testing.assert_allclose(
        poser.solve_mesh(moves, rigidity), rest.rest.vertices + shift, atol=1e-12
    )


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_free_components_move_as_little_as_possible_relative_to_each_other(count):
    """Of all minima, found by lstsq and the null space, that of the least relative motion."""
    poser, moves = FreePoser(bound(SHELLS), some_anchors(count), alpha=1e-2), some_moves(count)
    assert poser.free_modes == max(3 - count, 0)
    found = poser.solve_cage(moves) - SHELLS.vertices
    matrix, scale = stacked(poser)
    right = np.vstack([np.zeros((len(found), 3)), scale * moves])
    any_minimum = np.linalg.lstsq(matrix, right, rcond=1e-10)[0]
    free = scipy.linalg.null_space(matrix, rcond=1e-10)
    assert free.shape[1] == poser.free_modes
    parts = np.eye(3)[SHELLS.components]
    relative = parts @ np.linalg.pinv(parts) - 1 / len(found)
    choice = np.linalg.lstsq(relative @ free, -relative @ any_minimum, rcond=None)[0]
    np.testing.assert_allclose(found, any_minimum + free @ choice, atol=1e-9)


def test_a_component_without_anchors_follows_the_others():
    """Not a rounding error decides where it goes: anchors on one of two bodies."""
    cage = joined(CAGE, octahedron(0.3))
    weights = bound(CAGE).weights
    apart = np.hstack([weights, np.zeros((60, 6))])
    binding, moves = Binding(TriMesh(apart @ cage.vertices, FACES), cage, apart), some_moves(7)
    poser = FreePoser(binding, some_anchors(7), alpha=48 / 42)
    posed = poser.solve_cage(moves) - cage.vertices
    alone = FreePoser(bound(CAGE), some_anchors(7), alpha=1.0).solve_cage(moves) - CAGE.vertices
    np.testing.assert_allclose(posed[:42], alone, atol=1e-9)
    np.testing.assert_allclose(np.ptp(posed[42:], axis=0), 0, atol=1e-12)
    assert np.abs(posed[42:]).max() < 2 * np.abs(moves).max()


@pytest.mark.parametrize("rigidity", [0, 4])
@pytest.mark.parametrize("count", [0, 5])
def test_without_anchors_or_displacements_nothing_moves_a_bit(binding, rigidity, count):
    poser, still = FreePoser(binding, some_anchors(count, hard=(2,))), np.zeros((2, count, 3))
    assert poser.free_modes == (count == 0)
    np.testing.assert_array_equal(poser.solve_cage(still[0], rigidity), CAGE.vertices)
    np.testing.assert_array_equal(poser.solve_mesh(still[0], rigidity), binding.rest.vertices)
    cages = CAGE.vertices + np.arange(2.0)[:, None, None]
    np.testing.assert_array_equal(poser.edit_cages(cages, still, rigidity), cages)


def test_targets_are_displacements_from_the_rest_pose(binding):
    anchors = [Anchor("a", point_at_vertex(binding.rest, 7), hard=True)]
    poser = FreePoser(binding, anchors)
    target = np.array([[0.3, 0.1, -2.0]])
    posed = poser.solve_mesh(poser.displacements(target))
    np.testing.assert_allclose(posed[7], target[0], atol=1e-13)


def test_adding_or_removing_an_anchor_equals_a_new_poser(binding):
    anchors, moves = some_anchors(6), some_moves(6)
    whole = FreePoser(binding, anchors)
    whole.solve_mesh(moves)  # its response is not to be taken for another's
    less = whole.without_anchor("a2")
    kept = [*anchors[:2], *anchors[3:]]
    assert less.anchors == tuple(kept)
    np.testing.assert_array_equal(
        less.solve_mesh(moves[1:]), FreePoser(binding, kept).solve_mesh(moves[1:])
    )
    more = less.with_anchor(anchors[2])
    new = FreePoser(binding, [*kept, anchors[2]])
    for rigidity in (0, 2):
        np.testing.assert_array_equal(
            more.solve_cage(moves, rigidity), new.solve_cage(moves, rigidity)
        )
    np.testing.assert_array_equal(
        whole.solve_mesh(moves), FreePoser(binding, anchors).solve_mesh(moves)
    )
    with pytest.raises(HandlesError, match="'a0'"):
        whole.with_anchor(anchors[0])
    with pytest.raises(HandlesError, match="'knee'"):
        whole.without_anchor("knee")


@pytest.mark.parametrize("rigidity", [0, 3])
def test_locked_vertices_stay_and_the_rest_is_the_reduced_minimum(binding, rigidity):
    locked, moves = (0, 5, 17), some_moves(6)
    poser = FreePoser(binding, some_anchors(6), alpha=1e-3, constraints=CageConstraints(locked))
    posed = poser.solve_cage(moves, rigidity)
    np.testing.assert_array_equal(posed[list(locked)], CAGE.vertices[list(locked)])
    if rigidity:
        return
    matrix, scale = stacked(poser)
    right = np.vstack([np.zeros((len(posed), 3)), scale * moves])
    free = np.delete(np.arange(len(posed)), locked)
    moved = np.linalg.lstsq(matrix[:, free], right, rcond=None)[0]
    np.testing.assert_allclose(posed[free], CAGE.vertices[free] + moved, atol=1e-9)


def test_a_fully_locked_cage_stays(binding):
    poser = FreePoser(
        binding, some_anchors(2), constraints=CageConstraints(tuple(range(len(CAGE.vertices))))
    )
    np.testing.assert_array_equal(poser.solve_cage(some_moves(2)), CAGE.vertices)


TURN = rotation(8)
ROUND = TriMesh(ball(2, 1.0).vertices @ TURN.T + 0.5, ball(2, 1.0).faces)
MIRROR = Mirror(3 * TURN[:, 0], np.full(3, 0.5))


def images(cage):
    """Each vertex's partner, found by brute force."""
    reflected = MIRROR.reflect(cage.vertices)
    return np.linalg.norm(reflected[:, None] - cage.vertices, axis=2).argmin(axis=1)


@pytest.mark.parametrize("rigidity", [0, 3])
@pytest.mark.parametrize("locked", [(), (3, 11)])
def test_a_mirrored_pose_is_symmetric_and_so_is_its_response_to_what_is_not(rigidity, locked):
    poser = FreePoser(bound(ROUND), some_anchors(5), constraints=CageConstraints(locked, MIRROR))
    posed = poser.solve_cage(some_moves(5), rigidity)
    assert np.abs(posed - ROUND.vertices).max() > 0.05
    np.testing.assert_allclose(MIRROR.reflect(posed), posed[images(ROUND)], atol=1e-12)
    free = FreePoser(bound(ROUND), some_anchors(5)).solve_cage(some_moves(5), rigidity)
    assert np.abs(MIRROR.reflect(free) - free[images(ROUND)]).max() > 0.05


@pytest.mark.parametrize("alpha", [1e-4, 1.0])
def test_a_mirrored_pose_is_the_least_squares_solution_of_symmetric_motions(alpha):
    """All 3 n unknowns at once, of which the symmetric ones are a null space."""
    poser = FreePoser(
        bound(ROUND), some_anchors(5), alpha, constraints=CageConstraints((3,), MIRROR)
    )
    moves, n = some_moves(5), len(ROUND.vertices)
    matrix, scale = stacked(poser)
    flip = np.eye(3) - 2 * np.outer(TURN[:, 0], TURN[:, 0])
    images_of = np.kron(np.eye(n)[images(ROUND)], flip)
    kept = np.kron(np.eye(n)[[3]], np.eye(3))
    symmetric = scipy.linalg.null_space(np.vstack([images_of - np.eye(3 * n), kept]))
    right = np.concatenate([np.zeros(3 * n), (scale * moves).ravel()])
    found = np.linalg.lstsq(np.kron(matrix, np.eye(3)) @ symmetric, right, rcond=None)[0]
    expected = ROUND.vertices + (symmetric @ found).reshape(n, 3)
    np.testing.assert_allclose(poser.solve_cage(moves), expected, atol=1e-9)
    mesh = poser.binding.rest.vertices + poser.binding.weights @ (expected - ROUND.vertices)
    np.testing.assert_allclose(poser.solve_mesh(moves), mesh, atol=1e-9)


@pytest.mark.parametrize("rigidity", [0, 4])
@pytest.mark.parametrize("ties", [CageConstraints(), CageConstraints((2,))], ids=["free", "locked"])
def test_edited_frames_are_posed_each_from_its_own_cage(binding, rigidity, ties):
    anchors, generator = some_anchors(4, hard=(0,)), np.random.default_rng(3)
    cages = CAGE.vertices + 0.1 * generator.normal(size=(5, *CAGE.vertices.shape))
    moves = 0.2 * generator.normal(size=(5, 4, 3))
    moves[[1, 3]] = 0
    kept = cages.copy()
    edited = FreePoser(binding, anchors, constraints=ties).edit_cages(cages, moves, rigidity)
    np.testing.assert_array_equal(cages, kept)
    np.testing.assert_array_equal(edited[[1, 3]], cages[[1, 3]])
    for k in (0, 2, 4):
        own = TriMesh(cages[k], CAGE.faces)
        posed = Binding(TriMesh(binding.weights @ cages[k], FACES), own, binding.weights)
        single = FreePoser(posed, anchors, constraints=ties).solve_cage(moves[k], rigidity)
        np.testing.assert_allclose(edited[k], single, atol=1e-12)


def test_no_frames_are_edited_to_none(binding):
    poser = FreePoser(binding, some_anchors(3))
    assert poser.edit_cages(np.empty((0, 42, 3)), np.empty((0, 3, 3)), 2).shape == (0, 42, 3)


def test_anchors_turned_rigidly_turn_the_cage_with_enough_rounds_only(binding):
    """The rigid motion has no energy: the rounds come to it, and the linear solve shears."""
    turn = Rotation.from_rotvec([0.2, -0.5, 0.9]).as_matrix()
    poser = FreePoser(binding, some_anchors(12, hard=range(12)))
    at_rest = anchor_matrix(poser.anchors, binding.weights) @ CAGE.vertices
    moves, rigid = at_rest @ turn.T - at_rest, CAGE.vertices @ turn.T
    errors = [np.abs(poser.solve_cage(moves, rounds) - rigid).max() for rounds in (0, 3, 30, 1000)]
    assert errors[0] > 0.1 * CAGE.diagonal
    assert errors[0] > errors[1] > errors[2] > errors[3]
    assert errors[3] < 1e-6 * CAGE.diagonal


def test_hard_anchors_on_one_point_are_refused_and_soft_ones_meet_half_way(binding):
    anchors, moves = some_anchors(4), some_moves(4)
    point = anchors[1].point
    twins = [Anchor("toe", point), Anchor("heel", point)]
    soft = FreePoser(binding, [*anchors, *twins], alpha=1e-9)
    found = reached(soft, np.vstack([moves, [[0, 0, 0], [0, 0, 1]]]))
    np.testing.assert_allclose(found[4], found[5])
    weight = anchors[1].weight
    mean = (moves[1] * weight + [0, 0, 1]) / (weight + 2)
    np.testing.assert_allclose(found[4], mean, atol=1e-5)
    hard = [Anchor(anchor.name, point, hard=True) for anchor in twins]
    says = r"^anchors 'heel' and 'toe' conflict \(condition number inf, limit 1e12\): remove one"
    with pytest.raises(NumericalError, match=says):
        FreePoser(binding, [*anchors, hard[1], hard[0]])


def test_more_hard_anchors_than_the_cage_can_follow_are_refused(binding):
    with pytest.raises(NumericalError, match=r"^anchors 'a\d+', 'a\d+' and 'a\d+' conflict"):
        FreePoser(binding, some_anchors(43, hard=range(43)))
    assert FreePoser(binding, some_anchors(43)).condition_number < 1e12


def test_a_hard_anchor_on_a_locked_cage_vertex_is_refused_alone(binding):
    """Only this anchor is named."""
    weights = binding.weights.copy()
    weights[0] = np.eye(42)[5]
    held = Binding(binding.rest, CAGE, weights)
    corner = Anchor("corner", point_at_vertex(held.rest, 0), hard=True)
    others = [Anchor("other", point_at_vertex(held.rest, 4), hard=True)]
    says = r"^anchor 'corner' cannot be met \(condition number inf, limit 1e12\)"
    with pytest.raises(NumericalError, match=says):
        FreePoser(held, [*others, corner], constraints=CageConstraints((5,)))
    soft = FreePoser(
        held, [*others, Anchor("corner", corner.point)], constraints=CageConstraints((5,))
    )
    np.testing.assert_array_equal(soft.solve_cage(some_moves(2))[5], CAGE.vertices[5])


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize("name", ["alpha", "beta"])
def test_invalid_weights_are_refused(binding, name, value):
    with pytest.raises(SettingError, match=f"`{name}=` is {value}"):
        FreePoser(binding, [], **{name: value})


@settings(max_examples=15)
@given(
    st.integers(1, 12),
    st.integers(0, 10**6),
    st.floats(1e-3, 1e3),
    st.sampled_from([0, 3]),
    st.booleans(),
)
def test_posing_commutes_with_motions_and_units(binding, count, seed, scale, rigidity, is_hard):
    """Everything scaled, turned and moved: cage, model, targets."""
    anchors = some_anchors(count, seed, hard=range(0, count, 3) if is_hard else ())
    moves, turn, shift = some_moves(count, seed), scale * rotation(seed), np.array([5.0, -3, 1])
    cage = TriMesh(CAGE.vertices @ turn.T + scale * shift, CAGE.faces)
    rest = TriMesh(binding.rest.vertices @ turn.T + scale * shift, FACES)
    found = FreePoser(Binding(rest, cage, binding.weights), anchors).solve_mesh(
        moves @ turn.T, rigidity
    )
    expected = FreePoser(binding, anchors).solve_mesh(moves, rigidity) @ turn.T + scale * shift
    np.testing.assert_allclose(found, expected, atol=1e-9 * scale)


@settings(max_examples=15)
@given(st.integers(1, 12), st.integers(0, 10**6), st.floats(-3, 3))
def test_poses_add_up(binding, count, seed, share):
    """Without rigidity everything is linear in the anchors' displacements."""
    poser = FreePoser(binding, some_anchors(count, seed))
    one, two = some_moves(count, seed), some_moves(count, seed + 1)
    moved = [poser.solve_cage(moves) - CAGE.vertices for moves in (one, two, one + share * two)]
    np.testing.assert_allclose(moved[2], moved[0] + share * moved[1], atol=1e-10)


@pytest.mark.parametrize("mirror", [None, MIRROR], ids=["plain", "mirror"])
@pytest.mark.parametrize("rigidity", [0, 4])
def test_hard_anchors_are_met_at_large_condition_numbers(mirror, rigidity):
    """Two anchors close together leave a system that has lost most digits."""
    held = bound(ROUND)
    shares = np.array([[0.3, 0.3, 0.4], [0.3 + 4e-5, 0.3 - 4e-5, 0.4], [0.2, 0.5, 0.3]])
    faces = held.rest.faces[[0, 0, 9]]
    anchors = [
        Anchor(f"a{k}", SurfacePoint(face, share), hard=True)
        for k, (face, share) in enumerate(zip(faces, shares, strict=True))
    ]
    poser = FreePoser(held, anchors, constraints=CageConstraints((3, 11), mirror))
    assert 1e8 < poser.condition_number < 1e12
    moves = some_moves(3)
    assert np.abs(reached(poser, moves, rigidity) - moves).max() < 1e-9


def test_large_motions_with_rigidity_do_not_jump():
    """The largest step on a way to far targets, halved again and again, becomes small."""
    rest, cage = load_mesh(WALKER / "frames/walker_1.obj"), load_mesh(WALKER / "cage.obj")
    generator = np.random.default_rng(11)
    chosen = generator.choice(len(rest.vertices), 4, replace=False)
    anchors = [Anchor(f"a{k}", point_at_vertex(rest, int(k))) for k in chosen]
    poser = FreePoser(bind(rest, cage, coordinates="mean-value"), anchors)
    moves = generator.normal(size=(4, 3))
    moves *= 1.2 * rest.diagonal / np.linalg.norm(moves, axis=1).max()

    def pose(share):
        return poser.solve_cage(share * moves, rigidity=50)

    shares = np.linspace(0.2, 1, 21)
    poses = [pose(share) for share in shares]
    k = int(np.argmax([np.abs(b - a).max() for a, b in pairwise(poses)]))
    (low, high), (first, last) = shares[k : k + 2], poses[k : k + 2]
    for _ in range(20):
        middle = (low + high) / 2
        found = pose(middle)
        if np.abs(found - first).max() > np.abs(last - found).max():
            high, last = middle, found
        else:
            low, first = middle, found
    assert np.abs(last - first).max() < 1e-4 * rest.diagonal
