"""Vertices that are in no face: no figure, and nothing that is solved, depends on them."""

from functools import cache

import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.cages.check.enclosure import check_enclosure
from cageik_cli.geometry.mesh import TriMesh, signed_volumes
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.metrics import METRIC_TYPES
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.solve.vertex_weights import drop_unused_vertices
from cageik_cli.run.api import extract
from cageik_cli.run.cage import build_cage
from cageik_cli.run.fit import fit_weights
from cageik_cli.util.errors import CageError, FormatError
from tests.shapes import ball, box, finer
from tests.texts import texts

REST = ball(2, 0.8)
CAGE = finer(box(), 1)
STRAYS = np.array([[0.0, 0, 0], [0.2, 0.1, 0.3], [0, 50, 0]])
PLACES = np.array([0, 20, 68])  # in front, between the others, at the end


def with_strays(mesh: TriMesh, strays=STRAYS) -> TriMesh:
    numbers = np.setdiff1d(np.arange(len(mesh.vertices) + len(PLACES)), PLACES)
    return TriMesh(insert(mesh.vertices, strays), numbers[mesh.faces])


@cache
def bind_once(has_strays: bool):
    """The binding of the model, with the strays or without them."""
    return bind(with_strays(REST) if has_strays else REST, CAGE)


def insert(points, strays):
    kept = np.ones(len(points) + len(PLACES), bool)
    kept[PLACES] = False
    whole = np.empty((len(kept), 3))
    whole[kept], whole[PLACES] = points, strays
    return whole


def clip(mesh=REST, count=4):
    x, y, z = mesh.vertices.T
    return np.stack(
        [np.column_stack([x + 0.1 * k * y * z, y + 0.1 * k * x**2, z]) for k in range(count)]
    )


@pytest.mark.parametrize("flight", [0.0, 1e6])
def test_strays_that_stand_still_or_fly_off_change_no_figure(flight):
    """But for the seventh digit of the weights, which are computed in other blocks."""
    clean = extract(clip(), bind_once(False))
    frames = np.stack([insert(v, STRAYS + k * flight) for k, v in enumerate(clip())])
    found = extract(frames, bind_once(True))
    assert found.rms_percent == pytest.approx(clean.rms_percent, rel=1e-5)
    np.testing.assert_allclose(found.cages, clean.cages, atol=1e-5)
    for name in METRIC_TYPES:
        values, expected = getattr(found.metrics, name), getattr(clean.metrics, name)
        if name == "worst_vertex":  # of the first frame, the rest pose, rounding names one
            values, expected = values[1:], np.setdiff1d(np.arange(69), PLACES)[expected][1:]
        np.testing.assert_allclose(values, expected, rtol=1e-5, atol=1e-6)
    assert not np.isnan(found.metrics.volume).any()


def test_strays_are_out_of_the_diagonal_and_of_the_outside_test():
    rest = with_strays(REST)
    assert rest.diagonal == REST.diagonal
    held = check_enclosure(CAGE, rest)
    assert held.outside_indices.tolist() == []
    np.testing.assert_allclose(held.points[PLACES], [[0, 0, 0], [0.2, 0.1, 0.3], [0, 1, 0]])
    (note,) = texts(held.notes)
    assert "3 vertices (0, 20, 68) of the model are in no face: they get weight 0, are" in note
    assert texts(check_enclosure(CAGE, REST).notes) == ()


def test_a_vertex_of_a_face_that_is_outside_is_refused_still():
    vertices = with_strays(REST).vertices.copy()
    vertices[5] = [0, 50, 0]
    with pytest.raises(CageError, match="1 of 66 vertices"):
        check_enclosure(CAGE, TriMesh(vertices, with_strays(REST).faces))


def test_strays_are_deformed():
    """One inside moves as the space around it; one outside follows the nearest point."""
    binding = bind_once(True)
    moved = binding.weights @ (CAGE.vertices + np.array([1, 2, 3]))
    np.testing.assert_allclose(moved[PLACES], [[1, 2, 3], [1.2, 2.1, 3.3], [1, 3, 3]], atol=1e-9)
    assert binding.quality.linear_precision < 1e-12


@pytest.mark.parametrize("weights", [None, np.linspace(1, 2, 69)])
def test_given_weights_do_not_count_for_strays(weights):
    rest = with_strays(REST)
    kept = drop_unused_vertices(weights, rest)
    assert kept.mean() == pytest.approx(1)
    assert np.flatnonzero(kept == 0).tolist() == PLACES.tolist()
    assert drop_unused_vertices(kept, rest) is kept
    assert drop_unused_vertices(weights, REST) is weights


def test_weights_of_strays_alone_are_refused():
    weights = np.zeros(69)
    weights[PLACES] = 23.0
    with pytest.raises(FormatError, match="all vertex weights are zero"):
        DualLaplacianSolver(bind_once(True), SolveSettings(), weights)


def test_missing_data_and_strays_are_counted_apart():
    weights = np.ones(69)
    weights[3] = 0
    solver = DualLaplacianSolver(bind_once(True), SolveSettings(), weights)
    assert (solver.missing_count, solver.data_count) == (1, 65)


@pytest.mark.parametrize("weights", [None, np.linspace(1, 2, 69)])
def test_weights_are_not_fitted_to_strays(weights):
    errors = []
    for speed in (0, 1e3):
        frames = np.stack([insert(v, STRAYS + k * speed) for k, v in enumerate(clip())])
        found = fit_weights(bind_once(True), [frames], vertex_weights=weights)
        errors.append(found.report.fitted)
    still, flying = errors
    assert flying.fitted.rms == pytest.approx(still.fitted.rms, rel=1e-6)
    assert flying.unfitted.largest == pytest.approx(still.unfitted.largest, rel=1e-9)


def test_volumes_are_measured_from_a_vertex_of_a_face():
    """A stray in front that is far away takes no digits of the volume."""
    frames = insert(REST.vertices, np.array([[1e12, 0, 0], [0, 0, 0], [0, 0, 0]]))
    found = signed_volumes(frames[None], with_strays(REST).faces)
    np.testing.assert_allclose(found, [REST.volume], rtol=1e-12)


def test_a_check_notes_strays_and_does_not_measure_them():
    found, clean = diagnose(CAGE, with_strays(REST)), diagnose(CAGE, REST)
    (note,) = [one for one in found.findings if one.kind == "unreferenced-vertex"]
    assert (note.severity, note.numbers.tolist()) == ("note", PLACES.tolist())
    assert found.rest.clearance == pytest.approx(clean.rest.clearance)
    assert (found.rest.outside, found.verdict) == (0, clean.verdict)


@pytest.mark.usefixtures("coarse_grids")
def test_built_cages_leave_strays_out():
    built = build_cage(with_strays(ball(2)), vertices=20)
    assert built.cage.diagonal < 2 * REST.diagonal
