"""A plan is all that a run needs; making one writes nothing."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.settings import SceneHints
from cageik_cli.store.binding_file import write_binding
from cageik_cli.util.errors import (
    CheckpointError,
    FormatError,
    InputError,
    OutputError,
    SettingError,
)
from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows import extract as module
from cageik_cli.workflows.extract import extract, run_extraction
from cageik_cli.workflows.plan import (
    build_missing_cage,
    check_output_path,
    load_or_compute_binding,
    plan_extraction,
)
from cageik_cli.workflows.settings import ExtractSettings


class Notes(ProgressListener):
    """Remembers what was noted."""

    def __init__(self):
        self.notes = []

    def note(self, topic, text):
        self.notes.append((topic, text))


def fail(*_, **__):
    raise AssertionError("computed")


@pytest.fixture
def plain(folder):
    """Settings for the little animation."""
    return ExtractSettings(frames=("frames",), cage=Path("cage.obj"), output=Path("cages.h5"))


def test_a_plan_writes_nothing(plain, folder):
    before = sorted(folder.rglob("*"))
    plan = plan_extraction(replace(plain, resume=True))
    assert plan.existing is None
    assert sorted(folder.rglob("*")) == before


def test_a_plan_that_is_run_gives_the_same_bytes(plain):
    expected = extract(replace(plain, output=Path("other.h5"))).path.read_bytes()
    assert run_extraction(plan_extraction(plain)).path.read_bytes() == expected


def test_known_weights_are_used(plain, monkeypatch):
    expected = extract(plain).path.read_bytes()
    binding = load_or_compute_binding(plan_extraction(plain), ProgressListener())

    def fail(*_):
        raise AssertionError("computed")

    monkeypatch.setattr("cageik_cli.workflows.plan.bind_cached", fail)
    plan = plan_extraction(replace(plain, overwrite=True), binding)
    assert run_extraction(plan).path.read_bytes() == expected
    with pytest.raises(AssertionError, match="computed"):
        run_extraction(plan_extraction(replace(plain, overwrite=True)))


def test_an_existing_result_is_returned_without_work(plain, monkeypatch):
    extract(plain)
    plan = plan_extraction(replace(plain, resume=True))
    assert plan.existing is not None

    def fail(*_):
        raise AssertionError("bound")

    monkeypatch.setattr(module, "load_or_compute_binding", fail)
    assert run_extraction(plan) is plan.existing
    changed = replace(plain, resume=True, overwrite=True, rest_frame=2)
    with pytest.raises(AssertionError, match="bound"):
        run_extraction(plan_extraction(changed))


def test_without_resume_an_existing_result_is_not_looked_for(plain):
    extract(plain)
    assert plan_extraction(replace(plain, overwrite=True)).existing is None
    with pytest.raises(InputError, match=r"cages\.h5"):
        check_output_path(plain)


def test_a_checkpoint_is_not_overwritten_unasked(plain, single_frame_blocks):
    class Interrupt(ProgressListener):
        def update(self, done, total):
            if (done, total) == (2, 5):
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        extract(plain, Interrupt())
    with pytest.raises(CheckpointError) as caught:
        check_output_path(plain)
    assert str(caught.value) == (
        "cages.h5.partial: checkpoint found (2 of 5 frames): continue with --resume or start over "
        "with --overwrite"
    )
    built = replace(plain, cage=None, cage_output=Path("cage.obj"))  # by the interrupted run
    with pytest.raises(CheckpointError, match="checkpoint found"):
        check_output_path(built)
    for change in ({"resume": True}, {"overwrite": True}):
        check_output_path(replace(plain, **change))


def test_weights_are_shared_by_clips_of_one_rest_pose_and_cage(plain, animation, write_obj):
    for k, name in ((1, "a_7.obj"), (2, "b_1.obj")):
        write_obj(Path(name), animation.frames[k - 1], animation.rest.faces)
    key = plan_extraction(plain).weights_key
    one = replace(plain, frames=("a_7.obj",), jobs=3, memory=1, scene=SceneHints(fps=3.0))
    assert plan_extraction(one).weights_key == key
    Path("other.obj").write_text(Path("cage.obj").read_text() + "# other\n")
    changes = (
        {"frames": ("b_1.obj",)},
        {"rest_frame": 1},
        {"cage": Path("other.obj")},
        {"bind": BindSettings("mean-value")},
    )
    keys = [plan_extraction(replace(plain, **change)).weights_key for change in changes]
    assert keys[0] == keys[1]
    assert len({key, *keys}) == 4


def test_the_settings_of_a_binding_file_are_recorded(plain):
    settings = replace(plain, bind=BindSettings("mean-value"))
    stored = load_or_compute_binding(plan_extraction(settings), ProgressListener())
    write_binding(Path("binding.h5"), stored, overwrite=False)
    plan = plan_extraction(replace(plain, cage=None, binding=Path("binding.h5")))
    assert plan.recorded_settings["coordinates"] == "mean-value"
    assert set(plan.sources) == {"binding", "cage", "rest"}
    assert plan.collect_sources()["frames"]["files"] == 5


@pytest.mark.usefixtures("coarse_grids")
def test_a_cage_is_built_when_none_is_given(plain):
    listener = Notes()
    settings = replace(plain, cage=None, build=BuildSettings(20), cage_output=Path("built.obj"))
    result = extract(settings, listener)
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
    monkeypatch.setattr("cageik_cli.workflows.cached_cage._build", fail)
    extract(replace(settings, cage_output=Path("built.obj")))
    assert len(load_mesh(Path("built.obj")).mesh.vertices) == 20
    with pytest.raises(CheckpointError, match="other settings"):
        extract(replace(settings, build=BuildSettings(21)))
    with pytest.raises(CheckpointError, match="other settings"):
        extract(replace(settings, cage=Path("cage.obj")))


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
    progress = ProgressListener()
    complete = build_missing_cage(plan_extraction(settings), progress)
    stored = load_or_compute_binding(complete, progress)
    monkeypatch.setattr("cageik_cli.workflows.cached_cage._build", fail)
    result = run_extraction(plan_extraction(settings, stored))
    assert result.sources["cage"] == complete.sources["cage"]
    assert plan_extraction(settings).weights_key == complete.weights_key
    other = replace(settings, build=BuildSettings(21))
    assert plan_extraction(other).weights_key != complete.weights_key


def test_the_builder_is_imported_when_a_cage_is_built(run_process):
    program = """
import sys, cageik_cli.workflows.extract
found = [name for name in sys.modules if name.startswith("cageik_cli.cages.building")]
assert not found, found
"""
    outcome = run_process("-c", program)
    assert (outcome.code, outcome.err) == (0, "")


@pytest.mark.usefixtures("coarse_grids")
@pytest.mark.parametrize("loose", [False, True])
def test_a_cage_from_the_cache_gives_the_same_bytes(plain, cache, monkeypatch, loose):
    if loose:  # a cage with a warning
        monkeypatch.setattr("cageik_cli.cages.building.job.make_shell", lambda *_: None)
    settings = replace(plain, cage=None, build=BuildSettings(20), cache=cache)
    plain_bytes = extract(replace(settings, cache=None)).path.read_bytes()
    assert extract(replace(settings, overwrite=True)).path.read_bytes() == plain_bytes
    monkeypatch.setattr("cageik_cli.workflows.cached_cage._build", fail)
    listener = Notes()
    result = extract(replace(settings, overwrite=True), listener)
    assert result.path.read_bytes() == plain_bytes
    assert [note.startswith("built cage: ") for note in result.notes] == [True] * loose
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
