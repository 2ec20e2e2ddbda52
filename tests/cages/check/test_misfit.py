import re

import numpy as np
import pytest

from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.cages.check.enclosure import check_enclosure, locate_vertices
from cageik_cli.cages.check.misfit import explain_misfit, round_up
from cageik_cli.cages.transform import average_normals, find_transform, measure_inflation
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.points import PointCloud
from cageik_cli.geometry.surface import closest_points
from cageik_cli.util.errors import CageError
from tests.shapes import ball, box, finer, rotation


def stretched(mesh):
    """Three extents, and no symmetry, so that turns and units can be told apart."""
    bent = mesh.vertices * [1.0, 2.0, 0.5]
    bent[:, 0] += 0.3 * bent[:, 1] * (bent[:, 1] > 0)
    return TriMesh(bent, mesh.faces)


def inflate(cage, distance):
    """Every vertex moved along its normal."""
    return TriMesh(cage.vertices + distance * average_normals(cage), cage.faces)


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


def push_in(cage, vertices, depth):
    """Vertices of the cage, put inside the model by a depth in diagonals."""
    positions = cage.vertices.copy()
    nearest = closest_points(MODEL, positions[vertices]).position
    inward = nearest - positions[vertices]
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    positions[vertices] = nearest + depth * MODEL.diagonal * inward
    return TriMesh(positions, cage.faces)


@pytest.mark.parametrize("vertices", [[7], [7, 60], [7, 60, 100, 130]])
def test_a_few_dents_are_named_and_no_inflation_is_advised(vertices):
    dented = push_in(CAGE, vertices, 0.02)
    misfit = diagnose(dented, MODEL).misfit
    assert sorted(dent.vertex for dent in misfit.dents) == vertices
    assert all(dent.is_inside for dent in misfit.dents)
    depths = [dent.depth / MODEL.diagonal for dent in misfit.dents]
    np.testing.assert_allclose(depths, 0.02, rtol=0.2)
    assert depths == sorted(depths, reverse=True)
    text = str(refuse(dented))
    assert f"vertex {misfit.dents[0].vertex} of the cage is " in text
    assert "inside the model" in text
    assert "inflate" not in text
    pulled = dented.vertices.copy()
    pulled[vertices] = CAGE.vertices[vertices]
    check_enclosure(TriMesh(pulled, CAGE.faces), MODEL)


def test_a_cage_that_is_too_small_all_over_has_no_dents():
    small = inflate(CAGE, -0.04 * MODEL.diagonal)
    assert diagnose(small, MODEL).misfit.dents == ()


def test_points_come_out_at_a_vertex_that_is_not_inside_them():
    dented = push_in(CAGE, [7], 0.02)
    (dent,) = locate_vertices(dented, PointCloud.from_points(MODEL.vertices)).dents
    assert (dent.vertex, dent.is_inside) == (7, False)
    assert dent.describe("1 cm") == "the model comes 1 cm out of the cage at its vertex 7"


X_TURN = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""From z up to y up, and back with its transpose."""


@pytest.mark.parametrize(
    ("matrix", "name"),
    [(100 * np.eye(3), "in centimetres instead of metres"), (X_TURN, "with z up instead of y up")],
)
def test_a_transform_that_is_found_is_named(matrix, name):
    misfit = explain_misfit(moved(CAGE, matrix), MODEL, 40.0, 0.6)
    assert misfit.transform.name == name
    assert name in misfit.remedy


def test_no_transform_is_suspected_of_another_model():
    rod = finer(box(0.3), 2)
    error = refuse(TriMesh(rod.vertices * [9, 0.1, 0.1] + np.array([0.5, 0.5, 0]), rod.faces))
    assert "cage of another model" in str(error)
    assert "`rest=`" in str(error)
    assert not error.is_repairable


def test_a_cage_that_only_grows_where_it_need_not_is_not_told_a_percentage():
    """The spike of the model leaves through a corner, which growing does not follow."""
    vertices = MODEL.vertices.copy()
    vertices[0] *= 1.3
    misfit = explain_misfit(CAGE, TriMesh(vertices, MODEL.faces), 30.0, 1 / len(vertices))
    assert misfit.inflation is None
    assert "enlarge the cage there" in str(misfit.remedy)
    assert misfit.is_repairable


def test_a_third_of_the_model_far_outside_is_of_another_pose():
    """To enlarge such a cage, or to repair it, would help nothing."""
    vertices = MODEL.vertices.copy()
    vertices[vertices[:, 1] > 0.3] += [0, 3, 0]
    far = TriMesh(vertices, MODEL.faces)
    misfit = explain_misfit(CAGE, far, 30.0, 0.3)
    assert "the cage of another pose" in str(misfit.remedy)
    assert not misfit.is_repairable
    assert explain_misfit(CAGE, far, 8.0, 0.3).is_repairable


def test_the_numbers_of_most_vertices_say_nothing():
    """Where a cage is of another model, what it is comes first."""
    far = TriMesh(CAGE.vertices + 50, CAGE.faces)
    assert "numbers 0, 1" not in str(refuse(far))
    vertices = MODEL.vertices.copy()
    vertices[0] *= 1.3
    with pytest.raises(CageError, match="numbers 0 "):
        check_enclosure(CAGE, TriMesh(vertices, MODEL.faces))


def test_faults_of_a_cage_of_another_pose_are_not_to_be_mended():
    """Neither what refuses it, nor its check, begins with how to mend it."""
    crossing = TriMesh(CAGE.vertices * [1, 1, 0.1] + [0, 0, 0.4], CAGE.faces)
    corner = crossing.vertices.copy()
    corner[0] = crossing.vertices[crossing.vertices[:, 1].argmax()] + [0, 0.1, 0]
    crossing = TriMesh(corner, CAGE.faces)
    error = refuse(crossing)
    assert "crosses" in str(error)
    assert "extract builds one if `cage=` is left out" in str(error)
    assert "move vertices" not in str(error)
    assert not error.is_repairable
    first, *others = diagnose(crossing, MODEL).findings
    assert first.kind == "outside"
    assert "self-intersection" in {finding.kind for finding in others}


@pytest.mark.parametrize(
    ("percent", "expected"), [(1.61, 1.7), (1.6, 1.6), (0.0123, 0.013), (12.1, 13), (0, 0)]
)
def test_percentages_are_rounded_up(percent, expected):
    assert round_up(percent) == expected


def blob(size):
    """A body without symmetry around a point off the origin: every turn shows."""
    sphere = ball(3, 1.0).vertices
    x, y, z = sphere.T
    radius = 1 + 0.35 * x + 0.3 * y**3 - 0.25 * z * x + 0.2 * np.maximum(z, 0) ** 2
    points = (radius - 1 + size)[:, None] * sphere * [1.0, 1.6, 0.6]
    return TriMesh(points + np.array([0.2, 1.7, 0.1]), ball(3).faces)


BLOB, BLOB_CAGE = blob(1.0), blob(1.08)


def transformed(mesh, matrix, offset=(0.0, 0.0, 0.0)):
    """A mesh whose points were moved, its faces still outward."""
    moved = TriMesh(mesh.vertices @ np.asarray(matrix, float).T + offset, mesh.faces)
    return moved if np.linalg.det(matrix) > 0 else moved.flip()


@pytest.mark.parametrize(
    ("matrix", "name"),
    [
        (X_TURN, "with z up instead of y up"),
        (X_TURN.T, "with y up instead of z up"),
        (100 * np.eye(3), "in centimetres instead of metres"),
        (np.eye(3) / 1000, "in metres instead of millimetres"),
        (np.eye(3) / 0.0254, "in inches instead of metres"),
        (np.eye(3) / 2.54, "in inches instead of centimetres"),
        (np.diag([-1.0, 1, -1]), "turned by 180 degrees about y"),
        ([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], "turned by 90 degrees about y"),
        ([[0, 0, -1], [0, 1, 0], [1, 0, 0]], "turned by -90 degrees about y"),
        ([[0, -1, 0], [1, 0, 0], [0, 0, 1]], "turned by 90 degrees about z"),
        (np.diag([-1.0, 1, 1]), "mirrored in x"),
        ([[0, 1, 0], [0, 0, 1], [1, 0, 0]], "with its z, x, y as the model's x, y, z"),
        (100 * X_TURN, "with z up instead of y up, in centimetres instead of metres"),
    ],
)
def test_a_transformed_copy_is_named_and_brought_back(matrix, name):
    found = find_transform(transformed(BLOB_CAGE, matrix), BLOB)
    assert found is not None
    assert found.name == name
    back = found.apply(transformed(BLOB_CAGE, matrix).vertices)
    np.testing.assert_allclose(back, BLOB_CAGE.vertices, rtol=0, atol=1e-12)
    assert found.is_mirror == (np.linalg.det(matrix) < 0)
    assert found.inflation == 0


def test_a_turn_has_the_angle_it_is_named_by():
    """A cage that was turned by 90 degrees about z has its x where y was."""
    turned = transformed(BLOB_CAGE, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(turned.vertices[:, 1], BLOB_CAGE.vertices[:, 0])
    assert find_transform(turned, BLOB).name == "turned by 90 degrees about z"


def test_a_moved_copy_is_brought_back_nearly():
    offset = np.array([3.0, 0.5, -1.0])
    found = find_transform(transformed(BLOB_CAGE, np.eye(3), offset), BLOB)
    assert found.name.startswith("moved by (")
    back = found.apply(BLOB_CAGE.vertices + offset)
    gap = np.linalg.norm(back - BLOB_CAGE.vertices, axis=1).max()
    assert gap < 0.05 * BLOB.diagonal


def test_a_scaled_copy_is_brought_back_nearly():
    found = find_transform(transformed(BLOB_CAGE, 0.37 * np.eye(3)), BLOB)
    assert found.name.startswith("scaled by 0.3")
    assert found.matrix[0, 0] == pytest.approx(1 / 0.37, rel=0.08)


@pytest.mark.parametrize("scale", [0.2, 0.5, 0.6, 0.7, 0.9, 0.98, 1.5, 3.0])
@pytest.mark.parametrize("model", [box(0.9), ball(2, 0.9)], ids=["box", "ball"])
def test_a_box_of_another_size_is_in_no_other_unit(scale, model):
    """Shapes without limbs fit at any size; 2.54 times 0.5 is not 1."""
    found = find_transform(box(scale), model)
    assert found is None or "scaled by" in found.name


@pytest.mark.parametrize("factor", [25.4, 30.48, 10])
def test_units_that_are_rare_are_named_where_the_size_agrees(factor):
    assert "instead of" in find_transform(transformed(BLOB_CAGE, factor * np.eye(3)), BLOB).name


def test_a_cage_a_little_too_small_is_in_no_other_unit():
    found = find_transform(transformed(BLOB_CAGE, 0.98 * np.eye(3)), BLOB)
    assert found is None or "instead of" not in found.name


@pytest.mark.parametrize("size", [1.08, 1.5, 0.97])
def test_a_cage_that_holds_the_model_or_nearly_is_none(size):
    assert find_transform(blob(size), BLOB) is None


def test_a_cage_turned_by_an_angle_that_is_no_quarter_is_none():
    assert find_transform(transformed(BLOB_CAGE, rotation(4)), BLOB) is None


def test_another_shape_is_none():
    needle = TriMesh(box().vertices * [0.05, 4, 0.05] + [0, 1.7, 0], box().faces)
    assert find_transform(needle, BLOB) is None


def test_one_dented_vertex_is_no_transform():
    vertices = BLOB_CAGE.vertices.copy()
    centre = vertices.mean(axis=0)
    vertices[3] = centre + 0.2 * (vertices[3] - centre)
    assert find_transform(TriMesh(vertices, BLOB_CAGE.faces), BLOB) is None


def test_a_box_needs_the_offset_of_its_corners():
    """A corner of a cube goes by 1 along each axis when it goes by √3 along its normal."""
    inflation = measure_inflation(box(1.0), box(1.1))
    assert inflation == pytest.approx(100 * 0.1 * np.sqrt(3) / box(1.1).diagonal, rel=0.02)
    grown = inflate(box(1.0), inflation / 100 * box(1.1).diagonal)
    assert (np.abs(grown.vertices) >= 1.1).all()


def test_no_inflation_is_needed_of_a_cage_that_holds_the_model():
    assert measure_inflation(box(1.0), box(0.9)) == 0


def test_inflation_does_not_save_a_cage_that_is_much_too_small():
    assert measure_inflation(box(0.2), box(1.0)) is None


def test_inflation_sees_faces_not_only_vertices():
    """All corners of the rod are inside the L, its middle is not."""
    from tests.cages.check.test_quality import across_the_corner
    from tests.shapes import concave

    assert measure_inflation(concave(), across_the_corner(0.5)) != 0
