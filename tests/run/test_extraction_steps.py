"""An extraction is opened, then bound, then run; opening one writes nothing."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.batch.jobs import compute_weights_key
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.captured.settings import CaptureSettings
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.run.extraction import Extraction, extract
from cageik_cli.run.resume import check_output
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.store.binding_file import write_binding
from cageik_cli.util.errors import (
    CheckpointError,
    FormatError,
    InputError,
    OutputError,
    SettingError,
)
from tests.listeners import Listener
from tests.texts import texts


def fail(*_, **__):
    raise AssertionError("computed")


def open_extraction(settings, stored=None):
    """Open an extraction, and return it."""
    extraction = Extraction(settings, stored=stored)
    extraction.open()
    return extraction


@pytest.fixture
def plain(folder):
    """Settings for the little animation."""
    return ExtractSettings(frames=("frames",), cage=Path("cage.obj"), output=Path("cages.h5"))


def test_to_open_writes_nothing(plain, folder):
    before = sorted(folder.rglob("*"))
    assert open_extraction(replace(plain, resume=True)).existing is None
    assert sorted(folder.rglob("*")) == before


def test_known_weights_are_used(plain, monkeypatch):
    expected = extract(plain).path.read_bytes()
    stored = open_extraction(plain).bind()
    monkeypatch.setattr("cageik_cli.run.extraction.bind_cached", fail)
    again = replace(plain, overwrite=True)
    assert Extraction(again, stored=stored).run().path.read_bytes() == expected
    with pytest.raises(AssertionError, match="computed"):
        extract(again)


def test_an_existing_result_is_returned_without_work(plain, monkeypatch):
    extract(plain)
    monkeypatch.setattr(Extraction, "bind", fail)
    extraction = Extraction(replace(plain, resume=True))
    assert extraction.run() is extraction.existing
    with pytest.raises(AssertionError, match="computed"):
        extract(replace(plain, resume=True, overwrite=True, rest_frame=2))


def test_without_resume_an_existing_result_is_not_looked_for(plain):
    extract(plain)
    assert open_extraction(replace(plain, overwrite=True)).existing is None
    with pytest.raises(InputError, match=r"cages\.h5"):
        check_output(plain)


def test_a_checkpoint_is_not_overwritten_unasked(plain, single_frame_blocks):
    with pytest.raises(KeyboardInterrupt):
        extract(plain, Listener(stop_at=(2, 5)))
    with pytest.raises(CheckpointError) as caught:
        check_output(plain)
    assert str(caught.value) == (
        "cages.h5.partial: checkpoint found (2 of 5 frames): continue with `resume=True` or start "
        "over with `overwrite=True`"
    )
    built = replace(plain, cage=None, cage_output=Path("cage.obj"))  # by the interrupted run
    with pytest.raises(CheckpointError, match="checkpoint found"):
        check_output(built)
    for change in ({"resume": True}, {"overwrite": True}):
        check_output(replace(plain, **change))


def test_weights_are_shared_by_clips_of_one_rest_pose_and_cage(plain, animation, write_obj):
    for k, name in ((1, "a_7.obj"), (2, "b_1.obj")):
        write_obj(Path(name), animation.frames[k - 1], animation.rest.faces)
    key = compute_weights_key(open_extraction(plain))
    one = replace(plain, frames=("a_7.obj",), jobs=3, memory=1, scene=SceneHints(fps=3.0))
    assert compute_weights_key(open_extraction(one)) == key
    Path("other.obj").write_text(Path("cage.obj").read_text() + "# other\n")
    changes = (
        {"frames": ("b_1.obj",)},
        {"rest_frame": 1},
        {"cage": Path("other.obj")},
        {"bind": BindSettings("mean-value")},
    )
    keys = [compute_weights_key(open_extraction(replace(plain, **change))) for change in changes]
    assert keys[0] == keys[1]
    assert len({key, *keys}) == 4


def test_the_settings_of_a_binding_file_are_recorded(plain):
    settings = replace(plain, bind=BindSettings("mean-value"))
    stored = open_extraction(settings).bind()
    write_binding(Path("binding.h5"), stored, overwrite=False)
    extraction = Extraction(replace(plain, cage=None, binding=Path("binding.h5")))
    result = extraction.run()
    assert extraction.recorded_settings["coordinates"] == "mean-value"
    assert set(extraction.sources) == {"binding", "cage", "rest"}
    assert result.sources["frames"]["files"] == 5


@pytest.mark.usefixtures("coarse_grids")
def test_a_cage_is_built_when_none_is_given(plain):
    listener = Listener()
    built = replace(plain, cage=None, build=BuildSettings(20), fit=False)
    result = extract(replace(built, cage_output=Path("built.obj")), listener)
    assert (len(result.cage.vertices), result.settings["cage_vertices"]) == (20, 20)
    digest = hashlib.sha256(Path("built.obj").read_bytes()).hexdigest()
    assert result.sources["cage"] == {"name": "built cage", "sha256": digest}
    (text,) = [text for topic, text in listener.notes if topic == "cage"]
    assert text.startswith("built, 20 vertices, 36 triangles, genus 0")
    named = extract(replace(plain, cage=Path("built.obj"), output=Path("named.h5")))
    assert np.array_equal(result.metrics.rms, named.metrics.rms)
    assert "cage_vertices" not in named.settings


@pytest.mark.usefixtures("coarse_grids")
def test_a_result_with_a_built_cage_is_kept_and_nothing_is_built(plain, monkeypatch):
    settings = replace(plain, cage=None, build=BuildSettings(20), resume=True)
    extract(settings)
    monkeypatch.setattr("cageik_cli.inputs.weights._build", fail)
    extract(replace(settings, cage_output=Path("built.obj")))
    assert len(load_mesh(Path("built.obj")).mesh.vertices) == 20
    with pytest.raises(CheckpointError, match="other settings"):
        extract(replace(settings, build=BuildSettings(21)))
    with pytest.raises(CheckpointError, match="other settings"):
        extract(replace(settings, cage=Path("cage.obj")))


@pytest.mark.usefixtures("coarse_grids")
def test_weights_in_a_built_cage_are_fitted_unless_that_is_refused(plain):
    built = replace(plain, cage=None, build=BuildSettings(20), resume=True)
    fitted = extract(built)
    assert fitted.fit.settings == FitSettings()
    assert fitted.settings["fit_regularization"] == "auto"
    for fit in (None, True, FitSettings()):  # the same run: up to date
        assert Extraction(replace(built, fit=fit)).run().path == fitted.path
    with pytest.raises(CheckpointError, match="other settings"):
        extract(replace(built, fit=False))
    refused = extract(replace(built, fit=False, overwrite=True))
    assert refused.fit is None
    assert not any("not fitted" in note for note in texts(refused.notes))
    with pytest.raises(CheckpointError, match="other settings"):
        extract(built)
    assert extract(replace(plain, output=Path("given.h5"))).fit is None


@pytest.mark.usefixtures("coarse_grids")
def test_a_fit_that_was_not_asked_for_does_not_hide_outliers(plain, monkeypatch):
    monkeypatch.setattr("cageik_cli.run.fit.has_outlier_vertices", lambda *_: True)
    settings = replace(plain, cage=None, build=BuildSettings(16))
    result = extract(settings)
    assert result.fit is None
    assert any("not fitted" in note and "`robust=True`" in note for note in texts(result.notes))
    assert extract(replace(settings, fit=True, overwrite=True)).fit is not None


@pytest.mark.usefixtures("coarse_grids")
@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"clip": ClipSettings(slice(0, 2))}, "the clip has 2 frames"),
        ({"clip": ClipSettings(missing=True)}, "noisy or missing"),
        ({"capture": CaptureSettings(robust=True)}, "noisy or missing"),
        ({"keep_weights": False}, "cannot be computed again"),
        ({"memory": 1000}, "more than the limit of 1 kB"),
    ],
)
def test_a_fit_that_was_not_asked_for_is_left_out_where_it_does_not_suit(plain, changes, says):
    settings = replace(plain, cage=None, build=BuildSettings(16), resume=True, **changes)
    result = extract(settings)
    assert result.fit is None
    assert "fit_regularization" not in result.settings
    assert [note for note in texts(result.notes) if says in note and "not fitted" in note]
    assert Extraction(settings).run().path == result.path  # up to date


@pytest.mark.usefixtures("coarse_grids")
def test_a_fit_by_default_of_frames_that_do_not_move_is_no_worse(plain, write_obj):
    for k in range(4):
        write_obj(Path("still") / f"s_{k}.obj", *_read_rest(plain))
    settings = replace(plain, frames=("still",), cage=None, build=BuildSettings(20))
    assert extract(settings).metrics.rms.max() < 1e-12


def _read_rest(settings):
    mesh = load_mesh(Path(settings.frames[0]) / "frame_1.obj").mesh
    return mesh.vertices, mesh.faces


@pytest.mark.usefixtures("coarse_grids")
def test_to_resume_does_not_replace_other_files(plain):
    """The file of the cage stays if the interrupted run has written it, and is refused if not."""
    settings = replace(plain, cage=None, build=BuildSettings(20), cage_output=Path("built.obj"))
    Path("built.obj").write_text("precious")
    for _ in ("no result yet", "a complete result"):
        with pytest.raises(OutputError, match=r"built\.obj: exists already"):
            extract(replace(settings, resume=True))
        assert Path("built.obj").read_text() == "precious"
        extract(replace(settings, cage_output=None, resume=True))
    extract(replace(settings, resume=True, overwrite=True))
    written = Path("built.obj").read_bytes()
    extract(replace(settings, resume=True))
    assert written != b"precious"
    assert Path("built.obj").read_bytes() == written


@pytest.mark.usefixtures("coarse_grids")
def test_known_weights_come_with_the_cage_that_was_built(plain, monkeypatch):
    settings = replace(plain, cage=None, build=BuildSettings(20))
    complete = open_extraction(settings)
    stored = complete.bind()
    monkeypatch.setattr("cageik_cli.inputs.weights._build", fail)
    result = Extraction(settings, stored=stored).run()
    assert result.sources["cage"] == complete.sources["cage"]
    assert compute_weights_key(open_extraction(settings)) == compute_weights_key(complete)
    other = replace(settings, build=BuildSettings(21))
    assert compute_weights_key(open_extraction(other)) != compute_weights_key(complete)


def test_the_builder_is_imported_when_a_cage_is_built(run_process):
    program = """
import sys, cageik_cli.run.extraction
found = [name for name in sys.modules if name.startswith("cageik_cli.cages.builder")]
assert not found, found
"""
    outcome = run_process("-c", program)
    assert (outcome.code, outcome.err) == (0, "")


@pytest.mark.usefixtures("coarse_grids")
def test_a_cage_from_the_cache_gives_the_same_bytes(plain, cache, monkeypatch):
    """A loose one, which has a warning."""
    monkeypatch.setattr("cageik_cli.cages.builder.build.make_shell", lambda *_: None)
    settings = replace(plain, cage=None, build=BuildSettings(20), cache=cache)
    plain_bytes = extract(replace(settings, cache=None)).path.read_bytes()
    assert extract(replace(settings, overwrite=True)).path.read_bytes() == plain_bytes
    monkeypatch.setattr("cageik_cli.inputs.weights._build", fail)
    listener = Listener()
    result = extract(replace(settings, overwrite=True), listener)
    assert result.path.read_bytes() == plain_bytes
    assert any(note.startswith("built cage: ") for note in texts(result.notes))
    said = [text.split()[0] for topic, text in listener.notes if topic in ("cache", "cage")]
    assert said == ["cache", "built,", "cache"]
    with pytest.raises(AssertionError, match="computed"):
        extract(replace(settings, build=BuildSettings(21), overwrite=True))


def test_the_file_of_a_built_cage_is_checked_before_any_work(plain):
    with pytest.raises(SettingError, match=r"built\.obj: is for a cage that is built"):
        replace(plain, cage_output=Path("built.obj"))
    with pytest.raises(OutputError, match=r"cage\.obj: exists already"):
        extract(replace(plain, cage=None, cage_output=Path("cage.obj")))
    with pytest.raises(OutputError, match=r"cage\.ply: a built cage is written as \.obj"):
        extract(replace(plain, cage=None, cage_output=Path("cage.ply")))


def test_a_model_without_a_cage_names_its_frame(plain, animation, write_obj):
    for path in Path("frames").iterdir():
        write_obj(path, 0 * animation.rest.vertices, animation.rest.faces)
    with pytest.raises(FormatError, match=r"frame_1\.obj: the model is one point"):
        extract(replace(plain, cage=None))
