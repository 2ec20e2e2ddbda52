import numpy as np
import pytest

from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.cages.repair import repair as module
from cageik_cli.cages.repair import shape
from cageik_cli.cages.repair.repair import repair_cage
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import CageError
from tests.cages.damage import DAMAGES
from tests.shapes import QUADS, TETRAHEDRON, ball, box, changed, concave, merged, moved

MODEL = moved(ball(2, 0.35), scale=[1.0, 0.8, 0.6])
CAGE = moved(ball(1), scale=[1.0, 0.8, 0.6])
FANS = TriMesh(
    box().vertices, np.array([f for a, b, c, d in QUADS for f in ([a, b, c], [a, c, d])])
)


def kinds(repaired):
    return [step.kind for step in repaired.steps]


def test_a_fit_cage_stays_as_it_is():
    repaired = repair_cage(CAGE, MODEL)
    assert repaired.is_fit
    assert repaired.steps == ()
    np.testing.assert_array_equal(repaired.cage.vertices, CAGE.vertices)
    np.testing.assert_array_equal(repaired.cage.faces, CAGE.faces)
    np.testing.assert_array_equal(repaired.vertex_map, np.arange(len(CAGE.vertices)))


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
def test_a_damaged_cage_comes_back_fit(damage):
    damaged = damage(CAGE, np.random.default_rng(3))
    repaired = repair_cage(damaged, MODEL)
    assert repaired.is_fit, [fault.message for fault in repaired.faults]
    assert diagnose(repaired.cage, MODEL).verdict == "fit"
    assert repaired.cage.volume > 0


@pytest.mark.parametrize("damage", DAMAGES[:5], ids=lambda damage: damage.__name__)
def test_damage_to_faces_alone_is_undone_without_moving_anything(damage):
    """Every place and face is that of the cage before, but for faces over the hole."""
    damaged = damage(CAGE, np.random.default_rng(3))
    repaired = repair_cage(damaged, MODEL)
    assert repaired.max_move == 0
    places = {tuple(v) for v in CAGE.vertices}
    assert {tuple(v) for v in repaired.cage.vertices} <= places
    kept = repaired.vertex_map >= 0
    np.testing.assert_array_equal(
        repaired.cage.vertices[repaired.vertex_map[kept]], damaged.vertices[kept]
    )


def test_vertices_keep_their_order():
    """Unreferenced vertices go; the numbers of the others only move up."""
    vertices = np.insert(CAGE.vertices, [0, 5], [[9.0, 9, 9], [0, 0, 9]], axis=0)
    numbers = np.delete(np.arange(len(vertices)), [0, 6])
    repaired = repair_cage(TriMesh(vertices, numbers[CAGE.faces]), MODEL)
    np.testing.assert_array_equal(repaired.cage.vertices, CAGE.vertices)
    np.testing.assert_array_equal(np.flatnonzero(repaired.vertex_map < 0), [0, 6])
    (step,) = repaired.steps
    assert step.kind == "drop-vertices"
    assert step.vertices.tolist() == [0, 6]


def test_a_copy_in_another_unit_and_with_other_axes_is_named_and_brought_back():
    slim = np.array([1.0, 0.5, 0.25])
    cage, model = (TriMesh(size * ball(1).vertices * slim, ball(1).faces) for size in (1.3, 0.9))
    repaired = repair_cage(DAMAGES[-1](cage, None), model)
    assert repaired.transform.name == (
        "with z up instead of y up, in centimetres instead of metres"
    )
    np.testing.assert_allclose(repaired.cage.vertices, cage.vertices, rtol=0, atol=1e-12)


def test_quads_stay_quads():
    """Two sides are turned; the corners that begin the polygons stay."""
    faces = FANS.faces.copy()
    faces[[2, 3]] = faces[[2, 3]][:, ::-1]
    faces[[2, 3]] = [[4, 5, 7], [4, 7, 6]]
    repaired = repair_cage(TriMesh(FANS.vertices, faces), MODEL, corner_counts=np.full(6, 4))
    assert repaired.is_fit
    assert repaired.mesh.corner_counts.tolist() == [4] * 6
    np.testing.assert_array_equal(repaired.cage.faces, FANS.faces)


def test_a_quad_that_is_missing_comes_back_as_a_quad():
    repaired = repair_cage(changed(FANS, FANS.faces[:-2]), MODEL, corner_counts=np.full(5, 4))
    assert repaired.is_fit
    assert repaired.mesh.corner_counts.tolist() == [4] * 6
    assert kinds(repaired) == ["close-hole"]


def test_what_is_pushed_gets_its_clearance_and_the_rest_stays():
    """One vertex of the cage is moved inside the model."""
    vertices = CAGE.vertices.copy()
    vertices[0] *= 0.5
    repaired = repair_cage(changed(CAGE, vertices=vertices), MODEL)
    assert repaired.is_fit
    assert "push" in kinds(repaired)
    step = repaired.steps[-1]
    length = np.linalg.norm(repaired.moves, axis=1)
    assert repaired.moved_vertices.tolist() == step.vertices.tolist()
    assert step.max_move == pytest.approx(length.max())
    assert length.argmax() == 0
    assert len(step.vertices) < 5


def test_moves_are_in_the_units_of_the_model():
    """A scene a thousand times as large is repaired by moves a thousand times as long."""
    damaged = DAMAGES[7](CAGE, np.random.default_rng(1))
    small = repair_cage(damaged, MODEL)
    large = repair_cage(moved(damaged, scale=1024), moved(MODEL, scale=1024))
    np.testing.assert_allclose(large.moves, 1024 * small.moves, rtol=1e-3, atol=1e-6)


def test_a_repair_is_deterministic():
    damaged = DAMAGES[9](CAGE, np.random.default_rng(1))
    first, second = (repair_cage(damaged, MODEL).cage.vertices for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_progress_is_told():
    told = []
    small = changed(CAGE, vertices=0.8 * CAGE.vertices)
    repair_cage(small, MODEL, progress=lambda done, of: told.append((done, of)))
    assert told
    assert told[0][0] == 1
    assert all(done <= of for done, of in told)


def test_a_cage_that_no_round_improves_is_given_up(monkeypatch):
    monkeypatch.setattr(shape, "push", lambda cage, *_, **__: cage)
    small, rounds = changed(CAGE, vertices=0.8 * CAGE.vertices), []
    repaired = repair_cage(small, MODEL, progress=lambda done, of: rounds.append(done))
    assert rounds == list(range(1, 5))
    (fault,) = [fault for fault in repaired.faults if fault.kind == "outside"]
    assert len(fault.numbers) > 0


def test_a_repair_ends_when_its_work_is_done(monkeypatch):
    """The work is counted before each piece of it; the cage that is left is no worse."""
    pulled = CAGE.vertices.copy()
    pulled[:6] *= 0.4
    damaged = changed(CAGE, vertices=pulled)
    assert repair_cage(damaged, MODEL).is_fit
    monkeypatch.setattr(shape, "MAX_FIT_WORK", 1.0)
    rounds = []
    repaired = repair_cage(damaged, MODEL, progress=lambda done, of: rounds.append(done))
    assert rounds == [1]
    assert not repaired.is_fit
    monkeypatch.setattr(shape, "MAX_FIT_WORK", 0.0)
    repaired = repair_cage(damaged, MODEL)
    np.testing.assert_array_equal(repaired.cage.vertices, damaged.vertices)


def test_a_large_hole_is_left_and_named(monkeypatch):
    monkeypatch.setattr(module, "MAX_HOLE_EDGES", 3)
    hub = (CAGE.faces == 0).any(axis=1)
    repaired = repair_cage(changed(CAGE, faces=CAGE.faces[~hub]), MODEL)
    assert not repaired.is_fit
    assert "open-edge" in {fault.kind for fault in repaired.faults}
    assert repaired.faults[0].numbers.shape == (4, 2)


def test_a_cage_of_two_parts_that_both_hold_some_of_the_model_is_not_called_fit():
    model, cage = (merged(*(moved(box(size), (x, 0, 0)) for x in (-3, 3))) for size in (0.5, 1.0))
    repaired = repair_cage(cage, model)
    assert [fault.kind for fault in repaired.faults] == ["components"]


def test_a_strip_without_sides_is_not_called_fit():
    """A Möbius strip of five triangles."""
    angle = np.arange(5) * 2 * np.pi / 5
    vertices = np.column_stack([np.cos(angle), np.sin(angle), 0.2 * np.arange(5)])
    faces = np.array([[k, (k + 1) % 5, (k + 2) % 5] for k in range(5)])
    assert not repair_cage(TriMesh(vertices, faces), MODEL).is_fit


def test_a_flat_cage_is_not_called_fit():
    assert not repair_cage(moved(TETRAHEDRON, scale=[1, 1, 0]), MODEL).is_fit


def test_a_model_without_extent_is_refused():
    with pytest.raises(CageError, match="one point"):
        repair_cage(CAGE, TriMesh(np.zeros((3, 3)), np.array([[0, 1, 2]])))


def test_a_cage_of_faces_on_single_vertices_is_refused():
    with pytest.raises(CageError):
        repair_cage(TriMesh(box().vertices, np.array([[0, 0, 1], [2, 2, 2]])), MODEL)


def test_an_inner_wall_is_deleted():
    """The L with a wall between two of its cubes."""
    wall = np.array([[0, 3, 9], [0, 9, 6]])
    walled = TriMesh(concave().vertices, np.concatenate([concave().faces, wall]))
    repaired = repair_cage(walled, moved(ball(1, 0.1), [0.5] * 3))
    assert repaired.is_fit
    np.testing.assert_array_equal(repaired.cage.faces, concave().faces)


def test_a_fin_is_deleted():
    a, b = CAGE.edges.ends[0]
    fin = np.array([[a, b, len(CAGE.vertices)]])
    vertices = np.concatenate([CAGE.vertices, [[3.0, 3, 3]]])
    repaired = repair_cage(TriMesh(vertices, np.concatenate([CAGE.faces, fin])), MODEL)
    assert repaired.is_fit
    assert kinds(repaired) == ["drop-faces", "drop-vertices"]
    np.testing.assert_array_equal(repaired.cage.vertices, CAGE.vertices)
