"""The summary of a pose, as text and as JSON."""

import json
from dataclasses import replace

import pytest

from cageik_cli.editing.summary import AnchorSummary, CageEditSummary, PoseSummary
from cageik_cli.report.views.pose_text import MAX_SHOWN_HANDLES, format_pose_json, format_pose_rows

HAND = AnchorSummary("hand", "", 7, None, None, 0.2, 1e-9, 5e-8, "f_7")
CORNER = CageEditSummary("corner", 1, 0.3, 2, "f_8")
EDIT = PoseSummary(
    diagonal=2.0, anchors=(HAND,), rms=0.03, rms_percent=1.5, moved=0.25, moved_least=0.0,
    vertex=7, frame="f_8", cage_moved=0.3, cage_vertex=2, volume_change_percent=1.25,
    condition_number=152.0, rigidity=0, hold=True, changed=("f_3", "f_9"),
    volume_frame="f_4", moved_share_percent=12.34, share_frame="f_5",
)  # fmt: skip
POSE = replace(
    EDIT,
    anchors=(replace(HAND, frame=""),),
    frame="",
    volume_frame="",
    share_frame="",
    changed=None,
)


def hands(*changes, **others):
    """The edit with a handle for each of these changes of the hand."""
    return replace(EDIT, anchors=tuple(replace(HAND, **change) for change in changes), **others)


def list_rows(summary, label):
    return [text for name, text in format_pose_rows(summary) if name == label]


def test_an_edit_names_its_frames():
    rows = dict(format_pose_rows(EDIT))
    assert rows["handle"] == (
        "hand: moved 0.2, misses its target by 5.0e-08 % of the diagonal in f_7"
    )
    assert rows["moved most"] == "vertex 7 by 0.25 in f_8, cage vertex 2 by 0.3"
    assert rows["mesh moved"] == (
        "12.3 % of it by more than 0.5 % of the diagonal in f_5, rms 1.5000 % (0.03)"
    )
    assert rows["volume change"] == "largest +1.2500 % in f_4"
    assert rows["changed"] == "f_3 to f_9; all other frames are unchanged"
    assert rows["system"] == "condition number 152 (how much it amplifies noise)"
    assert {"note", "beyond radius"}.isdisjoint(rows)


def test_a_pose_has_no_frames():
    rows = dict(format_pose_rows(POSE))
    assert rows["handle"] == "hand: moved 0.2, misses its target by 5.0e-08 % of the diagonal"
    assert rows["moved most"] == "vertex 7 by 0.25, cage vertex 2 by 0.3"
    assert rows["volume change"] == "+1.2500 %"
    assert "changed" not in rows


def test_of_many_handles_those_farthest_from_their_targets_are_shown():
    many = hands(*({"name": f"h{k}", "residual": float(k)} for k in range(MAX_SHOWN_HANDLES + 3)))
    told = [text.split(":")[0] for text in list_rows(many, "handle")]
    assert told == [f"h{k}" for k in reversed(range(3, MAX_SHOWN_HANDLES + 3))]
    assert list_rows(many, "handles") == ["3 more, at least as close to their targets"]


@pytest.mark.parametrize(
    ("summary", "label", "told"),
    [
        (hands({"layer": "sets[0]"}), "handle", "hand (sets[0]): moved 0.2, misses its target by "),
        (hands({"residual_percent": 34}), "handle", "hand: moved 0.2, misses its target by 34 %"),
        (hands({"moved": 1e-9}), "handle", "hand: held"),
        (hands({"moved": 1e-9, "residual": 0.3}), "handle", "hand: moved"),
        (hands({"name": "a\n\x1b[31mb"}), "handle", "a \ufffd[31mb: "),
        (replace(EDIT, volume_change_percent=-4e-13), "volume change", "largest -4e-13 %"),
        (replace(EDIT, volume_change_percent=None), "volume change", "not defined, the model is"),
        (replace(EDIT, changed=None), "changed", "no frames"),
        (
            replace(EDIT, beyond_moved=2e-4, beyond_moved_percent=0.01),
            "beyond radius",
            "vertices moved by at most 0.01 % of the diagonal",
        ),
    ],
)
def test_a_row_says_what_happened(summary, label, told):
    (text,) = list_rows(summary, label)
    assert str(text).startswith(told)


@pytest.mark.parametrize(
    ("summary", "advice"),
    [
        (replace(EDIT, moved_least=0.1), None),
        (replace(EDIT, moved_least=0.2), "the whole model moves, by at least 0.2; pin the parts"),
        # The handle moves by 0.2, and 1.25 times as far is not much more.
        (replace(EDIT, moved=0.25), None),
        (
            replace(EDIT, moved=0.26),
            "vertex 7 moves by 0.26 in f_8, 1.3 times as far as any handle; pin a point near it",
        ),
        (
            hands({"moved": 0.0, "residual": 1.0}),
            "vertex 7 moves by 0.25 in f_8, but no handle moves; pin a point near it",
        ),
        (hands({"moved": 1e-9}), "no motion: "),
        # The diagonal is 2, so five diagonals are 10.
        (hands({}, {"moved": 9.9}), None),
        (hands({}, {"name": "foot", "moved": 10.1}), "foot moves 5.05 times the model's diagonal"),
        # The limits are 5 times the motion of any handle, and the diagonal.
        (hands({"moved": 0.5}, {}, cage_moved=2.4), None),
        (hands({"moved": 0.1}, {}, cage_moved=1.9), None),
        (hands({"moved": 0.5}, {}, cage_moved=2.6), "cage vertex 2 moves 2.6, more than 5 times"),
    ],
)
def test_what_was_probably_not_meant_gets_advice(summary, advice):
    notes = list_rows(summary, "note")
    assert len(notes) == (advice is not None)
    assert all(str(note).startswith(advice) for note in notes)


def test_handles_that_do_not_move_get_advice_on_the_cage_too():
    wild = hands({"moved": 0.0, "residual": 1.0}, cage_moved=9.0)
    assert "the cage cannot follow the handles" in str(list_rows(wild, "note")[-1])


def test_json_has_every_metric():
    record = json.loads(format_pose_json(EDIT))
    assert record["schema"] == 1
    assert record["changed"] == ["f_3", "f_9"]
    assert record["anchors"][0]["residual_percent"] == HAND.residual_percent
    assert set(record) == {"schema", "tool", *EDIT.__dataclass_fields__}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "move less far, or give handles another"),
        ({"hold": False}, "let them rotate"),
        ({"hold": False, "rigidity": 3}, "hold the rest, which is off"),
        ({"condition_number": None, "anchors": (), "cage_edits": (CORNER,)}, "move less far"),
    ],
)
def test_a_volume_that_changes_much_is_remarked_on(changes, expected):
    changed = replace(EDIT, volume_change_percent=-9.5, **changes)
    notes = [str(text) for text in list_rows(changed, "note")]
    assert any("the volume changes by -9.5000 % in f_4" in one and expected in one for one in notes)
    small = replace(changed, volume_change_percent=-4.5)
    assert not any("volume" in str(text) for text in list_rows(small, "note"))


def test_a_cage_that_is_too_coarse_for_a_radius_is_remarked_on():
    for percent, count in ((18.2, 1), (1.9, 0), (None, 0)):
        notes = list_rows(replace(EDIT, beyond_moved_percent=percent), "note")
        assert sum("beyond the radii" in str(text) for text in notes) == count
