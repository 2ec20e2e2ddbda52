import numpy as np
import pytest

from cageik_cli.cages.looseness import inflate, measure_inflation, measure_looseness
from cageik_cli.cages.similarity import find_transform
from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import ball, box, rotation

X_TURN = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""From z up to y up, and back with its transpose."""


def blob(size):
    """A body without symmetry around a point off the origin: every turn shows."""
    sphere = ball(3, 1.0).vertices
    x, y, z = sphere.T
    radius = 1 + 0.35 * x + 0.3 * y**3 - 0.25 * z * x + 0.2 * np.maximum(z, 0) ** 2
    points = (radius - 1 + size)[:, None] * sphere * [1.0, 1.6, 0.6]
    return TriMesh(points + np.array([0.2, 1.7, 0.1]), ball(3).faces)


MODEL, CAGE = blob(1.0), blob(1.08)


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
    found = find_transform(transformed(CAGE, matrix), MODEL)
    assert found is not None
    assert found.name == name
    back = found.apply(transformed(CAGE, matrix).vertices)
    np.testing.assert_allclose(back, CAGE.vertices, rtol=0, atol=1e-12)
    assert found.is_mirror == (np.linalg.det(matrix) < 0)
    assert found.inflation == 0


def test_a_turn_has_the_angle_it_is_named_by():
    """A cage that was turned by 90 degrees about z has its x where y was."""
    turned = transformed(CAGE, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(turned.vertices[:, 1], CAGE.vertices[:, 0])
    assert find_transform(turned, MODEL).name == "turned by 90 degrees about z"


def test_a_moved_copy_is_brought_back_nearly():
    offset = np.array([3.0, 0.5, -1.0])
    found = find_transform(transformed(CAGE, np.eye(3), offset), MODEL)
    assert found.name.startswith("moved by (")
    back = found.apply(CAGE.vertices + offset)
    gap = np.linalg.norm(back - CAGE.vertices, axis=1).max()
    assert gap < 0.05 * MODEL.diagonal


def test_a_scaled_copy_is_brought_back_nearly():
    found = find_transform(transformed(CAGE, 0.37 * np.eye(3)), MODEL)
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
    assert "instead of" in find_transform(transformed(CAGE, factor * np.eye(3)), MODEL).name


def test_a_cage_a_little_too_small_is_in_no_other_unit():
    found = find_transform(transformed(CAGE, 0.98 * np.eye(3)), MODEL)
    assert found is None or "instead of" not in found.name


@pytest.mark.parametrize("size", [1.08, 1.5, 0.97])
def test_a_cage_that_holds_the_model_or_nearly_is_none(size):
    assert find_transform(blob(size), MODEL) is None


def test_a_cage_turned_by_an_angle_that_is_no_quarter_is_none():
    assert find_transform(transformed(CAGE, rotation(4)), MODEL) is None


def test_another_shape_is_none():
    needle = TriMesh(box().vertices * [0.05, 4, 0.05] + [0, 1.7, 0], box().faces)
    assert find_transform(needle, MODEL) is None


def test_one_dented_vertex_is_no_transform():
    vertices = CAGE.vertices.copy()
    centre = vertices.mean(axis=0)
    vertices[3] = centre + 0.2 * (vertices[3] - centre)
    assert find_transform(TriMesh(vertices, CAGE.faces), MODEL) is None


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
    from tests.cages.test_quality import across_the_corner
    from tests.shapes import concave

    assert measure_inflation(concave(), across_the_corner(0.5)) != 0


def test_looseness_of_boxes():
    """Volumes are cubes of sizes; gaps are between the distances of faces and of corners."""
    looseness = measure_looseness(box(2.0), box(1.0))
    assert looseness.volume_ratio == pytest.approx(8)
    assert 1 <= looseness.mean_gap * box().diagonal / 100 <= np.sqrt(3)


def test_an_open_model_has_no_volume_ratio():
    sheet = TriMesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    looseness = measure_looseness(box(2.0), sheet)
    assert looseness.volume_ratio is None
    assert looseness.mean_gap > 0
