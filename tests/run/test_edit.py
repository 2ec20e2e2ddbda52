"""Poses of a model from files, and what is remarked on the way."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.run.edit import pose
from cageik_cli.run.settings import PoseSettings
from cageik_cli.util.errors import FileAccessError, InputError, SettingError
from tests.listeners import Listener
from tests.shapes import box, quad_text

TIP = {"name": "tip", "vertex": 0, "offset": [0.1, 0.2, -0.3]}
PIN = {"name": "pin", "vertex": 7, "pin": True}


@pytest.fixture
def settings(folder):
    """To pose the first frame by handles."""

    def make(*handles, cage="cage.obj", **place):
        Path("handles.json").write_text(json.dumps({"handles": handles}))
        posing = PosingSettings(**place)
        names = map(Path, ("frames/frame_1.obj", "handles.json", "posed.obj"))
        return PoseSettings(*names, cage and Path(cage), posing=posing)

    return make


def test_how_handles_were_understood_is_noted(settings):
    other = TIP | {"name": "other", "offset": [0.3, 0.2, -0.3]}
    near = {"name": "near", "position": [0, 0, 3], "pin": True}
    notes = Listener()
    pose(settings(TIP, other, near, snap=100, allow_conflicts=True), notes)
    told = [text for topic, text in notes.notes if topic == "note"]
    assert [
        text for text in told if text.startswith("handles.json: handle 'near': position snapped to")
    ]
    assert [text for text in told if "'tip' and 'other' conflict" in text]


def test_changes_of_the_cage_are_noted(settings, write_obj, animation):
    turned = animation.cage.flip()
    write_obj(Path("inward.obj"), turned.vertices, turned.faces)
    notes = Listener()
    posed = pose(settings(TIP, PIN, cage="inward.obj"), notes)
    assert [text for _, text in notes.notes if text.startswith("inward.obj: ")]
    cage = posed.snapshot.cage.move(posed.snapshot.cage_before)
    np.testing.assert_allclose(cage.volume, animation.cage.volume, rtol=1e-12)


def test_triangulation_is_noted(settings):
    Path("model.obj").write_text(quad_text(1.0))
    Path("quads.obj").write_text(quad_text(2.0, inward=True))
    made = settings(TIP, PIN, cage="quads.obj")
    notes = Listener()
    pose(replace(made, target=Path("model.obj")), notes)
    told = [text for topic, text in notes.notes if topic == "note"]
    assert "model.obj: 6 polygons cut into triangles to compute with" in told
    assert "quads.obj: 6 polygons cut into triangles to compute with" in told
    warned = [text for topic, text in notes.notes if topic == "warning"]
    assert [text for text in warned if text.startswith("quads.obj: the cage's faces turn inward")]


def test_a_model_needs_a_cage(settings):
    with pytest.raises(SettingError, match=r"frame_1\.obj: .*`cage=`"):
        pose(settings(TIP, PIN, cage=None))
    assert not Path("posed.obj").exists()


def test_an_unfit_cage_is_refused_by_its_name(settings, write_obj):
    small = box(0.1)
    write_obj(Path("small.obj"), small.vertices, small.faces)
    with pytest.raises(InputError, match=r"^small\.obj: "):
        pose(settings(TIP, PIN, cage="small.obj"))


def test_an_animation_must_be_extracted_first(settings):
    """Before the output is looked at, whose suffix would be that of a result."""
    edit = replace(settings(TIP, PIN), target=Path("frames"), output=Path("edited.h5"))
    with pytest.raises(FileAccessError, match=r"^frames: is a folder, .*cageik extract"):
        pose(edit)
