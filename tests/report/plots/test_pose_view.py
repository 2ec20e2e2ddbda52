"""The view of a pose: the most moved frame, before and after."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.report.plots.model_plot import build_panels, render_pose_png
from cageik_cli.run.edit import edit, pose
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import EditSettings, ExtractSettings, PoseSettings
from cageik_cli.store.result import read_animation, read_weights

HANDLES = [
    {"name": "tip", "vertex": 0, "offset": [0.1, 0.2, -0.3], "hard": True},
    {"name": "pin", "vertex": 7, "pin": True, "hard": True},
]


@pytest.fixture
def handles(folder):
    def write(**others):
        Path("handles.json").write_text(json.dumps({"handles": HANDLES} | others))

    write()
    return write


def test_the_view_of_a_pose_starts_at_the_rest_pose(handles, animation):
    settings = PoseSettings(
        Path("frames/frame_1.obj"), Path("handles.json"), Path("posed.obj"), Path("cage.obj")
    )
    view = pose(settings).snapshot
    np.testing.assert_array_equal(view.before, animation.rest.vertices)
    np.testing.assert_array_equal(view.cage_before, animation.cage.vertices)
    np.testing.assert_array_equal(view.starts, animation.rest.vertices[[0, 7]])
    np.testing.assert_allclose(view.ends - view.starts, [[0.1, 0.2, -0.3], [0] * 3], atol=1e-12)
    np.testing.assert_allclose(view.after[[0, 7]], view.ends, rtol=0, atol=1e-12)
    np.testing.assert_allclose(view.targets, view.ends, rtol=0, atol=1e-12)
    assert (view.names, view.pinned.tolist(), view.up_axis) == (("tip", "pin"), [False, True], "Y")
    before, after = build_panels(view)
    assert before.title == "before"
    assert after.title.startswith("after: mesh moved ")


def test_the_view_of_an_edit_is_the_most_moved_frame(handles):
    settings = ExtractSettings(("frames",), Path("cage.obj"), Path("cages.h5"))
    result = extract(settings)
    keys = {"frames": [2, 4], "values": [[0.1, 0, 0], [0.5, 0, 0]]}
    Path("handles.json").write_text(
        json.dumps({"handles": [HANDLES[0] | {"offset": keys}, HANDLES[1]], "frames": [2, 4]})
    )
    view = edit(EditSettings(Path("cages.h5"), Path("handles.json"), Path("e.h5"))).snapshot
    assert view.frame == "frame_4.obj"
    assert build_panels(view)[0].title == "frame_4.obj, before"
    before = read_weights(result) @ view.cage_before
    np.testing.assert_allclose(view.before, before, rtol=0, atol=1e-12)
    np.testing.assert_allclose(view.targets[0] - view.starts[0], [0.5, 0, 0], atol=1e-12)


@pytest.fixture
def viewed(extracted):
    """A function that builds the view of sets applied to the small animation of five frames."""

    def make(*sets):
        Path("handles.json").write_text(json.dumps({"sets": sets}))
        settings = EditSettings(Path("cages.h5"), Path("handles.json"), Path("edited.h5"))
        return edit(settings).snapshot

    return make


def miss_percent(view, name):
    k = view.names.index(name)
    rest = read_animation(Path("edited.h5")).rest
    return 100 * np.linalg.norm(view.ends[k] - view.targets[k]) / rest.diagonal


def moving(name, vertex, offset, **others):
    return {"handles": [{"name": name, "vertex": vertex, "offset": offset}], **others}


def test_sets_without_effect_in_the_frame_are_not_shown(viewed):
    small, large = moving("a", 0, [0, 0.1, 0], frames=[1, 2]), moving("b", 3, [0, 1, 0])
    view = viewed(small, large | {"frames": [4, 5]})
    assert view.names == ("b",)
    np.testing.assert_allclose(view.targets - view.starts, [[0, 1, 0]], rtol=0, atol=1e-12)
    assert view.pinned.tolist() == [False]


def test_of_several_sets_the_last_decides_a_point(viewed):
    view = viewed(
        moving("first", 0, [0, 0.1, 0], hold=False),
        moving("other", 3, [0, 0, 0], hold=False),
        moving("last", 0, [1, 0, 0], hold=False),
    )
    assert view.names == ("other", "last")
    np.testing.assert_allclose(view.ends[1], view.targets[1], rtol=0, atol=1e-6)
    (missed,) = re.findall(r"miss of a target (\S+) %", build_panels(view)[1].title)
    assert float(missed) == pytest.approx(miss_percent(view, "other"), rel=1e-3)


def test_an_edit_without_effect_shows_no_handles(viewed):
    view = viewed(moving("still", 0, [0, 0, 0], frames=[1, 2]))
    assert view.names == ()
    assert render_pose_png(view, pixels=120).startswith(b"\x89PNG")
