import re

import numpy as np
import pytest

from cageik_cli.cages.enclosure import check_enclosure
from cageik_cli.cages.looseness import inflate
from cageik_cli.cages.misfit import explain_misfit, round_up
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import CageError
from tests.shapes import ball, box, finer


def stretched(mesh):
    """Three extents, and no symmetry, so that turns and units can be told apart."""
    bent = mesh.vertices * [1.0, 2.0, 0.5]
    bent[:, 0] += 0.3 * bent[:, 1] * (bent[:, 1] > 0)
    return TriMesh(bent, mesh.faces)


MODEL = stretched(ball(4))
CAGE = inflate(stretched(ball(3)), 0.03 * MODEL.diagonal)


def moved(mesh, matrix):
    return TriMesh(mesh.vertices @ np.transpose(matrix), mesh.faces)


def refuse(cage):
    with pytest.raises(CageError) as caught:
        check_enclosure(cage, MODEL)
    return caught.value


def test_a_cage_that_is_not_inflated_is_told_by_how_much():
    small = inflate(CAGE, -0.04 * MODEL.diagonal)
    error = refuse(small)
    percent = float(re.search(r"inflate it by ([\d.]+) % of the diagonal", str(error))[1])
    assert 0.5 < percent < 4
    assert error.is_repairable
    check_enclosure(inflate(small, 1.01 * percent / 100 * MODEL.diagonal), MODEL)
    assert not re.search("unit|axes", str(error))


TURN = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]


@pytest.mark.parametrize(
    ("matrix", "name"),
    [(100 * np.eye(3), "in centimetres instead of metres"), (TURN, "with z up instead of y up")],
)
def test_a_transform_that_is_found_is_named(matrix, name):
    misfit = explain_misfit(moved(CAGE, matrix), MODEL, 40.0, 0.6)
    assert misfit.transform == name
    assert name in misfit.remedy


def test_no_transform_is_suspected_of_another_model():
    rod = finer(box(0.3), 2)
    error = refuse(TriMesh(rod.vertices * [9, 0.1, 0.1] + np.array([0.5, 0.5, 0]), rod.faces))
    assert "the rest pose it was made for" in str(error)
    assert not error.is_repairable


def test_a_cage_that_only_grows_where_it_need_not_is_not_told_a_percentage():
    """The spike of the model leaves through a corner, which growing does not follow."""
    vertices = MODEL.vertices.copy()
    vertices[0] *= 1.3
    misfit = explain_misfit(CAGE, TriMesh(vertices, MODEL.faces), 30.0, 1 / len(vertices))
    assert misfit.inflation is None
    assert "enlarge the cage there" in misfit.remedy
    assert misfit.is_repairable


@pytest.mark.parametrize(
    ("percent", "expected"), [(1.61, 1.7), (1.6, 1.6), (0.0123, 0.013), (12.1, 13), (0, 0)]
)
def test_percentages_are_rounded_up(percent, expected):
    assert round_up(percent) == expected
