import numpy as np
import pytest
import scipy.linalg

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.method.pose.constraints import CageConstraints, free_basis, mirror_pairs
from cageik_cli.method.pose.poser import MirroredMap
from cageik_cli.util.errors import HandlesError
from tests.shapes import ball, box, changed, rotation

TURN = rotation(5)
CAGE = changed(ball(1, 2.0), vertices=ball(1, 2.0).vertices @ TURN.T + [3.0, 0, -1])
MIRROR = Mirror(-7 * TURN[:, 1], np.array([3.0, 0, -1]))


def flip():
    return np.eye(3) - 2 * np.outer(TURN[:, 1], TURN[:, 1])


def test_mirror_images_are_as_far_behind_the_plane():
    points = np.random.default_rng(0).normal(size=(4, 5, 3))
    images = MIRROR.reflect(points)
    np.testing.assert_allclose(MIRROR.reflect(images), points, atol=1e-14)
    np.testing.assert_allclose((images + points - 2 * MIRROR.point) @ MIRROR.normal, 0, atol=1e-13)
    np.testing.assert_allclose(np.cross(images - points, MIRROR.normal), 0, atol=1e-14)
    assert np.linalg.norm(MIRROR.normal) == pytest.approx(1)


def test_partners_are_each_others_mirror_images():
    partner = mirror_pairs(CAGE, MIRROR)
    np.testing.assert_array_equal(partner[partner], np.arange(len(partner)))
    np.testing.assert_allclose(MIRROR.reflect(CAGE.vertices), CAGE.vertices[partner], atol=1e-14)
    on_plane = np.abs((CAGE.vertices - MIRROR.point) @ MIRROR.normal) < 1e-12
    np.testing.assert_array_equal(partner == np.arange(len(partner)), on_plane)


def test_a_cage_may_be_slightly_asymmetric():
    noise = np.random.default_rng(1).uniform(-1, 1, CAGE.vertices.shape)
    for size, fits in ((2e-4, True), (2e-3, False)):
        cage = changed(CAGE, vertices=CAGE.vertices + size * CAGE.diagonal * noise)
        if fits:
            np.testing.assert_array_equal(mirror_pairs(cage, MIRROR), mirror_pairs(CAGE, MIRROR))
        else:
            with pytest.raises(HandlesError, match=r"16 of 18 cage vertices .* 0\.1 %"):
                mirror_pairs(cage, MIRROR)


@pytest.mark.parametrize(
    ("constraints", "rank"),
    [
        (CageConstraints(), 18),
        (CageConstraints((0, 7, 7)), 16),
        (CageConstraints(mirror=MIRROR), None),
        (CageConstraints((0, 7), MIRROR), None),
        (CageConstraints(tuple(range(18))), 0),
    ],
)
def test_the_free_basis_spans_what_constraints_allow(constraints, rank):
    """Both coordinates' bases together span the null space of all conditions."""
    signs = (1, -1) if constraints.mirror else (1,)
    conditions = [np.eye(18)[list(constraints.locked)]]
    for sign in signs:
        rows = list(conditions)
        if constraints.mirror:
            partner = mirror_pairs(CAGE, MIRROR)
            rows += [np.eye(18)[partner] - sign * np.eye(18)]
        expected = scipy.linalg.null_space(np.vstack([*rows, np.zeros((1, 18))]))
        basis = free_basis(CAGE, constraints, sign)
        np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-14)
        np.testing.assert_allclose(basis @ basis.T, expected @ expected.T, atol=1e-12)
        assert rank in (None, basis.shape[1])


def test_a_mirrored_map_is_two_maps_along_and_across():
    generator = np.random.default_rng(2)
    along, across, more = generator.normal(size=(3, 6, 6))
    points = generator.normal(size=(4, 6, 3))
    normal = MIRROR.normal
    split = np.outer(normal, normal)
    expected = along @ points @ (np.eye(3) - split) + across @ points @ split
    mapped = MirroredMap([along, across], MIRROR)
    np.testing.assert_allclose(mapped(points), expected, atol=1e-13)
    np.testing.assert_allclose(added(mapped, points[0]), expected[0], atol=1e-13)
    np.testing.assert_allclose(mapped.compose(more)(points), more @ expected, atol=1e-12)
    free = MirroredMap([along], None)
    np.testing.assert_allclose(free(points), along @ points, atol=1e-14)
    np.testing.assert_allclose(added(free, points[0]), along @ points[0], atol=1e-13)
    np.testing.assert_allclose(free.compose(more)(points), more @ along @ points, atol=1e-13)


def added(mapped, points):
    """What a map adds to some positions."""
    positions = np.random.default_rng(3).normal(size=(3, 6))
    columns = positions.copy()
    mapped.add_to(columns, points)
    return (columns - positions).T


@pytest.mark.parametrize("order", "CF")
def test_no_points_add_nothing_and_maps_have_any_memory_order(order):
    assert not added(MirroredMap([np.zeros((6, 0), order=order)], None), np.zeros((0, 3))).any()
    along = np.array(np.arange(24.0).reshape(6, 4), order=order)
    points = np.array(np.arange(12.0).reshape(4, 3), order=order)
    np.testing.assert_allclose(
        added(MirroredMap([along], None), points), along @ points, atol=1e-13
    )


@pytest.mark.parametrize(
    ("normal", "point"),
    [([0.0, 0, 0], [0.0, 0, 0]), ([1, 0, np.nan], [0.0, 0, 0]), ([1.0, 0, 0], [np.inf, 0, 0])],
)
def test_invalid_planes_are_refused(normal, point):
    with pytest.raises(HandlesError, match=r"normal is \[.*\] and point \["):
        Mirror(np.array(normal), np.array(point))


def test_cages_that_are_not_symmetric_are_refused_naming_vertices():
    vertices, partner = CAGE.vertices.copy(), mirror_pairs(CAGE, MIRROR)
    assert partner[4] == 9 or (partner[4] == 4 and partner[9] == 9)
    vertices[[4, 9]] += 0.1
    with pytest.raises(HandlesError, match=r"2 of 18 cage vertices .* 0\.1 % .*\(4, 9\)"):
        mirror_pairs(changed(CAGE, vertices=vertices), MIRROR)
    with pytest.raises(HandlesError, match="18 of 18 cage vertices"):
        mirror_pairs(CAGE, Mirror(MIRROR.normal, MIRROR.point + MIRROR.normal))


def test_two_vertices_that_share_a_partner_are_refused():
    """Two at one place have the same image: whose partner is whose cannot be told."""
    twice = box(1.0)
    doubled = TriMesh(np.vstack([twice.vertices, twice.vertices[:1]]), twice.faces)
    with pytest.raises(HandlesError, match=r"not symmetric.* 1 of 9 .*\(8\)"):
        mirror_pairs(doubled, Mirror(np.array([1.0, 0, 0]), np.zeros(3)))


@pytest.mark.parametrize("vertex", [-1, 18])
def test_locked_vertices_that_do_not_exist_are_refused(vertex):
    with pytest.raises(HandlesError, match=f"^locked: .* {vertex}; .* 18, numbered from 0 to 17"):
        free_basis(CAGE, CageConstraints((3, vertex)), 1)
