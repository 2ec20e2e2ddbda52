import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.cages.build import BuildSettings, build_cage
from cageik_cli.cages.room import MIN_MODEL_VERTICES, find_room_faults, has_too_much_room
from cageik_cli.cages.similarity import MAX_SIZE_RATIO
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.geometry.mesh import TriMesh
from tests.cages.test_sections import trousers
from tests.shapes import ball, box, finer, rotation


def scaled(mesh, factor):
    return TriMesh(factor * mesh.vertices, mesh.faces)


def placed(mesh, factor, middle):
    return TriMesh(factor * mesh.vertices + middle, mesh.faces)


def kinds(cage, rest):
    return [finding.kind for finding in find_room_faults(cage, rest)]


MODEL = ball(4)


@pytest.mark.parametrize(("size", "found"), [(1.06, []), (1.15, ["loose"])])
def test_a_loose_cage_is_found(size, found):
    assert kinds(scaled(ball(3), size), MODEL) == found


def test_the_warning_has_the_ratio_of_volumes_and_what_a_built_cage_has():
    (loose,) = find_room_faults(box(2.0), MODEL)
    assert loose.severity == "warning"
    ratio = 64 / MODEL.volume
    assert f"{ratio:.3g} times the model's volume" in loose.message
    # 16.5 % / sqrt(60) of the diagonal, all over a sphere of this area and volume.
    gap = 0.165 / np.sqrt(60)
    layer = 3 * gap * MODEL.diagonal / 0.5
    assert (
        f"of 60 vertices typically has {1 + layer:.2g} times and {100 * gap:.2g} %" in loose.message
    )
    assert 150 < loose.value * MODEL.diagonal < 300


def test_an_open_model_has_a_mean_gap_only():
    opened = TriMesh(MODEL.vertices, MODEL.faces[1:])
    (loose,) = find_room_faults(box(2.0), opened)
    assert "volume" not in loose.message


def test_a_closed_model_that_is_flat_has_a_mean_gap_only():
    flat = TriMesh(MODEL.vertices * [1, 1, 0] @ rotation(1).T, MODEL.faces)
    assert flat.volume != 0
    (loose,) = find_room_faults(box(2.0), flat)
    assert "volume" not in loose.message


def test_a_model_of_few_vertices_is_not_judged():
    assert len(ball(2).vertices) < MIN_MODEL_VERTICES
    assert kinds(box(2.0), ball(2)) == []


@pytest.mark.parametrize(("share", "found"), [(1.1, True), (0.9, False)])
def test_a_cage_in_another_unit_is_found(share, found):
    findings = list(find_room_faults(box(share * MAX_SIZE_RATIO), box(1.0)))
    assert len(findings) == found
    if found:
        (large,) = findings
        assert large.value == pytest.approx(share * MAX_SIZE_RATIO)
        assert "5.5 times" in large.message


def test_the_unit_of_a_cage_that_fits_otherwise_is_named():
    (large,) = find_room_faults(scaled(ball(2), 110.0), ball(3))
    assert "in centimetres instead of metres" in large.remedy


@pytest.mark.parametrize(("gap", "found"), [(0.5, True), (0.02, False)])
def test_limbs_in_one_loop_are_found_where_they_are(gap, found):
    model = finer(trousers(gap), 4)
    cage = placed(box(), 1.4, [1 + gap / 2, 1, 0.5])
    shared = [finding for finding in find_room_faults(cage, model) if finding.kind == "shared-loop"]
    assert bool(shared) == found
    if found:
        assert shared[0].severity == "warning"
        assert "2 limbs" in shared[0].message
        np.testing.assert_allclose(shared[0].place, [1.25, 0.4, 0.5], rtol=0, atol=0.15)


@pytest.mark.slow
def test_a_built_cage_has_no_fault():
    model = finer(trousers(0.5), 4)
    assert kinds(build_cage(model, BuildSettings(vertices=120)).cage, model) == []


def test_a_binding_has_the_warnings_unless_vertices_are_outside():
    settings = BindSettings("mean-value", outside="project")
    binding = bind(MODEL, box(1.5), settings)
    assert binding.cage_warnings == tuple(f.sentence for f in find_room_faults(box(1.5), MODEL))
    assert binding.notes == ()
    moved = placed(box(), 1.5, [1.2, 0, 0])
    assert bind(MODEL, moved, settings).cage_warnings == ()


@pytest.mark.parametrize("scale", [1.5, 1.05])
def test_a_binding_knows_whether_its_cage_is_loose(scale):
    binding = bind(MODEL, box(scale), BindSettings("mean-value"))
    assert binding.has_loose_cage is has_too_much_room(box(scale), MODEL)
