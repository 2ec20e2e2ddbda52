"""A dry run lists what a batch would do, and does nothing."""

from dataclasses import replace

import pytest

from cageik_cli.batch.jobs import ClipJob
from cageik_cli.batch.run import FAULT_LABEL, BatchPlan, describe_batch
from cageik_cli.report.overview import ClipEntry
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import ExtractSettings
from tests.listeners import Listener


@pytest.fixture
def settings(folder):
    return ExtractSettings(
        (str(folder / "frames"),), folder / "cage.obj", folder / "a.h5", memory=1, resume=True
    )


def describe(settings, rejected=()):
    batch = BatchPlan(
        settings.output.parent,
        (ClipJob("a", settings),),
        tuple(ClipEntry(name, fault="no cage") for name in rejected),
        tuple(sorted(["a", *rejected])),
    )
    return describe_batch(batch)


def state(settings):
    return dict(describe(settings)["a"])["result"].split(".h5, ")[1]


@pytest.mark.usefixtures("single_frame_blocks")
def test_the_state_of_a_result_is_listed(settings, folder):
    assert state(settings) == "would be new"
    with pytest.raises(KeyboardInterrupt):
        extract(settings, Listener(stop_at=(2, 5)))
    before = sorted(folder.rglob("*"))
    assert state(settings) == "would continue from its checkpoint"
    assert state(replace(settings, resume=False, overwrite=True)) == "would be new"
    assert sorted(folder.rglob("*")) == before
    extract(settings)
    assert state(settings) == "up to date, nothing to do"
    assert state(replace(settings, resume=False, overwrite=True)) == "would be replaced"
    assert state(replace(settings, overwrite=True, rest_frame=1)) == "would be replaced"


def test_clips_that_would_fail_say_why(settings, folder):
    missing = replace(settings, cage=folder / "none.obj")
    described = describe(missing, ["b"])
    assert list(described) == ["a", "b"]
    ((label, why),) = described["a"]
    assert label == FAULT_LABEL
    assert "none.obj" in why
    assert described["b"] == [(FAULT_LABEL, "no cage")]
    assert FAULT_LABEL not in dict(describe(settings)["a"])
