"""Which steps a run tries, and where it tries none."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.run import tried_steps
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.store.result import read_result
from cageik_cli.store.tried_steps import Step
from tests.corruptions import corrupt
from tests.shapes import TETRAHEDRON, ball, moved


@pytest.fixture
def settings(tmp_path, monkeypatch, write_obj, coarse_panels, weights_cache):
    """A ball that sways, in a cage of 18 vertices."""
    monkeypatch.chdir(tmp_path)
    body = ball(3, 1.0)
    sway = np.sin(np.arange(12))[:, None] * body.vertices[:, 2] ** 2
    frames = body.vertices + sway[..., None] * [1.0, 0.5, 0.0]
    frames[0] = body.vertices
    np.savez("clean.npz", verts=frames, faces=body.faces)
    np.savez("thrown.npz", verts=corrupt("outliers", frames), faces=body.faces)
    np.savez("torn.npz", verts=corrupt("tears", frames), faces=body.faces)
    cage = moved(ball(1, 1.0), scale=1.5)
    path = write_obj(tmp_path / "cage.obj", cage.vertices, cage.faces)
    four = moved(TETRAHEDRON, scale=14.0, shift=(-3, -3, -3))
    write_obj(tmp_path / "four.obj", four.vertices, four.faces)
    return ExtractSettings(("clean.npz",), path, Path("cages.h5"), cache=weights_cache)


def list_tried(settings, **changes):
    tried = extract(replace(settings, overwrite=True, **changes)).tried
    return [one.step for one in tried]


def test_a_fit_is_tried_on_a_clean_clip_and_outliers_are_rejected_on_another(settings):
    assert list_tried(settings) == [Step.FIT]
    assert list_tried(settings, fit=True) == []
    thrown = replace(settings, frames=("thrown.npz",))
    assert list_tried(thrown) == [Step.ROBUST, Step.ROBUST_FIT]
    assert list_tried(thrown, fit=True) == [Step.ROBUST]
    assert list_tried(thrown, capture=replace(thrown.capture, robust=True)) == []


def test_of_a_torn_surface_outliers_are_rejected_and_no_fit_is_tried(settings):
    torn = replace(settings, frames=("torn.npz",))
    assert list_tried(torn) == [Step.TORN]
    assert list_tried(torn, fit=True) == [Step.TORN]
    assert list_tried(torn, capture=replace(torn.capture, robust=True)) == []


def test_both_trials_of_outliers_share_the_frames_that_are_read(settings, monkeypatch):
    """Once to look for outliers, once to reject them, and once to fit weights."""
    read, run, counts = MeshSequence.read_frame, tried_steps.StepTrials.run, Counter()

    def count(sequence, index):
        counts[id(sequence), index] += 1
        return read(sequence, index)

    def run_counted(trials):
        monkeypatch.setattr(MeshSequence, "read_frame", count)
        found = run(trials)
        monkeypatch.setattr(MeshSequence, "read_frame", read)
        return found

    monkeypatch.setattr(tried_steps.StepTrials, "run", run_counted)
    assert len(list_tried(replace(settings, frames=("thrown.npz",)))) == 2
    assert 1 <= max(counts.values()) <= 3


def test_a_result_says_what_was_tried_only_if_something_was(settings):
    """Old results do not say so either."""
    for changes, is_said in (({"fit": True}, False), ({}, True)):
        result = extract(replace(settings, overwrite=True, **changes))
        with h5py.File(settings.output) as file:
            assert ("tried" in file.attrs) == is_said
        assert read_result(settings.output).tried == result.tried
        assert bool(result.tried) == is_said


def test_what_the_same_command_refuses_is_not_tried(settings):
    """Outliers are not rejected in a norm that follows them; fitted weights must be stored."""
    thrown = replace(settings, frames=("thrown.npz",))
    assert list_tried(thrown, solve=SolveSettings(norm=4)) == []
    assert list_tried(thrown, keep_weights=False) == [Step.ROBUST]
    assert list_tried(settings, keep_weights=False) == []
    assert list_tried(settings, clip=replace(settings.clip, missing=True)) == []


def test_a_cage_that_determines_the_weights_is_not_fitted(settings):
    assert list_tried(settings, cage=Path("four.obj")) == []


def test_a_fit_is_not_tried_that_takes_more_memory_than_there_is(settings, monkeypatch):
    assert list_tried(settings, memory=1) == [Step.FIT]  # it is small
    monkeypatch.setattr(tried_steps, "FREE_MEMORY", 0)
    assert list_tried(settings, memory=1) == []


def test_nothing_is_tried_where_no_error_is_seen(settings, monkeypatch):
    monkeypatch.setattr(tried_steps, "is_invisible", lambda *_: True)
    assert list_tried(settings) == []
