import re
from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.cages.check.quality import find_thin_parts
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights import harmonic as module
from cageik_cli.method.weights.binding import Weights
from cageik_cli.method.weights.harmonic import harmonic_weights
from cageik_cli.method.weights.mean_value import mean_value_weights
from cageik_cli.method.weights.settings import COORDINATES, BindSettings
from cageik_cli.util.errors import CageError, NumericalError
from tests.shapes import ball, box, concave, inside, two_chambers
from tests.texts import texts

HARMONIC = [0.0594591, 0.003013, 0.0095678]
MEAN_VALUE = [0.0661766027004, 0.0107435865276, 0.0210509555044]
"""Weights of vertices 0, 4 and 8 of the concave cage at one point."""


def test_a_binding_reproduces_the_rest_pose():
    bound = bind(ball(2), box())
    assert bound.weights.shape == (66, 8)
    assert bound.quality.partition_of_unity < 1e-13
    assert bound.quality.linear_precision < 1e-13
    assert bound.quality.min_weight > 0
    assert texts(bound.notes) == ()


def test_mean_value_weights_are_bound_on_request():
    bound = bind(ball(2), box(), BindSettings(coordinates="mean-value"))
    np.testing.assert_array_equal(bound.weights, mean_value_weights(box(), ball(2).vertices).values)
    assert (bound.quality.panels, bound.quality.estimated_error) == (0, 0.0)
    assert bound.quality.linear_precision < 1e-15


def test_an_inward_cage_is_bound_outward():
    bound = bind(ball(1), box().flip())
    assert bound.cage.volume > 0
    assert len(texts(bound.notes)) == 1


def test_a_model_of_one_point_is_refused():
    with pytest.raises(CageError, match="the rest pose is one point"):
        bind(TriMesh(np.zeros((3, 3)), [[0, 1, 2]]), box())


def test_weights_that_do_not_reproduce_the_rest_pose_are_refused(monkeypatch):
    def wrong(cage, points, accuracy, jobs, progress):
        return Weights(np.full((len(points), len(cage.vertices)), 1 / len(cage.vertices)))

    monkeypatch.setattr(module, "harmonic_weights", wrong)
    with pytest.raises(NumericalError, match=r"2\.9e-01 of the diagonal, expected 1e-06"):
        bind(ball(1), box())


def test_a_model_that_is_the_cage_gets_unit_weights():
    np.testing.assert_allclose(bind(concave(), concave()).weights, np.eye(12), atol=1e-14)


def test_inaccurate_weights_are_refused(monkeypatch):
    for error in (0.6, np.nan):

        def worthless(cage, points, accuracy, jobs, progress, error=error):
            return replace(harmonic_weights(cage, points, accuracy, jobs, progress), error=error)

        monkeypatch.setattr(module, "harmonic_weights", worthless)
        with pytest.raises(NumericalError, match=r"error (0\.6|nan) exceeds 0\.5"):
            bind(ball(1), box())


def test_the_version_of_an_algorithm_changes_with_its_weights():
    """So that no cache gives the old ones. If the weights are to change, raise the number."""
    corner = np.array([[0.9, 0.8, 0.7]])
    harmonic, mean_value = (
        coordinates(concave(), corner).values[0, [0, 4, 8]]
        for coordinates in (harmonic_weights, mean_value_weights)
    )
    assert {name: kind.version for name, kind in COORDINATES.items()} == {
        "harmonic": 10,
        "mean-value": 4,
    }
    np.testing.assert_allclose(harmonic, HARMONIC, rtol=0, atol=1e-6)
    np.testing.assert_allclose(mean_value, MEAN_VALUE, rtol=0, atol=1e-12)


def test_a_missed_tolerance_and_a_low_weight_give_warnings(monkeypatch):
    def poor(cage, points, accuracy, jobs, progress):
        exact = harmonic_weights(cage, points, accuracy, jobs, progress)
        kernel = np.linalg.svd(np.column_stack([np.ones(8), cage.vertices]).T)[2][-1]
        return replace(exact, values=exact.values - np.outer(exact.values[:, 0], kernel), error=0.2)

    assert texts(bind(ball(1), box()).notes) == ()
    monkeypatch.setattr(module, "harmonic_weights", poor)
    missed, lowest = texts(bind(ball(1), box(), BindSettings(accuracy="preview")).notes)
    assert "error 0.2 exceeds the tolerance 0.03 of `accuracy=preview`" in missed
    assert re.match(r"warning: smallest weight -0\.\d+ is below -0\.05", lowest)


def bind_in_chambers(web):
    """Points in two chambers, none in the web that joins them."""
    cage = two_chambers(web)
    return bind(TriMesh(inside(cage, 300), np.arange(300).reshape(-1, 3)), cage)


def test_a_web_in_which_no_vertex_is_does_not_pass_for_sound():
    assert texts(bind_in_chambers(0.1).notes) == ()
    (inaccurate,) = texts(bind_in_chambers(0.01).notes)
    assert re.match(
        r"warning: weight error 0\.0\d+ just inside the cage exceeds 0\.016", inaccurate
    )


def test_sheets_that_nearly_touch_are_told_as_check_tells_them():
    notes = texts(bind_in_chambers(0.003).notes)
    told = [found.sentence for found in find_thin_parts(two_chambers(0.003))]
    assert len(told) == 1
    assert f"warning: {told[0]}" in notes
