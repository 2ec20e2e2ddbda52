"""Steps that a run has tried, in a result: read as they were written, or refused."""

import json

import h5py
import pytest

from cageik_cli.store.result import Result
from cageik_cli.store.result_fields import ClipSizes, list_fields
from cageik_cli.store.tried_steps import HiddenErrors, Step, TriedStep
from cageik_cli.util.errors import FormatError

FIELD = list_fields(Result)["tried"]
SIZES = ClipSizes(frames=7, vertices=20, cage_faces=12, skipped={})
TRIED = (TriedStep(Step.ROBUST, 1.5, 0.7, 8), TriedStep(Step.ROBUST_FIT, 1.5, 0.0, 8))


@pytest.fixture
def file(tmp_path):
    with h5py.File(tmp_path / "result.h5", "w") as opened:
        yield opened


def test_what_is_written_is_read(file):
    FIELD.write(file, "tried", ())
    assert "tried" not in file.attrs
    assert FIELD.read(file, SIZES) == ()
    FIELD.write(file, "tried", TRIED)
    assert FIELD.read(file, SIZES) == TRIED


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"frames": 0}, r"of no frame.*extract it again"),
        ({"after_percent": -0.1}, "an error below 0"),
        ({"before_percent": "much"}, "before_percent"),
        ({"step": "guess"}, "step"),
    ],
)
def test_what_no_run_writes_is_refused(file, changes, says):
    FIELD.write(file, "tried", TRIED[:1])
    held = json.loads(file.attrs["tried"])
    file.attrs["tried"] = json.dumps([held[0] | changes])
    with pytest.raises(FormatError, match=says):
        FIELD.read(file, SIZES)


@pytest.mark.parametrize(("after", "has_helped"), [(0.95, True), (0.96, False), (1.5, False)])
def test_a_step_has_helped_that_takes_a_twentieth_of_the_error(after, has_helped):
    assert TriedStep(Step.FIT, 1.0, after, 12).has_helped == has_helped


def test_smoothing_has_helped_that_takes_a_quarter():
    """What is hidden only stands for what is missing."""
    assert not TriedStep(Step.SMOOTH, 1.0, 0.76, 12).has_helped
    assert TriedStep(Step.SMOOTH, 1.0, 0.75, 12).has_helped


def test_errors_of_hidden_data_are_read_or_refused(file):
    hidden = HiddenErrors(0.5, 3.0, 20)
    field = list_fields(Result)["hidden"]
    assert field.read(file, SIZES) is None
    field.write(file, "hidden", hidden)
    assert field.read(file, SIZES) == hidden
    for changes in ({"frames": 0}, {"rms_percent": -1}, {"largest_percent": -1}):
        file.attrs["hidden"] = json.dumps(json.loads(file.attrs["hidden"]) | changes)
        with pytest.raises(FormatError, match=r"hidden.*extract it again"):
            field.read(file, SIZES)


def test_nothing_helps_where_nothing_is_missed():
    assert not TriedStep(Step.FIT, 0.0, 0.0, 12).has_helped
