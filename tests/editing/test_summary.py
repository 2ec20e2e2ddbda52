"""The summary of an edit, against plain expressions over whole arrays."""

import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.editing.cage_edits import EditFiles
from cageik_cli.editing.edits import EditTarget, LayeredEdit
from cageik_cli.editing.summary import PoseStatistics
from cageik_cli.formats.settings import Scene
from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.method.weights.settings import BindSettings
from tests.editing.handles.files import read
from tests.shapes import ball, box, changed

COUNT = 12
NAMES = [f"f_{k}" for k in range(COUNT)]
DOCUMENT = {
    "handles": [
        {"name": "a", "vertex": 1, "target": [2.0, 0.5, 0.25]},
        {"name": "b", "vertex": 4, "offset": [0.0, 0.5, 0.0]},
        {"name": "c", "vertex": 9, "pin": True},
    ],
    "frames": [4, 6],
    "falloff": 3,
}

FROM_0 = Scene(start=0)


def make_target(rest):
    binding = bind(rest, box(2.0), BindSettings("mean-value"))
    wobble = np.random.default_rng(0).normal(0, 0.05, (COUNT, 8, 3))
    cages = binding.cage.vertices + wobble
    return EditTarget.of_animation(
        binding, lambda frame: cages[frame], NAMES, scene=Scene(start=0)
    ), cages


@pytest.fixture(scope="module")
def closed():
    return make_target(ball(levels=1, size=0.9))


@pytest.fixture
def make_edit(tmp_path):
    def make(clip, document=DOCUMENT, **settings):
        return LayeredEdit(EditFiles(read(tmp_path, document)), clip, PosingSettings(**settings))

    return make


def summarize(edit, cages, size):
    """By blocks of a size."""
    statistics = PoseStatistics(edit)
    for start in range(0, COUNT, size):
        chosen = np.arange(COUNT)[start : start + size]
        statistics.update(edit.edit_frames(chosen, cages[chosen]))
    return statistics.summarize()


def test_the_summary_does_not_depend_on_blocks(closed, make_edit):
    clip, cages = closed
    made = make_edit(clip, rigidity=1)
    whole = summarize(made, cages, COUNT)
    for size in (1, 2, 5):
        found = summarize(made, cages, size)
        assert found.rms == pytest.approx(whole.rms, rel=1e-12)
        assert found.anchors == whole.anchors
        assert (found.moved, found.vertex, found.frame) == (whole.moved, whole.vertex, whole.frame)
        assert found.volume_change_percent == whole.volume_change_percent
        assert found.changed == whole.changed == ("f_2", "f_8")


def test_the_summary_equals_its_definitions(closed, make_edit):
    clip, cages = closed
    made = make_edit(clip, alpha=1.0)
    found = summarize(made, cages, 4)
    block = made.edit_frames(np.arange(COUNT), cages)
    weights, diagonal = clip.binding.weights, clip.binding.rest.diagonal
    before, after = weights @ cages, weights @ block.cages_after
    distances = np.linalg.norm(after - before, axis=2)
    assert found.rms == pytest.approx(np.sqrt((distances**2).mean()), rel=1e-9)
    assert found.rms_percent == pytest.approx(100 * found.rms / diagonal, rel=1e-12)
    frame, vertex = np.unravel_index(distances.argmax(), distances.shape)
    assert (found.frame, found.vertex) == (NAMES[frame], vertex)
    assert found.moved == pytest.approx(distances.max(), rel=1e-9)
    cage_distances = np.linalg.norm(block.cages_after - cages, axis=2)
    assert found.cage_moved == pytest.approx(cage_distances.max(), rel=1e-12)
    assert found.cage_vertex == cage_distances.max(axis=0).argmax()
    first = found.anchors[0]
    missed = np.linalg.norm(after[:, 1] - block.targets[:, 0], axis=1)
    assert missed.max() > 1e-3  # a large alpha: the handle is not met
    assert first.residual == pytest.approx(missed.max(), rel=1e-9)
    assert first.frame == NAMES[missed.argmax()]
    assert first.residual_percent == pytest.approx(100 * missed.max() / diagonal, rel=1e-9)
    assert first.moved == pytest.approx(distances[:, 1].max(), rel=1e-9)
    assert found.moved_least == pytest.approx(distances[frame].min(), rel=1e-9)


def test_anchors_name_their_sets(closed, make_edit):
    clip, cages = closed
    both = make_edit(clip, {"sets": [DOCUMENT, {**DOCUMENT, "handles": DOCUMENT["handles"][:1]}]})
    found = summarize(both, cages, COUNT)
    assert [anchor.layer for anchor in found.anchors] == [*["sets[0]"] * 3, "sets[1]"]
    assert {anchor.layer for anchor in summarize(make_edit(clip), cages, 4).anchors} == {""}


def test_anchors_count_in_the_frames_of_their_set_only(closed, make_edit):
    """One vertex goes up by 0.1 in some frames, and down by 0.3 in others."""
    clip, cages = closed
    sets = [
        {
            "handles": [{"name": "a", "vertex": 1, "offset": [0, offset, 0]}],
            "frames": frames,
            "hold": False,
        }
        for offset, frames in ((0.1, [0, 2]), (-0.3, [6, 9]))
    ]
    found = summarize(make_edit(clip, {"sets": sets}), cages, 4)
    assert [anchor.moved for anchor in found.anchors] == pytest.approx([0.1, 0.3], rel=1e-4)
    assert max(anchor.residual for anchor in found.anchors) < 1e-5


def test_only_closed_models_have_a_volume_change(closed, make_edit):
    clip, cages = closed
    block = make_edit(clip).edit_frames(np.arange(COUNT), cages)
    changes = 100 * (block.metrics.volume_reconstructed / block.metrics.volume - 1)
    found = summarize(make_edit(clip), cages, 5)
    assert abs(found.volume_change_percent) == pytest.approx(np.abs(changes).max(), rel=1e-12)
    rest = clip.binding.rest
    opened, open_cages = make_target(changed(rest, faces=rest.faces[1:]))
    assert summarize(make_edit(opened), open_cages, 5).volume_change_percent is None


def test_a_pin_that_does_not_move_gives_zeros(closed, make_edit):
    clip, cages = closed
    pins = {"handles": [{"name": "p", "vertex": 3, "pin": True}]}
    found = summarize(make_edit(clip, pins), cages, 5)
    assert (found.rms, found.moved, found.cage_moved, found.changed) == (0, 0, 0, None)
    assert found.anchors[0].residual == 0
    assert found.volume_change_percent == 0


def test_no_frames_change_nothing(closed, make_edit):
    clip, cages = closed
    made = make_edit(clip)
    statistics = PoseStatistics(made)
    statistics.update(made.edit_frames(np.arange(0), cages[:0]))
    assert statistics.summarize().changed is None
