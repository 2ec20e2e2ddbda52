"""The error by area: it does not follow how densely parts of a model are cut."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.formats.obj.frames import encode_exact_obj
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import lumped_areas
from cageik_cli.method.solve.vertex_weights import make_vertex_weights, weigh_by_area
from cageik_cli.method.weights.bem.boundary_mesh import BoundaryMesh
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.html.page import render_page
from cageik_cli.report.record import build_report
from cageik_cli.report.views.text import format_text
from cageik_cli.run.api import extract
from cageik_cli.run.extraction import extract as extract_to_file
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.util.errors import FormatError, SettingError
from tests.shapes import TETRAHEDRON, ball, box

BODY = ball(3, 0.8)


def divide_head(mesh: TriMesh, levels=2) -> TriMesh:
    """Divide the faces of the lower part in four: those that hardly move, for `bend`."""
    for _ in range(levels):
        chosen = mesh.vertices[mesh.faces].mean(axis=1)[:, 2] < -0.4
        panels = BoundaryMesh.from_cage(mesh).divide(chosen).panels
        mesh = TriMesh(panels.vertices, panels.corners)
    return mesh


def bend(vertices, amount):
    """Wrinkles above, which no coarse cage follows; nothing below."""
    x, y, z = vertices.T
    return np.column_stack([x, y, z + amount * np.where(z > 0, z**2 * np.sin(9 * x), 0)])


def clip(mesh):
    return np.stack([bend(mesh.vertices, 0.1 * k) for k in range(3)])


@pytest.fixture
def make_report(tmp_path):
    def make(mesh, **options):
        frames = tmp_path / f"frames{len(mesh.vertices)}"
        frames.mkdir(exist_ok=True)
        for k, vertices in enumerate(clip(mesh)):
            (frames / f"f_{k}.obj").write_bytes(encode_exact_obj(vertices, mesh.faces))
        (tmp_path / "cage.obj").write_bytes(encode_exact_obj(box().vertices, box().faces))
        output = tmp_path / "out.h5"
        settings = ExtractSettings(
            (str(frames),),
            tmp_path / "cage.obj",
            output,
            overwrite=True,
            bind=BindSettings("mean-value"),
        )
        return extract_to_file(replace(settings, **options))

    return make


def test_the_error_by_area_hardly_changes_when_a_part_is_divided(make_report):
    plain, dense = (build_report(make_report(one)).summary for one in (BODY, divide_head(BODY)))
    assert dense.rms < 0.75 * plain.rms
    assert dense.area_rms == pytest.approx(plain.area_rms, rel=0.03)


def test_the_error_by_area_is_its_definition_in_all_views(make_report):
    result = make_report(divide_head(BODY))
    report = build_report(result)
    areas = lumped_areas(result.rest)
    expected = np.sqrt((areas * result.vertex_rms**2).sum() / areas.sum())
    assert report.summary.area_rms == pytest.approx(expected, rel=1e-12)
    percent = f"{100 * expected / result.rest.diagonal:.4f}"
    assert report.summary.area_rms_percent == pytest.approx(float(percent), abs=1e-4)
    assert f"by area        {percent} %" in format_text(report)
    page = render_page(report)
    assert "Error by area" in page
    assert percent in page


def test_weights_by_area_lower_the_error_by_area():
    mesh = divide_head(BODY)
    binding, errors = bind(mesh, box(), BindSettings("mean-value")), []
    areas = lumped_areas(mesh)
    for weights in (None, "area"):
        animation = extract(clip(mesh), binding, vertex_weights=weights, alpha=0)
        misses = [animation.reconstruct(k) - frame for k, frame in enumerate(clip(mesh))]
        squares = np.square(misses).sum(axis=2).mean(axis=0)
        errors.append((squares.mean(), (areas * squares).sum()))
    (plain, plain_by_area), (weighted, weighted_by_area) = errors
    assert weighted_by_area < 0.998 * plain_by_area
    assert weighted > plain


def test_a_file_of_areas_gives_what_the_word_gives(make_report, tmp_path):
    mesh = divide_head(BODY)
    np.save(tmp_path / "areas.npy", lumped_areas(mesh))
    by_word = make_report(mesh, vertex_weights="area")
    rms = by_word.metrics.rms
    by_file = make_report(mesh, vertex_weights=tmp_path / "areas.npy")
    np.testing.assert_allclose(by_file.metrics.rms, rms, rtol=1e-12)
    assert (by_word.settings["vertex_weights"], by_file.settings["vertex_weights"]) == (
        "area",
        True,
    )
    assert "vertex_weights" not in by_word.sources
    json.dumps(by_word.settings)


def test_areas_are_shared_by_the_corners():
    areas = lumped_areas(BODY)
    assert areas.sum() == pytest.approx(BODY.face_areas.sum(), rel=1e-12)
    slanted = np.sqrt(3) / 2
    expected = np.array([1.5, 1 + slanted, 1 + slanted, 1 + slanted]) / 3
    np.testing.assert_allclose(lumped_areas(TETRAHEDRON), expected, rtol=1e-12)


def test_a_vertex_without_area_is_data_and_one_in_no_face_is_not():
    vertices = np.vstack([box().vertices, box().vertices[[0, 0]], [[9.0, 9, 9]]])
    mesh = TriMesh(vertices, np.vstack([box().faces, [[0, 8, 9]]]))
    weights = weigh_by_area(mesh)
    assert weights.mean() == pytest.approx(1)
    assert (weights[[8, 9]] > 0).all()
    assert weights[[8, 9]].max() < 1e-8
    assert weights[10] == 0


def test_a_model_without_area_and_other_words_are_refused():
    line = TriMesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    with pytest.raises(FormatError, match="no area"):
        weigh_by_area(line)
    with pytest.raises(SettingError, match="'areas', expected an array or \"area\""):
        make_vertex_weights("areas", BODY)
    assert make_vertex_weights(None, line) is None
