"""Edits over each other: what a later one sees, and what none of them touches."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.editing.cage_edits import EditFiles
from cageik_cli.editing.edits import EditTarget, LayeredEdit
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.errors import HandlesError, SettingError
from tests.editing.handles.files import CAMERA, read
from tests.shapes import ball, box, rotation

COUNT = 6
NAMES = [f"f_{k}" for k in range(COUNT)]
AHEAD = CAMERA | {"position": [0, 0, 9], "width": 100, "height": 100}


@pytest.fixture(scope="module")
def binding():
    return bind(ball(levels=1, size=0.9), box(2.0), BindSettings("mean-value"))


@pytest.fixture(scope="module")
def cages(binding):
    steps = np.arange(COUNT)[:, None, None] * np.array([0.1, 0.0, 0.05])
    return binding.cage.vertices * (1 + 0.02 * np.arange(COUNT)[:, None, None]) + steps


@pytest.fixture
def clip(binding, cages):
    return EditTarget.of_animation(binding, lambda frame: cages[frame], NAMES, scene=Scene(start=0))


@pytest.fixture
def make_edit(tmp_path, clip):
    """The edit of a document."""

    def make(document, **settings):
        return LayeredEdit(EditFiles(read(tmp_path, document)), clip, PosingSettings(**settings))

    return make


def animation_of(binding, rotations=None):
    return EditTarget.of_animation(binding, lambda frame: None, NAMES, rotations, Scene(start=0))


def moving(offset, **others):
    return {"handles": [{"name": "a", "vertex": 1, "offset": offset}], **others}


def test_a_skin_at_rest_gives_the_rest_pose_bit_for_bit(binding):
    meshes = EditTarget.of_model(binding).deform(np.zeros(1, int), binding.cage.vertices[None])
    np.testing.assert_array_equal(meshes[0], binding.rest.vertices)


def test_a_skin_for_reconstruction_is_weights_times_cages(binding, cages):
    meshes = animation_of(binding).deform(np.arange(COUNT), cages)
    np.testing.assert_allclose(meshes, binding.weights @ cages, rtol=0, atol=1e-15)


@pytest.mark.parametrize("make", [EditTarget.of_model, animation_of])
def test_anchors_are_where_their_vertices_are(binding, cages, make_edit, make):
    anchors = make_edit(moving([1, 0, 0])).anchors
    skin = make(binding)
    frames = np.arange(COUNT)
    positions = skin.anchor_positions(anchors, frames, cages)
    meshes = skin.deform(frames, cages)
    np.testing.assert_allclose(positions[:, 0], meshes[:, 1], rtol=0, atol=1e-14)


def test_offsets_turn_with_the_frames(binding, cages, make_edit):
    """Weights that do not reproduce the rest pose give it for the rest cage, turned."""
    few = replace(binding, weights=np.round(binding.weights, 1), has_offsets=True)
    turns = np.array([rotation(k) for k in range(COUNT)])
    skin = animation_of(few, turns)
    frames = np.arange(COUNT)
    turned = few.cage.vertices @ turns
    np.testing.assert_allclose(
        skin.deform(frames, turned), few.rest.vertices @ turns, rtol=0, atol=1e-13
    )
    anchors = make_edit(moving([1, 0, 0])).anchors
    found = skin.anchor_positions(anchors, frames[2:], cages[2:])
    np.testing.assert_allclose(
        found[:, 0], skin.deform(frames[2:], cages[2:])[:, 1], rtol=0, atol=1e-13
    )


def test_frames_that_no_layer_changes_keep_their_cages(cages, make_edit):
    found, _, _ = make_edit(moving([0, 1, 0], frames=[2, 3])).apply(np.arange(COUNT), cages)
    changed = (found != cages).any(axis=(1, 2))
    assert changed.tolist() == [False, False, True, True, False, False]


def test_a_frame_does_not_depend_on_its_block(cages, make_edit):
    both = make_edit({"sets": [moving([0, 1, 0]), moving([1, 0, 0], frames=[1, 3])]}, rigidity=2)
    cages_together, _, targets_together = both.apply(np.arange(COUNT), cages)
    for k in range(COUNT):
        alone, _, targets = both.apply(np.array([k]), cages[[k]])
        np.testing.assert_array_equal(alone[0], cages_together[k])
        np.testing.assert_array_equal(targets[0], targets_together[k])


def test_a_later_layer_starts_where_the_first_ended(cages, make_edit):
    target = [3.0, 0.5, 0.25]
    goes = {"handles": [{"name": "a", "vertex": 1, "target": target, "hard": True}]}
    both = make_edit({"sets": [goes, moving([0, 1, 0])]})
    _, starts, targets = both.apply(np.arange(COUNT), cages)
    np.testing.assert_allclose(starts[:, 1] - target, 0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(targets[:, 1] - target, [[0, 1, 0]] * COUNT, rtol=0, atol=1e-12)


def test_pixels_are_picked_on_the_result_of_earlier_layers(make_edit):
    """The first layer moves the model out of the view, so that a pixel meets nothing."""
    seen = {
        "handles": [{"name": "eye", "screen": {"source": [50, 50], "target": [60, 50]}}],
        "camera": AHEAD,
    }
    assert len(make_edit(seen).layers) == 1
    with pytest.raises(HandlesError, match=r"drag\.json: sets\[1\]: handle 'eye'.*misses the mesh"):
        make_edit({"sets": [moving([100, 0, 0]) | {"hold": False}, seen]})


def test_frames_behind_the_camera_are_allowed_where_the_handle_does_not_act(cages, make_edit):
    """The clip walks behind the camera; the handle is let go before."""
    away = cages + np.array([0, 0, 20.0]) * (np.arange(COUNT) > 3)[:, None, None]
    eye = {"name": "eye", "screen": {"source": [50, 50], "offset": [9, 0]}}
    held = {"handles": [eye], "camera": AHEAD, "frames": [0, 2]}
    found, _, _ = make_edit(held).apply(np.arange(COUNT), away)
    assert (found != away).any(axis=(1, 2)).tolist() == [True] * 3 + [False] * 3
    always = held | {"frames": [0, COUNT - 1]}
    with pytest.raises(HandlesError, match=r"frame 4.*behind the camera"):
        make_edit(always).apply(np.arange(COUNT), away)


def test_a_too_large_ratio_of_weights_is_refused():
    with pytest.raises(SettingError, match=r"`alpha=` is 1e\+300, .* 1e-300"):
        PosingSettings(1e300, 1e-300)
    assert PosingSettings(1e-300, 1e300).beta == 1e300


def test_the_mirror_of_handles_turns_with_each_frame(binding, tmp_path):
    """An edit of a turned clip is the turned edit; frames without a move keep their bits."""
    turns = np.stack([rotation(seed) for seed in range(COUNT)])
    cages = binding.cage.vertices @ turns
    offset = np.array([0.1, 0.2, 0.3])
    values = (offset @ turns).tolist()
    document = {
        "handles": [
            {"name": "a", "vertex": 1, "offset": {"frames": [*range(COUNT)], "values": values}}
        ],
        "mirror": {"normal": [1, 0, 0], "point": [0, 0, 0]},
        "frames": [1, COUNT - 1],
    }
    files = EditFiles(read(tmp_path, document))
    target = EditTarget.of_animation(
        binding, lambda frame: cages[frame], NAMES, turns, Scene(start=0)
    )
    for rounds in (0, 5):
        edit = LayeredEdit(files, target, PosingSettings(rigidity=rounds))
        edited = edit.apply(np.arange(COUNT), cages)[0]
        np.testing.assert_array_equal(edited[0], cages[0])
        back = edited[1:] @ turns[1:].transpose(0, 2, 1) - binding.cage.vertices
        np.testing.assert_allclose(back, np.broadcast_to(back[0], back.shape), rtol=0, atol=1e-8)
        partners = Mirror([1.0, 0, 0], [0.0, 0, 0]).find_pairs(binding.cage.vertices)
        np.testing.assert_allclose(back[0][partners], back[0] * [-1, 1, 1], rtol=0, atol=1e-8)
        assert np.abs(back).max() > 0.1


def turned_clip(binding, cages):
    """A clip that turns about z, by a quarter in its last frame."""
    angles = np.linspace(0, np.pi / 2, COUNT)
    c, s, zero, one = np.cos(angles), np.sin(angles), 0 * angles, 0 * angles + 1
    turns = np.stack([c, s, zero, -s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
    return turns, cages @ turns


def test_axes_of_the_surface_turn_with_it(binding, cages, tmp_path):
    """An edit of the turned clip is the turned edit; in the axes of the world it is another."""
    still = np.repeat(cages[:1], COUNT, axis=0)
    turns, turned = turned_clip(binding, still)
    frames, target = np.arange(COUNT), animation_of(binding)
    found = {}
    for axes in ("world", "surface"):
        document = moving([0.1, 0.2, 0.05])
        document["handles"][0] |= {"axes": axes}
        edit = LayeredEdit(EditFiles(read(tmp_path, document)), target, PosingSettings())
        found[axes] = [edit.apply(frames, one)[0] for one in (still, turned)]
    np.testing.assert_allclose(found["world"][0], found["surface"][0], rtol=0, atol=1e-9)
    straight, around = found["surface"]
    np.testing.assert_allclose(around, straight @ turns, rtol=0, atol=1e-8)
    assert np.abs(found["world"][1][-1] - straight[-1] @ turns[-1]).max() > 0.05


def test_a_handle_that_stays_keeps_its_place_in_the_world(binding, cages, tmp_path):
    frames = np.arange(COUNT)
    document = {"handles": [{"name": "a", "vertex": 1, "stay": True}], "frames": [1, 4]}
    target = EditTarget.of_animation(
        binding, lambda frame: cages[frame], NAMES, scene=Scene(start=0)
    )
    edit = LayeredEdit(EditFiles(read(tmp_path, document)), target, PosingSettings())
    edited, starts, _ = edit.apply(frames, cages)
    places = target.anchor_positions(edit.anchors, frames, edited)[:, 0]
    np.testing.assert_allclose(places[1:5], np.repeat(starts[1:2, 0], 4, axis=0), atol=1e-5)
    assert np.abs(starts[4] - starts[1]).max() > 1e-2
    np.testing.assert_array_equal(edited[[0, 5]], cages[[0, 5]])


def test_the_rest_is_held_unless_the_file_or_the_settings_say_not(make_edit):
    assert make_edit(moving([0.1, 0, 0])).hold
    assert not make_edit(moving([0.1, 0, 0], hold=False)).hold
    assert not make_edit(moving([0.1, 0, 0]), hold=False).hold


def test_a_radius_of_the_settings_is_for_handles_that_state_none(make_edit):
    document = moving([0.1, 0, 0])
    document["handles"].append({"name": "b", "vertex": 5, "pin": True, "radius": 0.3})
    (layer,) = make_edit(document, radius=0.7).layers
    assert [reach.radius for reach in layer.poser.reaches] == [0.7, 0.3]
    with pytest.raises(SettingError, match="radius"):
        PosingSettings(hold=False, radius=0.7)
    with pytest.raises(HandlesError, match=r"hold: is false, and `radius=`"):
        make_edit(moving([0.1, 0, 0], hold=False), radius=0.7)
