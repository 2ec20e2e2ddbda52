"""Which handles the picture of an edit shows."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.editing import EditSettings, edit
from cageik_cli.report.pose_picture import as_png
from cageik_cli.report.pose_view import view_of
from cageik_cli.store.result import read_result


@pytest.fixture
def viewed(folder, run):
    """The picture of sets that are laid over the little animation, of five frames."""
    assert run("extract", "frames", "--cage", "cage.obj", "-o", "cages.h5", "-q").code == 0

    def make(*sets):
        Path("handles.json").write_text(json.dumps({"sets": sets}))
        settings = EditSettings(Path("cages.h5"), Path("handles.json"), Path("edited.h5"))
        return view_of(edit(settings), "Y")

    return make


def miss_percent(view, name):
    k = view.names.index(name)
    rest = read_result(Path("edited.h5")).rest
    return 100 * np.linalg.norm(view.ends[k] - view.targets[k]) / rest.diagonal


def moving(name, vertex, offset, **others):
    return {"handles": [{"name": name, "vertex": vertex, "offset": offset}], **others}


def test_sets_that_do_nothing_in_the_frame_are_not_shown(viewed):
    small, large = moving("a", 0, [0, 0.1, 0], frames=[0, 1]), moving("b", 3, [0, 1, 0])
    view = viewed(small, large | {"frames": [3, 4]})
    assert view.names == ("b",)
    np.testing.assert_allclose(view.targets - view.starts, [[0, 1, 0]], rtol=0, atol=1e-12)
    assert view.pinned.tolist() == [False]


def test_of_several_sets_the_last_decides_a_point(viewed):
    view = viewed(
        moving("first", 0, [0, 0.1, 0]), moving("other", 3, [0, 0, 0]), moving("last", 0, [1, 0, 0])
    )
    assert view.names == ("other", "last")
    np.testing.assert_allclose(view.ends[1], view.targets[1], rtol=0, atol=1e-6)
    (missed,) = re.findall(r"met within (\S+) %", view.title_after)
    assert float(missed) == pytest.approx(miss_percent(view, "other"), rel=1e-3)


def test_nothing_is_drawn_of_an_edit_that_does_nothing(viewed):
    view = viewed(moving("still", 0, [0, 0, 0], frames=[0, 1]))
    assert view.names == ()
    assert as_png(view, pixels=120).startswith(b"\x89PNG")
