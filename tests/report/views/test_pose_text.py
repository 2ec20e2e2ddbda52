"""The summary of a pose, as text and as JSON."""

import json
from dataclasses import replace

import pytest

from cageik_cli.posing.summary import AnchorSummary, PoseSummary
from cageik_cli.report.views.pose_text import MAX_SHOWN_HANDLES, format_pose_json, format_pose_rows

HAND = AnchorSummary("hand", "", 7, None, None, 0.2, 1e-9, 5e-8, "f_7", 0.03, 0.02)
EDIT = PoseSummary(
    diagonal=2.0, anchors=(HAND,), rms=0.03, rms_percent=1.5, moved=0.25, moved_least=0.0,
    vertex=7, frame="f_8", cage_moved=0.3, cage_vertex=2, volume_change_percent=1.25,
    condition_number=152.0, rigidity=0, changed=("f_3", "f_9"),
)  # fmt: skip
POSE = replace(
    EDIT,
    anchors=(replace(HAND, frame="", acceleration=None, acceleration_before=None),),
    frame="",
    changed=None,
)


def test_an_edit_names_its_frames():
    rows = dict(format_pose_rows(EDIT))
    assert rows["handle"] == (
        "hand: moved 0.2, misses its target by 5.0e-08 % of the diagonal in f_7"
    )
    assert rows["acceleration"] == "hand: up to 0.03 per frame² (0.02 before the edit)"
    assert rows["moved most"] == "vertex 7 by 0.25 in f_8, cage vertex 2 by 0.3"
    assert rows["mesh moved"] == "1.5000 % of the diagonal (rms 0.03)"
    assert rows["volume change"] == "largest +1.2500 %"
    assert rows["changed"] == "f_3 to f_9; all other frames are unchanged"
    assert rows["system"] == "condition number 152"


def test_a_pose_has_no_frames():
    rows = dict(format_pose_rows(POSE))
    assert rows["handle"] == "hand: moved 0.2, misses its target by 5.0e-08 % of the diagonal"
    assert rows["moved most"] == "vertex 7 by 0.25, cage vertex 2 by 0.3"
    assert rows["volume change"] == "+1.2500 %"
    assert "changed" not in rows
    assert "acceleration" not in rows


def test_of_many_handles_those_farthest_from_their_targets_are_shown():
    many = tuple(
        replace(HAND, name=f"h{k}", residual=float(k)) for k in range(MAX_SHOWN_HANDLES + 3)
    )
    rows = format_pose_rows(replace(EDIT, anchors=many))
    told = [text.split(":")[0] for label, text in rows if label == "handle"]
    assert told == [f"h{k}" for k in reversed(range(3, MAX_SHOWN_HANDLES + 3))]
    assert dict(rows)["handles"] == "3 more, at least as close to their targets"


def test_the_handle_with_the_largest_gain_in_acceleration_is_named():
    calm = replace(HAND, name="calm", acceleration=0.5, acceleration_before=0.5)
    rows = dict(format_pose_rows(replace(EDIT, anchors=(calm, HAND))))
    assert rows["acceleration"].startswith("hand: ")


def test_an_edit_without_more_acceleration_says_so():
    """Smoother motion and rounding do not count."""
    calm = replace(HAND, acceleration=0.02, acceleration_before=0.03)
    pin = replace(HAND, acceleration=0.5 + 1e-9, acceleration_before=0.5)
    rows = dict(format_pose_rows(replace(EDIT, anchors=(calm, pin))))
    assert rows["acceleration"] == "no handle accelerates more than before the edit"


def test_handles_of_several_sets_show_their_set():
    anchors = (replace(HAND, layer="sets[0]"), replace(HAND, layer="sets[1]", residual_percent=34))
    told = [
        text
        for label, text in format_pose_rows(replace(EDIT, anchors=anchors))
        if label == "handle"
    ]
    assert told[0].startswith("hand (sets[0]): moved 0.2, misses its target by 5.0e-08 %")
    assert told[1].startswith("hand (sets[1]): moved 0.2, misses its target by 34 %")


def test_a_model_that_moves_as_a_whole_gets_advice():
    along = dict(format_pose_rows(replace(EDIT, moved_least=0.2)))
    assert along["note"] == "the whole model moves, by at least 0.2; pin the parts that must stay"
    assert "note" not in dict(format_pose_rows(replace(EDIT, moved_least=0.1)))


@pytest.mark.parametrize(("moved", "told"), [(0.25, False), (0.26, True)])
def test_a_vertex_that_moves_more_than_the_handles_gets_advice(moved, told):
    """The handle moves by 0.2, and 1.25 times as far is not much more."""
    notes = [
        text for label, text in format_pose_rows(replace(EDIT, moved=moved)) if label == "note"
    ]
    advice = (
        "vertex 7 moves by 0.26 in f_8, 1.3 times as far as any handle; pin a point near it, or "
        "give the handles a radius in the handles file"
    )
    assert notes == [advice] * told


def test_a_vertex_that_moves_while_no_handle_does_gets_advice():
    stuck = replace(EDIT, anchors=(replace(HAND, moved=0.0, residual=1.0),))
    assert dict(format_pose_rows(stuck))["note"].startswith(
        "vertex 7 moves by 0.25 in f_8, but no handle moves; pin a point near it"
    )


def test_what_is_beyond_the_radius_is_told():
    edit = replace(EDIT, beyond_moved=2e-4, beyond_moved_percent=0.01)
    assert dict(format_pose_rows(edit))["beyond radius"] == (
        "vertices moved by at most 0.01 % of the diagonal"
    )
    assert "beyond radius" not in dict(format_pose_rows(EDIT))


def test_handles_at_their_targets_are_held_and_noted():
    pin = replace(HAND, moved=1e-9)
    rows = dict(format_pose_rows(replace(EDIT, anchors=(pin,))))
    assert rows["handle"] == "hand: held"
    assert rows["note"].startswith("no motion: ")
    rows = dict(format_pose_rows(replace(EDIT, anchors=(replace(pin, residual=0.3),))))
    assert not rows["note"].startswith("no motion: ")
    assert "held" not in rows["handle"]


def test_a_handle_that_moves_too_far_gets_advice_on_units():
    """The diagonal is 2, so five diagonals are 10."""
    edit = replace(EDIT, anchors=(HAND, replace(HAND, name="foot", moved=10.1)))
    assert dict(format_pose_rows(edit))["note"] == (
        "foot moves 5.05 times the model's diagonal (expected at most 5); give targets in the "
        "units and axes of the model's file"
    )
    assert "note" not in dict(format_pose_rows(replace(EDIT, anchors=(replace(HAND, moved=9.9),))))


@pytest.mark.parametrize(
    ("farthest", "cage", "told"), [(0.5, 2.6, True), (0.5, 2.4, False), (0.1, 1.9, False)]
)
def test_a_cage_that_moves_too_far_gets_advice(farthest, cage, told):
    """The limits are 5 times the motion of any handle, and the diagonal, which is 2."""
    edit = replace(EDIT, anchors=(replace(HAND, moved=farthest), HAND), cage_moved=cage)
    notes = [text for label, text in format_pose_rows(edit) if label == "note"]
    assert len(notes) == told
    assert all(text.startswith("cage vertex 2 moves 2.6, more than 5 times") for text in notes)


def test_handles_that_do_not_move_get_advice_too():
    wild = replace(EDIT, anchors=(replace(HAND, moved=0.0, residual=1.0),), cage_moved=9.0)
    assert "the cage cannot follow the handles" in dict(format_pose_rows(wild))["note"]


def test_a_change_of_zero_has_no_minus():
    rows = dict(format_pose_rows(replace(EDIT, volume_change_percent=-4e-13)))
    assert rows["volume change"] == "largest +0.0000 %"


@pytest.mark.parametrize(
    ("changes", "label", "text"),
    [
        ({"volume_change_percent": None}, "volume change", "not defined, the model is open"),
        ({"changed": None}, "changed", "no frames"),
    ],
)
def test_missing_metrics_are_stated(changes, label, text):
    assert dict(format_pose_rows(replace(EDIT, **changes)))[label] == text


def test_names_stay_on_one_line():
    rows = dict(format_pose_rows(replace(EDIT, anchors=(replace(HAND, name="a\n\x1b[31mb"),))))
    assert rows["handle"].startswith("a \ufffd[31mb: ")


def test_json_has_every_metric():
    record = json.loads(format_pose_json(EDIT))
    assert record["schema"] == 1
    assert record["changed"] == ["f_3", "f_9"]
    assert record["anchors"][0]["residual_percent"] == HAND.residual_percent
    assert set(record) == {"schema", "tool", *EDIT.__dataclass_fields__}
