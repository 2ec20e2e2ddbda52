import numpy as np
import pytest

from cageik_cli.cages.builder.collapse import simplify_shell
from cageik_cli.cages.builder.loops import CentreLine, find_centre, find_limbs, measure_length
from cageik_cli.cages.builder.shell import DistanceGrid, make_shell
from tests.benchmarks.simple_shapes import revolve
from tests.shapes import ball, box, changed, finer, merged, moved


def make_rod(length=3.0, bend=0.0):
    """A rod of radius 0.25 along z, with its middle at 0; its ends are bent to x by `bend`."""
    rings = [(0.25, z) for z in np.linspace(-0.5, 0.5, 15 * round(length) + 1) * length]
    mesh = revolve([(0, -length / 2), *rings, (0, length / 2)], across=24)
    x, y, z = mesh.vertices.T
    return changed(mesh, vertices=np.stack([x + bend * z**2, y, z], axis=1))


def scaled(mesh):
    """The mesh with a diagonal of one, as shells have."""
    return changed(mesh, vertices=mesh.vertices / mesh.diagonal)


def test_both_ends_of_a_rod_are_limbs_with_tips_at_the_ends():
    rod = make_rod()
    limbs = find_limbs(scaled(rod))
    assert len(limbs) == 2
    for limb in limbs:
        assert 0.35 < limb.tip - limb.base < 0.55
        np.testing.assert_allclose(limb.diameter, 0.5 / rod.diagonal, rtol=0.02)


def test_a_ball_has_no_limbs():
    assert find_limbs(scaled(ball(4))) == []


def test_a_short_rod_has_no_limbs():
    assert find_limbs(scaled(make_rod(length=0.8))) == []


def test_sections_of_a_limb_are_those_of_the_rod():
    rod = make_rod()
    for limb in find_limbs(scaled(rod)):
        heights = np.linspace(limb.base, limb.tip, 9)[1:-1]
        for section, centre in zip(limb.cut(heights), limb.line.place(heights), strict=True):
            length = measure_length(section) * rod.diagonal
            np.testing.assert_allclose(length, 0.5 * np.pi, rtol=0.02)
            np.testing.assert_allclose(find_centre(section)[:2], 0, rtol=0, atol=0.005)
            np.testing.assert_allclose(centre[:2], 0, rtol=0, atol=0.005)


def test_the_centre_line_follows_a_bend():
    rod = make_rod(bend=0.3)
    for limb in find_limbs(scaled(rod)):
        places = limb.line.place(np.linspace(limb.base, limb.tip, 7)[:-1])
        x, _, z = places.T * rod.diagonal
        np.testing.assert_allclose(x, 0.3 * z**2, rtol=0, atol=0.08)


def test_fingers_are_limbs_of_their_own():
    """A block with three rods in it."""
    rods = [moved(make_rod(), (0, y, 3)) for y in (-1.2, 0, 1.2)]
    grid = DistanceGrid(scaled(merged(finer(box(2), 3), *rods)), 0.014, 0.05)
    shell = make_shell(grid, 0.016, 0.016)
    assert shell is not None
    limbs = find_limbs(simplify_shell(shell.surface, 1200)[0])
    assert len(limbs) == 3
    assert min(limb.tip - limb.base for limb in limbs) > 0.15


@pytest.mark.parametrize("height", [-0.5, 0.0, 0.25, 1.0, 1.7, 3.0])
def test_heights_and_places_of_a_centre_line_agree(height):
    line = CentreLine(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]]))
    place = line.place(np.array([height]))
    expected = [height, 0, 0] if height <= 1 else [1, height - 1, 0]
    np.testing.assert_allclose(place[0], expected, atol=1e-12)
    np.testing.assert_allclose(line.measure_heights(place), height, atol=1e-12)


def test_directions_turn_at_a_corner():
    line = CentreLine(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]]))
    ways = line.find_directions(np.array([0.5, 1.0, 1.5]), 0.1)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(ways, [[1, 0, 0], [half, half, 0], [0, 1, 0]], atol=1e-12)


def test_the_centre_of_a_section_weighs_segments_by_their_length():
    segments = np.array([[[0.0, 0, 0], [3, 0, 0]], [[0, 0, 0], [0, 1, 0]]])
    assert measure_length(segments) == 4
    np.testing.assert_allclose(find_centre(segments), [3 * 1.5 / 4, 0.5 / 4, 0])
