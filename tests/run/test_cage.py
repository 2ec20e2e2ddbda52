"""A cage from a file to a file: what is built passes the check, and has the same bytes twice."""

import json
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.cages.builder.build import MAX_SHIFTED
from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.write import Output, write_mesh
from cageik_cli.geometry.parts import join_meshes
from cageik_cli.report.views.cage import format_cage_json, list_cage_rows
from cageik_cli.run.cage import build_cage_file
from cageik_cli.run.settings import CageSettings
from cageik_cli.util.errors import FileAccessError, OutputError
from tests.cages.independent import examine
from tests.listeners import Listener
from tests.shapes import box, finer
from tests.texts import texts

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("folder", "coarse_grids")]
FRAME, OUT = "frames/frame_1.obj", Path("built.obj")
SMALL = BuildSettings(20)


@pytest.mark.slow
def test_the_cage_of_the_walker_passes_a_second_opinion(fixtures_folder, tmp_path, monkeypatch):
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    frame = str(fixtures_folder / "walker/frames/walker_1.obj")
    result = build_cage_file(CageSettings(frame, OUT))
    cage, model = load_mesh(OUT).mesh, load_mesh(Path(frame)).mesh
    opinion = examine(cage, model, 0.004)
    assert (opinion.faults, 90 <= len(cage.vertices) <= 100) == ((), True)
    assert opinion.smallest_angle >= 5
    assert opinion.largest_valence <= 10
    assert diagnose(cage, model).verdict == "fit"
    assert texts(result.built.notes) == ()


def test_the_file_is_the_cage_to_the_bit_and_passes_the_check():
    result = build_cage_file(CageSettings(FRAME, OUT, SMALL))
    read = load_mesh(OUT)
    assert read.source == result.source
    assert np.array_equal(read.mesh.vertices, result.built.cage.vertices)
    assert np.array_equal(read.mesh.faces, result.built.cage.faces)
    model = load_mesh(Path(FRAME)).mesh
    assert diagnose(read.mesh, model).is_fit
    assert examine(read.mesh, model, 0.004).faults == ()


def test_two_runs_write_the_same_bytes():
    build_cage_file(CageSettings(FRAME, OUT, SMALL))
    build_cage_file(CageSettings(FRAME, Path("again.obj"), SMALL))
    assert OUT.read_bytes() == Path("again.obj").read_bytes()


def test_an_open_model_far_from_the_origin(animation, write_obj):
    vertices = animation.rest.vertices + 1e6
    write_obj(Path("open.obj"), vertices, animation.rest.faces[4:])
    build_cage_file(CageSettings("open.obj", OUT, SMALL))
    model = load_mesh(Path("open.obj")).mesh
    assert diagnose(load_mesh(OUT).mesh, model).is_fit


def test_a_frame_of_a_clip(animation):
    build_cage_file(CageSettings("frames", OUT, SMALL, rest_frame=3))
    build_cage_file(CageSettings("frames/frame_4.obj", Path("four.obj"), SMALL))
    assert OUT.read_bytes() == Path("four.obj").read_bytes()


def test_the_cage_for_an_animation_has_the_least_error():
    settings = CageSettings(FRAME, OUT, SMALL, animation=("frames",))
    result = build_cage_file(settings)
    candidates = result.built.candidates
    errors = [known.error for known in candidates if known.error is not None]
    recipes = [known.recipe for known in candidates]
    assert all(", 4 poses" in recipe for recipe in recipes)
    shifted = [recipe for recipe in recipes if "shifted" in recipe]
    assert 0 < len(shifted) == min(MAX_SHIFTED, len(errors) - len(shifted))
    assert result.built.chosen.error == min(errors)
    assert dict(list_cage_rows(result))["error"].startswith(f"{min(errors):.4f} %")


def test_a_model_follows_the_order_of_the_parts_of_an_animation():
    """Both parts have as many vertices, so that counts do not tell them apart."""
    parts = {"body": finer(box(1.0), 2), "hat": finer(box(0.5), 2)}
    parts["hat"] = parts["hat"].move(parts["hat"].vertices + np.array([1.5, 0, 0]))
    cages = []
    for name in ("body hat", "hat body"):
        order = name.split()
        model = join_meshes([parts[each] for each in order], order)
        write_mesh(Path(f"{name}.obj"), model, model.vertices, overwrite=False)
        frames = np.stack([model.vertices * [1, 1 + 0.1 * k, 1] for k in range(3)])
        if not cages:
            moved = Animation(model, 3, Scene(), "clip")
            with Output(Path("clip.usdc")).open_writer(moved) as writer:
                writer.append(frames)
        settings = CageSettings(f"{name}.obj", OUT, SMALL, animation=("clip.usdc",), overwrite=True)
        result = build_cage_file(settings)
        cages.append(OUT.read_bytes())
    assert texts(result.model.notes) == ("parts taken in the order of the clip",)
    assert cages[0] == cages[1]


def test_an_animation_of_another_model_is_refused(animation, write_obj):
    write_obj(Path("other.obj"), animation.cage.vertices / 4, animation.cage.faces)
    with pytest.raises(Exception, match="8 vertices") as caught:
        build_cage_file(CageSettings("other.obj", OUT, SMALL, animation=("frames",)))
    assert caught.value.kind == "connectivity"
    assert not OUT.exists()


def test_progress_is_reported():
    listener = Listener()
    build_cage_file(CageSettings(FRAME, OUT, SMALL), listener)
    assert listener.counts == [(1, 1), (1, 1)]


def test_the_record_has_all_candidates():
    result = build_cage_file(CageSettings(FRAME, OUT, SMALL))
    record = json.loads(format_cage_json(result))
    assert record["settings"] == {
        "vertices": 20,
        "clearance_percent": 0.4,
        "symmetric": "off",
        "quads": False,
        "loops": False,
        "rest_frame": None,
    }
    assert record["cage"]["sha256"] == load_mesh(OUT).source["sha256"]
    assert [known["is_valid"] for known in record["candidates"]] == [True]


def test_a_loose_cage_has_a_warning(monkeypatch):
    monkeypatch.setattr("cageik_cli.cages.builder.build.make_shell", lambda *_: None)
    result = build_cage_file(CageSettings(FRAME, OUT, SMALL))
    assert "ellipsoid" in result.built.chosen.recipe
    (warning,) = texts(result.built.notes)
    assert ("warning", warning) in list_cage_rows(result)
    assert diagnose(load_mesh(OUT).mesh, load_mesh(Path(FRAME)).mesh).is_fit


@pytest.mark.parametrize(
    ("model", "output", "error", "says"),
    [
        ("nowhere.obj", OUT, FileAccessError, "nowhere.obj"),
        (FRAME, Path("cage.obj"), OutputError, "cage.obj: exists already"),
        (FRAME, Path("cage.ply"), OutputError, "cage.ply: a built cage is written as .obj"),
    ],
)
def test_files_that_cannot_be_used(model, output, error, says):
    with pytest.raises(error, match=says):
        build_cage_file(CageSettings(model, output, SMALL))
