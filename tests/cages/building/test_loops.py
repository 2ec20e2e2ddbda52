import numpy as np
import pytest

from cageik_cli.cages.build import NO_LOOPS_NOTE, build_cage
from cageik_cli.cages.building.judge import Demand
from cageik_cli.cages.building.loops import NO_LOOPS, Loops, collapse_around, lay_loops
from cageik_cli.cages.building.motion import Motion
from cageik_cli.cages.building.polish import flip_edge
from cageik_cli.cages.building.quads import make_quads
from cageik_cli.cages.building.refine import make_draft, replace_weak_vertices
from cageik_cli.cages.building.shift import shift_vertices
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.shape import bounds_volume
from cageik_cli.util.errors import SettingError
from tests.cages.building.test_limbs import make_rod, scaled
from tests.shapes import box

COUNT, BEND = 60, 0.06


@pytest.fixture(scope="module")
def rod():
    """A bent rod, its diagonal one."""
    return scaled(make_rod(bend=BEND))


@pytest.fixture(scope="module")
def laid(rod):
    return lay_loops(rod, COUNT, None)


@pytest.fixture(scope="module")
def built(rod):
    return build_cage(rod, BuildSettings(COUNT, loops=True))


def list_edges(mesh):
    return set(map(tuple, mesh.edges.ends.tolist()))


def test_tubes_close_the_shell_and_come_first(rod, laid):
    cage, loops = laid
    assert bounds_volume(cage)
    assert len(loops.tubes) == 2
    assert np.concatenate([t.ravel() for t in loops.tubes]).tolist() == list(
        range(loops.vertex_count)
    )
    assert loops.edges <= list_edges(cage)
    assert cage.volume > 0.98 * rod.volume


def test_loops_have_four_to_six_vertices_and_at_most_half_of_the_cage(laid):
    _, loops = laid
    assert all(4 <= tube.shape[1] <= 6 and len(tube) >= 2 for tube in loops.tubes)
    assert loops.vertex_count <= 0.55 * COUNT


def test_loops_lie_around_the_limb(rod, laid):
    """The middle of each is on the centre line of the rod."""
    cage, loops = laid
    scale = 1 / make_rod(bend=BEND).diagonal
    for tube in loops.tubes:
        middles = cage.vertices[tube[:-1]].mean(axis=1) / scale
        np.testing.assert_allclose(middles[:, 0], BEND * middles[:, 2] ** 2, rtol=0, atol=0.08)
        # From the base to the tip, with the tip inside the last loop.
        assert (np.diff(np.abs(middles[:, 2])) > 0).all()


def test_collapses_leave_loops_where_they_are(laid):
    cage, loops = laid
    small = collapse_around(cage, 45, None, 1e-4, loops)
    assert len(small.vertices) == 45
    assert bounds_volume(small)
    kept = slice(loops.vertex_count)
    np.testing.assert_array_equal(small.vertices[kept], cage.vertices[kept])
    assert loops.edges <= list_edges(small)


def test_edits_keep_the_edges_of_loops(built):
    loops = built.chosen.loops
    assert built.chosen.verdict.is_valid
    assert loops.count >= 4
    assert loops.edges <= list_edges(built.cage)


def test_an_edge_of_a_loop_is_neither_flipped_nor_split(rod, built):
    demand = Demand(rod, BuildSettings(COUNT))
    placed = built.cage.move(demand.frame.to_units(built.cage.vertices))
    loops = built.chosen.loops
    edge = sorted(loops.edges)[0]
    for known, is_refused in ((loops, True), (NO_LOOPS, False)):
        draft = make_draft(placed, demand, demand.samples[:0], known)
        flip = flip_edge(draft, *edge)
        assert flip is not None
        assert draft.is_divisible(*edge) != is_refused
        assert draft._keeps_edges(flip) != is_refused


def test_more_loops_lie_where_an_animation_bends(rod):
    """A rod that bends at its quarter is straight at rest; a tube cannot follow without a loop."""
    straight = scaled(make_rod())
    z = straight.vertices[:, 2]
    at, high = 0.25 * np.ptp(z), z > 0.25 * np.ptp(z)
    frame = straight.vertices.copy()
    angle = np.deg2rad(60)
    x, dz = frame[high, 0], frame[high, 2] - at
    frame[high, 0] = np.cos(angle) * x + np.sin(angle) * dz
    frame[high, 2] = at - np.sin(angle) * x + np.cos(angle) * dz
    motion = Motion(straight.vertices, frame[None])
    cage, loops = lay_loops(straight, COUNT, motion)
    heights = np.concatenate([cage.vertices[tube, 2].mean(axis=1) for tube in loops.tubes])
    assert np.abs(heights - at).min() < 0.06
    bent, still = (
        next(tube for tube in loops.tubes if np.sign(cage.vertices[tube, 2].mean()) == side)
        for side in (1, -1)
    )
    assert len(bent) > len(still)


@pytest.mark.slow
def test_shifts_and_quads_keep_loops(rod, built):
    demand = Demand(rod, BuildSettings(COUNT, quads=True, loops=True))
    placed = built.cage.move(demand.frame.to_units(built.cage.vertices))
    loops = built.chosen.loops
    wave = rod.vertices + 0.1 * np.sin(6 * rod.vertices[:, 2:]) * [[0, 1, 0]]
    motion = Motion(demand.frame.to_units(rod.vertices), demand.frame.to_units(wave)[None])
    shifted, _ = shift_vertices(placed, demand, motion, loops)
    assert loops.edges <= list_edges(shifted)
    assert loops.edges <= list_edges(replace_weak_vertices(placed, demand, loops))
    quads = make_quads(placed, demand, loops)
    polygons = quads.polygons
    rings = np.split(polygons.corners, polygons.starts[1:])
    sides = {tuple(sorted(s)) for r in rings for s in zip(r, np.roll(r, -1), strict=True)}
    assert loops.edges <= sides


def test_a_cube_has_no_loops_and_a_note_says_so(coarse_grids):
    built = build_cage(box(), BuildSettings(30, loops=True))
    assert built.chosen.loops.count == 0
    assert NO_LOOPS_NOTE in built.notes
    plain = build_cage(box(), BuildSettings(30))
    assert NO_LOOPS_NOTE not in plain.notes
    np.testing.assert_array_equal(plain.cage.vertices, built.cage.vertices)


def test_too_few_vertices_leave_a_shell_without_loops(rod):
    shell, loops = lay_loops(rod, 10, None)
    assert loops.count == 0
    assert shell is rod


def test_loops_of_symmetric_cages_are_refused():
    with pytest.raises(SettingError, match="loops"):
        BuildSettings(loops=True, symmetric="auto")


def test_no_loops_have_no_edges():
    assert NO_LOOPS.edges == frozenset()
    tube = np.arange(8).reshape(2, 4)
    assert Loops((tube,)).edges == {
        *((0, 1), (1, 2), (2, 3), (0, 3)),
        *((4, 5), (5, 6), (6, 7), (4, 7)),
        *((0, 4), (1, 5), (2, 6), (3, 7)),
    }
