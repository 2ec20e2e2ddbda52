"""Holding the rest: the minimum by another solver, what moves and what stays, on a real figure."""

import numpy as np
import pytest

from cageik_cli import bind, load_mesh
from cageik_cli.cages.bind import bind as bind_meshes
from cageik_cli.geometry.mesh import signed_volumes
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.geometry.points import PointCloud
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.method.pose.anchors import Anchor, anchor_matrix, point_at_vertex
from cageik_cli.method.pose.constraints import CageConstraints
from cageik_cli.method.pose.hold import (
    HOLD,
    LEVEL_SHARES,
    LEVELS,
    LONG_ARM,
    MAX_RADIUS,
    MIN_RADIUS,
    SHORT_ARM,
    HeldSurface,
    fall_off,
    swing,
)
from cageik_cli.method.pose.poser import Poser
from cageik_cli.method.weights.binding import Binding
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.errors import HandlesError
from tests.shapes import ball, box, finer, merged, moved, rotation

HAND, ELBOW, FOOT, OTHER_HAND = 1034, 1367, 995, 1130


@pytest.fixture(scope="module")
def walker():
    folder = "data_fixtures/walker"
    rest = load_mesh(f"{folder}/frames/walker_1.obj")
    return bind(rest, load_mesh(f"{folder}/cage.obj"), accuracy="preview")


@pytest.fixture(scope="module")
def round_one():
    return bind_meshes(ball(levels=2, size=0.9), finer(box(2.0), 1), BindSettings("mean-value"))


def anchors_at(binding, *vertices, **others):
    return [Anchor(str(k), point_at_vertex(binding.rest, k), **others) for k in vertices]


def build_targets(poser, cage, displacements):
    """u, (m, 3), vertex by vertex: what each reach does there, by its share."""
    weights = poser.binding.weights
    mesh, diagonal = weights @ cage, poser.binding.rest.diagonal
    claims, motions = [], []
    for reach in poser.reaches:
        point = poser.anchors[reach.anchor].point
        away = HeldSurface(poser.binding)._distances.measure(point.corners, point.barycentric)
        claims.append(reach.strength / np.maximum(away / diagonal, 1e-4) ** 2)
        np.testing.assert_allclose(reach.strength, fall_off(away / reach.radius), atol=1e-15)
        *blocks, shift = np.split(
            reach.compute_motion(reach.find_arms(cage), displacements[reach.anchor]),
            np.arange(3, 3 * LEVELS + 1, 3),
        )
        arms, level = mesh - reach.pivot @ cage, LEVELS * reach.strength
        total = np.zeros_like(mesh)
        for k, (block, s) in enumerate(zip(blocks, LEVEL_SHARES, strict=True), start=1):
            hat = np.maximum(0, 1 - np.abs(level - k))[:, None]
            total += hat * (arms @ block + s * shift)
        motions.append(total)
    claims = np.array(claims) / np.maximum(np.sum(claims, axis=0), 1e-300)
    return np.einsum("sm,smc->mc", claims, np.array(motions))


def test_it_is_the_minimum_of_three_terms(walker):
    """By `lstsq` on all rows, with targets that are built vertex by vertex."""
    alpha, beta = 1e-3, 0.7
    anchors = anchors_at(walker, HAND, FOOT, ELBOW)
    poser = Poser(walker, anchors, alpha, beta)
    moves = np.array([[0.2, 0.3, 0.1], [0.0, 0.0, 0.0], [0.0, 0.1, 0.1]])
    cage, (m, n) = walker.cage.vertices, walker.weights.shape
    u = build_targets(poser, cage, moves)
    rows = anchor_matrix(anchors, walker.weights)
    smooth, dense, sparse = np.sqrt([alpha / n, alpha * HOLD / m, beta / len(rows)])
    matrix = np.vstack(
        [smooth * uniform_laplacian(walker.cage), dense * walker.weights, sparse * rows]
    )
    right = np.vstack([np.zeros((n, 3)), dense * u, sparse * moves])
    expected = np.linalg.lstsq(matrix, right, rcond=None)[0]
    np.testing.assert_allclose(poser.solve_cage(moves) - cage, expected, rtol=0, atol=1e-9)


def test_all_ways_to_pose_agree(walker):
    poser = Poser(walker, anchors_at(walker, HAND, FOOT))
    moves = np.array([[0.2, 0.3, 0.1], [0.0, 0.1, 0.0]])
    cage = poser.solve_cage(moves)
    rest = walker.rest.vertices + walker.weights @ (cage - walker.cage.vertices)
    np.testing.assert_allclose(poser.solve_mesh(moves), rest, rtol=0, atol=1e-12)
    cages = np.repeat(walker.cage.vertices[None], 2, axis=0)
    edited = poser.edit_cages(cages, np.stack([moves, 0 * moves]))
    np.testing.assert_allclose(edited[0], cage, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(edited[1], walker.cage.vertices)


@pytest.mark.parametrize("move", [[0, 1, 0], [1, 0, 0], [0, 0, 1], [0, -1, 0], [0, 0, -1]])
@pytest.mark.parametrize("turn", [None, 3])
def test_an_arm_moves_and_the_rest_stays(walker, move, turn):
    """By a fifth of the size: at most 15 % move by half a percent of it, the volume by 5 %."""
    poser = Poser(walker, anchors_at(walker, HAND))
    diagonal = walker.rest.diagonal
    axes = np.eye(3) if turn is None else rotation(turn)
    moves = (0.2 * diagonal * np.array([move], float)) @ axes
    cages = (walker.cage.vertices @ axes)[None]
    before, edited = walker.weights @ cages, poser.edit_cages(cages, moves[None])
    after = before + walker.weights @ (edited - cages)
    distances = np.linalg.norm(after - before, axis=2)[0]
    assert (distances > 0.005 * diagonal).mean() < 0.15
    volumes = signed_volumes(np.concatenate([before, after]), walker.rest.faces)
    assert abs(volumes[1] / volumes[0] - 1) < 0.05
    assert np.abs(after[0, HAND] - before[0, HAND] - moves[0]).max() < 1e-6 * diagonal
    # The other side, and the feet.
    assert distances[[OTHER_HAND, FOOT]].max() < 1e-3 * diagonal
    # All of it without the hold.
    free = Poser(walker, anchors_at(walker, HAND), hold=False).edit_cages(cages, moves[None])
    assert (np.linalg.norm(walker.weights @ (free - cages), axis=2) > 0.1 * diagonal).all()


def test_edits_turn_with_the_cage(walker):
    poser, axes = Poser(walker, anchors_at(walker, HAND, ELBOW)), rotation(5)
    moves = np.array([[0.1, 0.4, 0.2], [0.0, 0.1, 0.0]])
    straight = poser.edit_cages(walker.cage.vertices[None], moves[None])[0]
    turned = poser.edit_cages((walker.cage.vertices @ axes + 2)[None], (moves @ axes)[None])[0]
    np.testing.assert_allclose(turned, straight @ axes + 2, rtol=0, atol=1e-8)


def test_a_radius_says_how_far(walker):
    distances = HeldSurface(walker)._distances
    point = point_at_vertex(walker.rest, HAND)
    away = distances.measure(point.corners, point.barycentric)
    moves, moved_shares = np.array([[0.0, 0.05, 0.0]]), []
    for radius in (0.02, 0.2, 0.6):
        poser = Poser(walker, anchors_at(walker, HAND, radius=radius))
        (reach,) = poser.reaches
        assert reach.radius == radius
        np.testing.assert_array_equal(reach.strength > 0, away < radius)
        mesh = poser.solve_mesh(moves)
        assert np.abs(mesh[HAND] - walker.rest.vertices[HAND] - moves[0]).max() < 1e-5
        moved_shares.append(np.linalg.norm(mesh - walker.rest.vertices, axis=1) > 0.005)
    shares = [one.mean() for one in moved_shares]
    assert shares == sorted(shares)
    assert shares[0] < shares[2]


def test_a_chosen_radius_reaches_a_share_of_the_area_within_bounds(walker):
    (reach,) = Poser(walker, anchors_at(walker, HAND)).reaches
    assert MIN_RADIUS < reach.radius / walker.rest.diagonal < MAX_RADIUS
    surface = HeldSurface(walker)
    away = np.linspace(0, 1, len(walker.rest.vertices)) * 10 * walker.rest.diagonal
    assert surface.choose_radius(away) == MAX_RADIUS * walker.rest.diagonal
    assert surface.choose_radius(0 * away) == MIN_RADIUS * walker.rest.diagonal


def test_points_without_faces_are_held_too():
    points = np.random.default_rng(0).normal(size=(400, 3)) * [0.2, 0.2, 0.6]
    points = points[np.abs(points).max(axis=1) < 0.95]
    cloud = PointCloud.from_points(points)
    binding = bind_meshes(cloud, finer(box(2.0), 2), BindSettings("mean-value"))
    tip = int(points[:, 2].argmax())
    mesh = Poser(binding, anchors_at(binding, tip)).solve_mesh(np.array([[0.1, 0.0, 0.0]]))
    assert np.abs(mesh[tip] - points[tip] - [0.1, 0, 0]).max() < 1e-4
    far = np.linalg.norm(points - points[tip], axis=1) > 1.2
    assert np.linalg.norm(mesh - points, axis=1)[far].max() < 0.03


def test_a_mirror_moves_both_sides_alike(round_one):
    mirror = Mirror(np.array([1.0, 0, 0]), np.zeros(3))
    rest = round_one.rest.vertices
    side = int((rest[:, 0] + 0.1 * rest[:, 1]).argmax())
    poser = Poser(round_one, anchors_at(round_one, side), constraints=CageConstraints((), mirror))
    assert [reach.mirror for reach in poser.reaches] == [None, mirror]
    moves = np.array([[0.1, 0.2, 0.05]])
    cage, mesh = poser.solve_cage(moves), poser.solve_mesh(moves)
    partners = np.linalg.norm(
        mirror.reflect(round_one.cage.vertices)[:, None] - round_one.cage.vertices, axis=2
    ).argmin(axis=1)
    np.testing.assert_allclose(mirror.reflect(cage), cage[partners], rtol=0, atol=1e-9)
    expected = rest + round_one.weights @ (cage - round_one.cage.vertices)
    np.testing.assert_allclose(mesh, expected, rtol=0, atol=1e-12)
    assert np.abs(mesh[side] - rest[side] - moves[0]).max() < 1e-5
    edited = poser.edit_cages(round_one.cage.vertices[None], moves[None])[0]
    np.testing.assert_allclose(edited, cage, rtol=0, atol=1e-12)


def test_a_component_of_the_cage_without_the_model_stays():
    """Its weights are zero: nothing but the Laplacian says where it is, and it is free."""
    cage = merged(box(2.0), moved(box(1.0), shift=(5, 0, 0)))
    inner = bind_meshes(ball(levels=2, size=0.9), box(2.0), BindSettings("mean-value"))
    weights = np.column_stack([inner.weights, np.zeros((len(inner.weights), 8))])
    poser = Poser(Binding(inner.rest, cage, weights), anchors_at(inner, 0))
    posed = poser.solve_cage(np.array([[0.1, 0.2, 0.0]]))
    np.testing.assert_allclose(posed[8:], cage.vertices[8:], rtol=0, atol=1e-9)
    assert np.isfinite(posed).all()
    assert poser.free_modes == 1


def test_anchors_may_be_added_and_left_out(walker):
    moves = np.array([[0.1, 0.2, 0.0], [0.0, 0.0, 0.1]])
    hand, foot = anchors_at(walker, HAND, FOOT)
    grown = Poser(walker, [hand]).with_anchor(foot)
    np.testing.assert_allclose(
        grown.solve_mesh(moves), Poser(walker, [hand, foot]).solve_mesh(moves), rtol=0, atol=1e-12
    )
    assert len(grown.without_anchor(foot.name).reaches) == 1


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_a_radius_is_above_zero(walker, radius):
    with pytest.raises(HandlesError, match="radius is"):
        anchors_at(walker, HAND, radius=radius)


def list_levels(arm, displacement, radius=1.0):
    """M for each level, as a map of points from the pivot."""
    *blocks, shift = np.split(
        swing(np.array(arm, float), np.array(displacement, float), radius),
        np.arange(3, 3 * LEVELS + 1, 3),
    )
    return [
        (np.eye(3) + block, s * shift[0]) for block, s in zip(blocks, LEVEL_SHARES, strict=True)
    ]


@pytest.mark.parametrize(
    "end", [[0, 1, 0], [0.6, 0.8, 0], [1, 0, 0], [0, 0, -1], [1e-9, 1, 0], [-1, 0, 0]]
)
def test_an_arm_that_keeps_its_length_is_rotated(end):
    arm = np.array([1.0, 0, 0])
    (half, _), (whole, shift) = list_levels(arm, np.array(end, float) - arm)
    for turn in (half, whole):
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), rtol=0, atol=1e-9)
        assert np.linalg.det(turn) == pytest.approx(1, abs=1e-9)
    np.testing.assert_allclose(half @ half, whole, rtol=0, atol=1e-8)
    np.testing.assert_allclose(arm @ whole, end, rtol=0, atol=1e-9)
    np.testing.assert_allclose(shift, 0, rtol=0, atol=1e-9)


def test_a_stretched_arm_keeps_its_volume():
    (_, _), (whole, shift) = list_levels([0.8, 0, 0], [0, 0.3, 0.2])
    assert np.linalg.det(whole) == pytest.approx(1, rel=1e-12)
    np.testing.assert_allclose([0.8, 0, 0] @ whole + shift, [0.8, 0.3, 0.2], rtol=0, atol=1e-12)


@pytest.mark.parametrize("length", [1e-12, 0.5 * SHORT_ARM, 0.3, 2 * LONG_ARM])
@pytest.mark.parametrize("move", [[0.1, 0.2, 0.3], [0, 0, 3.0], [-5.0, 0, 0]])
def test_the_end_of_an_arm_goes_where_it_is_to(length, move):
    arm = np.array([0, 0, length])
    whole, shift = list_levels(arm, move)[-1]
    np.testing.assert_allclose(arm @ whole + shift, arm + move, rtol=0, atol=1e-12)
    if length < SHORT_ARM:
        np.testing.assert_array_equal(whole, np.eye(3))


def test_an_arm_that_ends_at_its_pivot_is_moved():
    whole, shift = list_levels([0, 0, 1.0], [0, 0, -1.0])[-1]
    np.testing.assert_array_equal(whole, np.eye(3))
    np.testing.assert_array_equal(shift, [0, 0, -1])


@pytest.mark.parametrize("hold", [True, False])
def test_a_handle_on_the_plane_of_a_mirror_stays_on_it(round_one, hold):
    mirror = Mirror(np.array([1.0, 0, 0]), np.zeros(3))
    rest = round_one.rest.vertices
    middle = int(np.lexsort((-rest[:, 1], np.abs(rest[:, 0]).round(9)))[0])
    poser = Poser(
        round_one,
        anchors_at(round_one, middle),
        constraints=CageConstraints((), mirror),
        hold=hold,
    )
    mesh = poser.solve_mesh(np.array([[0.3, 0.2, 0.0]]))
    np.testing.assert_allclose(mesh[middle] - rest[middle], [0, 0.2, 0], rtol=0, atol=1e-5)
    assert np.linalg.norm(mesh - rest, axis=1).max() < 0.3
