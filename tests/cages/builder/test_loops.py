from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.cages.builder import build as build_module
from cageik_cli.cages.builder.build import NO_LIMBS, NO_LOOPED_CAGE, Candidate, build_cage
from cageik_cli.cages.builder.collapse import Motion, collapse_edges
from cageik_cli.cages.builder.draft import flip_edge
from cageik_cli.cages.builder.judge import Demand, Verdict
from cageik_cli.cages.builder.loops import (
    MAX_LOOP_SHARE,
    NO_LOOPS,
    Loops,
    find_border,
    place_edge_loops,
)
from cageik_cli.cages.builder.quads import make_quads
from cageik_cli.cages.builder.refine import make_draft, replace_weak_vertices
from cageik_cli.cages.builder.shift import shift_vertices
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.shape import bounds_volume
from cageik_cli.util.errors import SettingError
from tests.cages.builder.test_limbs import make_rod, scaled
from tests.shapes import ball, box
from tests.texts import texts

COUNT, BEND = 60, 0.06


@pytest.fixture(scope="module")
def rod():
    """A bent rod, its diagonal one."""
    return scaled(make_rod(bend=BEND))


@pytest.fixture(scope="module")
def laid(rod):
    return place_edge_loops(rod, COUNT, None)


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


def test_loops_have_four_to_six_vertices_and_their_share_of_the_cage(laid):
    _, loops = laid
    assert all(4 <= tube.shape[1] <= 6 and len(tube) >= 2 for tube in loops.tubes)
    assert loops.vertex_count <= MAX_LOOP_SHARE * COUNT


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
    small = collapse_edges(cage, 45, None, 1e-4, fixed=loops.vertex_count)
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
        assert draft.allows(flip) != is_refused


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
    cage, loops = place_edge_loops(straight, COUNT, motion)
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


@pytest.mark.slow
def test_a_cube_has_no_loops_and_a_note_says_so(coarse_grids):
    built = build_cage(box(), BuildSettings(30, loops=True))
    assert built.chosen.loops.count == 0
    assert NO_LIMBS in texts(built.notes)
    plain = build_cage(box(), BuildSettings(30))
    assert NO_LIMBS not in texts(plain.notes)
    np.testing.assert_array_equal(plain.cage.vertices, built.cage.vertices)


@pytest.mark.slow
def test_a_cage_whose_loops_fail_has_none_and_a_note_says_so(monkeypatch, rod, coarse_grids):
    """A candidate with loops is judged to leave the model outside."""
    make = build_module._Builder._make_candidate

    def refuse_loops(builder, recipe, *rest):
        candidate = make(builder, recipe, *rest)
        if " loops around " not in recipe:
            return candidate
        return replace(candidate, verdict=replace(candidate.verdict, faults=("fails",)))

    monkeypatch.setattr(build_module._Builder, "_make_candidate", refuse_loops)
    steps = []
    built = build_cage(
        rod, BuildSettings(COUNT, loops=True), progress=lambda *step: steps.append(step)
    )
    assert built.chosen.loops.count == 0
    assert NO_LOOPED_CAGE in texts(built.notes)
    assert NO_LIMBS not in texts(built.notes)


def test_a_cage_with_loops_is_preferred_to_a_tighter_one(rod):
    """Of two valid cages, one without loops has the lower cost."""
    cage = ball(1)
    verdict = Verdict((), 0, 0.01, 30.0, 6, 0.01)
    builder = build_module._Builder(rod, BuildSettings(COUNT, loops=True), None)
    loops = Loops((np.arange(8).reshape(2, 4),))
    builder._tried = [
        Candidate("plain", cage, verdict, 0.006),
        Candidate("looped", cage, verdict, 0.01, loops=loops),
    ]
    assert [candidate.recipe for candidate in builder._ranked] == ["looped", "plain"]


def test_thick_limbs_have_loops_of_six_in_large_cages(rod):
    _, loops = place_edge_loops(rod, 400, None)
    assert {tube.shape[1] for tube in loops.tubes} == {6}


def test_a_patch_with_two_borders_is_no_disk():
    """A disk beside an annulus has the Euler characteristic of a disk."""
    disk = np.array([[0, 1, 2]])
    ring = [[3 + k, 3 + (k + 1) % 3, 6 + k] for k in range(3)]
    ring += [[3 + (k + 1) % 3, 6 + (k + 1) % 3, 6 + k] for k in range(3)]
    assert find_border(disk) is not None
    assert find_border(np.array(ring)) is None
    assert find_border(np.concatenate([disk, ring])) is None


def test_too_few_vertices_leave_a_shell_without_loops(rod):
    shell, loops = place_edge_loops(rod, 10, None)
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
