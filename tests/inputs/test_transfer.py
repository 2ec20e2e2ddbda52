"""The fit of a result, transferred to other meshes and points in its cage."""

import json
import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.editing.cage_edits import EditFiles
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.ply_points import parse_points
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.formats.write import Output
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.method.weights.binding import reconstruct
from cageik_cli.run.bind import bind_files
from cageik_cli.run.deform import deform
from cageik_cli.run.edit import edit, pose, pose_model
from cageik_cli.run.export import export
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import (
    BindRunSettings,
    DeformSettings,
    EditSettings,
    ExportSettings,
    ExtractSettings,
    PoseSettings,
)
from cageik_cli.store.result import read_animation, read_binding, read_cages, read_result
from tests.conftest import _use_coarse_panels
from tests.fitted import small_binding, smooth_motion
from tests.listeners import Listener
from tests.shapes import finer
from tests.splats import encode_rows

FORMS = {
    "dense": FitSettings(),
    "rank": FitSettings(rank=6),
    "few": FitSettings(influences=8),
}
BINDING = small_binding()
FINER = finer(BINDING.rest, 1)
FRAMES = smooth_motion(BINDING, 12)
FINER_FRAMES = np.stack([finer(BINDING.rest.move(frame), 1).vertices for frame in FRAMES])
HANDLES = [
    {"name": "a", "vertex": 3, "offset": [0.1, 0.2, 0]},
    {"name": "b", "vertex": 40, "pin": True},
]


@pytest.fixture(scope="module")
def files(tmp_path_factory, write_obj):
    """A folder, read only, with a result for each form of a fit: `dense.h5` and others."""
    folder = tmp_path_factory.mktemp("carry") / "files"
    for k, frame in enumerate(FRAMES):
        write_obj(folder / "frames" / f"f_{k:03}.obj", frame, BINDING.rest.faces)
    write_obj(folder / "rest.obj", BINDING.rest.vertices, BINDING.rest.faces)
    write_obj(folder / "cage.obj", 1.6 * BINDING.cage.vertices, BINDING.cage.faces)
    write_obj(folder / "finer.obj", FINER.vertices, FINER.faces)
    (folder / "h.json").write_text(json.dumps({"handles": HANDLES}))
    with pytest.MonkeyPatch.context() as monkeypatch:
        _use_coarse_panels(monkeypatch)
        monkeypatch.chdir(folder)
        for name, fit in FORMS.items():
            extract(make_settings(f"{name}.h5", fit=fit))
    return folder


def make_settings(output, **others):
    cage = None if "binding" in others else Path("cage.obj")
    return ExtractSettings(("frames",), cage, Path(output), rest=Path("rest.obj"), **others)


@pytest.fixture(autouse=True)
def folder(files, tmp_path, monkeypatch, coarse_panels):
    """The current folder, with these files."""
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)


def move(source, mesh="finer.obj", **others):
    """The frames that the cages of a source give to a mesh, and what was noted."""
    notes = Listener()
    settings = DeformSettings(
        Path(source), Output(Path("out.npz"), overwrite=True), mesh=(Path(mesh),), **others
    )
    deform(settings, notes)
    with np.load("out.npz") as arrays:
        return arrays["vertices"].astype(float), [text for _, text in notes.notes]


def move_without_fit(source, mesh):
    """The frames that computed weights give."""
    result = read_animation(Path(source))
    cages = np.concatenate(list(read_cages(result, 64)))
    return reconstruct(bind(mesh, result.cage).weights, cages)


def measure(found, expected):
    return float(np.sqrt(np.square(found - expected).sum(axis=2).mean()))


@pytest.mark.parametrize("form", FORMS)
def test_a_finer_version_follows_as_the_model_does(form):
    found, notes = move(f"{form}.h5")
    with_fit = measure(found, FINER_FRAMES)
    without = measure(move_without_fit(f"{form}.h5", FINER), FINER_FRAMES)
    assert with_fit < (0.8 if form == "few" else 0.5) * without
    deform(DeformSettings(Path(f"{form}.h5"), Output(Path("own.npz"))))
    with np.load("own.npz") as arrays:
        own = arrays["vertices"]
    np.testing.assert_allclose(found[:, : own.shape[1]], own, rtol=0, atol=1e-6)
    (errors,) = (text for text in notes if "left out" in text)
    left_out, fitted, computed = map(float, re.findall(r"\d+\.\d+", errors))
    assert fitted < left_out < computed
    assert "which is 0.0000 % of its diagonal away" in " ".join(notes)


def test_a_layer_above_follows_more_closely(write_obj):
    above = TriMesh(1.03 * BINDING.rest.vertices, BINDING.rest.faces)
    write_obj(Path("above.obj"), above.vertices, above.faces)
    found, _ = move("dense.h5", "above.obj")
    truth = 1.03 * (FRAMES - FRAMES.mean(axis=1, keepdims=True)) + FRAMES.mean(
        axis=1, keepdims=True
    )
    without = measure(move_without_fit("dense.h5", above), truth)
    assert measure(found, truth) < 0.7 * without


def test_a_mesh_far_away_has_computed_weights(write_obj):
    inner = TriMesh(0.3 * BINDING.rest.vertices, BINDING.rest.faces)
    write_obj(Path("inner.obj"), inner.vertices, inner.faces)
    found, notes = move("dense.h5", "inner.obj")
    expected = move_without_fit("dense.h5", inner)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    assert "66 of 66 vertices are 10% away or more" in " ".join(notes)


def test_a_change_of_low_rank_needs_no_weights():
    expected, _ = move("rank.h5")
    bare = extract(make_settings("bare.h5", fit=FORMS["rank"], keep_weights=False))
    with h5py.File(bare.path) as file:
        assert "weights" not in file
    found, notes = move("bare.h5")
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    assert any("on the frames of the fit" in text for text in notes)


def test_other_coordinates_carry_what_they_lack():
    """At the vertices of the model, all that is transferred is the fitted weights."""
    expected, _ = move("dense.h5", "rest.obj")
    found, _ = move("dense.h5", "rest.obj", coordinates="mean-value")
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


def test_a_binding_carries_its_fit_as_a_result_of_it():
    bind_files(BindRunSettings(Path("cage.obj"), Path("rest.obj"), Path("b.h5"), clips=("frames",)))
    result = extract(make_settings("through.h5", binding=Path("b.h5")))
    export(ExportSettings((result.path,), Output(Path("edited/c_###.obj"))))
    expected, _ = move("through.h5")
    found, notes = move("b.h5", cages="edited")
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
    assert any("on the frames of the fit" in text for text in notes)


def test_an_edited_result_carries_its_fit():
    edit(EditSettings(Path("dense.h5"), Path("h.json"), Path("edited.h5")))
    found, notes = move("edited.h5")
    assert any("on the frames of the fit" in text for text in notes)
    apart = np.abs(found - move_without_fit("edited.h5", FINER)).max()
    assert apart > 0.01


@pytest.mark.parametrize("form", FORMS)
def test_a_model_in_the_cage_of_a_result_is_posed_with_its_fit(form):
    """The fitted model as its own weights pose it; in the cage alone it is posed otherwise."""

    def pose_in(cage):
        output = Path(f"{cage.stem}_posed.obj")
        settings = PoseSettings(Path("rest.obj"), Path("h.json"), output, cage=cage)
        return pose(settings).snapshot.after

    result = read_result(Path(f"{form}.h5"))
    files = EditFiles.read(Path("h.json"), None)
    own = pose_model(read_binding(result), files, PosingSettings(), Listener()).snapshot.after
    np.testing.assert_allclose(pose_in(result.path), own, rtol=0, atol=1e-9)
    assert np.abs(pose_in(Path("cage.obj")) - own).max() > 1e-3


SCENES = {
    "cm": (".usdc", "cm,y", None),
    "in,z": (".usdc", "in,z", None),
    "typed": (".obj", "mm,z", "m,y"),
}
"""Another scene of a model, in a file that states it, or with what the user states of the cage."""


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("case", SCENES)
def test_a_fit_is_transferred_to_a_model_in_another_unit(form, case, write_obj):
    """The result is in metres, y up; the posed model is that of one unit, converted."""
    suffix, words, typed = SCENES[case]
    here, there = SceneHints.parse("m,y"), SceneHints.parse(words)
    conversion = SceneConversion.between(here, there)
    given_in = SceneHints()
    if typed:  # the model states nothing and is taken for metres, so the cage is not in them
        factor = conversion.factor
        given_in = SceneHints.parse(f"{factor:g},y")
        conversion = SceneConversion((factor, 1.0), ("Y", "Y"))
    same = pose_model_of(form, "finer.obj", HANDLES)
    model = conversion.convert_mesh(FINER)
    if suffix == ".obj":
        write_obj(Path("other.obj"), model.vertices, model.faces)
    else:
        animation = Animation(model, 1, there.override(Scene()), "mesh")
        with Output(Path("other.usdc")).open_writer(animation) as writer:
            writer.append(model.vertices[None])
    handles = [
        handle | {"offset": conversion.apply(np.array(handle["offset"])).tolist()}
        if "offset" in handle
        else handle
        for handle in HANDLES
    ]
    found = pose_model_of(form, f"other{suffix}", handles, given_in)
    expected = conversion.apply(same)
    assert np.abs(found - expected).max() <= 1e-6 * model.diagonal
    assert np.abs(same - pose_model_of("cage.obj", "finer.obj", HANDLES)).max() > 1e-3


def pose_model_of(form, model, handles, given_in=None):
    """The vertices of a model posed in the cage of a result, or of a file."""
    Path("own.json").write_text(json.dumps({"handles": handles}))
    cage = Path(form if form.endswith(".obj") else f"{form}.h5")
    settings = PoseSettings(
        Path(model),
        Path("own.json"),
        Path("posed.obj"),
        cage=cage,
        overwrite=True,
        given_in=given_in or SceneHints(),
    )
    return pose(settings).snapshot.after


@pytest.mark.parametrize("form", FORMS)
def test_normals_turn_with_a_fit_in_another_scene(form):
    """The points state nothing, and the user what the result is in; its gradients follow."""
    points = 1.03 * BINDING.rest.vertices
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    conversion = SceneConversion((100.0, 1.0), ("Z", "Y"))
    here = pose_normals(form, points, normals, HANDLES, SceneHints())
    handles = [dict(HANDLES[0]), HANDLES[1]]
    handles[0]["offset"] = conversion.apply(np.array(HANDLES[0]["offset"])).tolist()
    there = pose_normals(
        form,
        conversion.apply(points),
        normals @ conversion.turn,
        handles,
        SceneHints.parse("100,z"),
    )
    assert np.abs(here - normals).max() > 0.05
    np.testing.assert_allclose(there, here @ conversion.turn, rtol=0, atol=1e-6)


def pose_normals(form, points, normals, handles, given_in):
    """The normals of a cloud of points that is posed in the cage of a result."""
    names = ("x", "y", "z", "nx", "ny", "nz")
    rows = np.zeros(len(points), [(name, "<f8") for name in names])
    for name, values in zip(names, np.concatenate([points, normals], axis=1).T, strict=True):
        rows[name] = values
    Path("cloud.ply").write_bytes(encode_rows(rows))
    Path("own.json").write_text(json.dumps({"handles": handles}))
    files = Path("cloud.ply"), Path("own.json"), Path("posed.ply")
    pose(PoseSettings(*files, cage=Path(f"{form}.h5"), given_in=given_in, overwrite=True))
    moved = parse_points(Path("posed.ply").read_bytes()).rows
    return np.stack([moved[name] for name in names[3:]], axis=1)
