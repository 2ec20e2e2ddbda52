"""Cage edits: what a file may say, how edits add up, and what none of them touches."""

import json
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from cageik_cli.cages.bind import bind
from cageik_cli.editing.cage_edits import (
    CAGE_EDITS_FORMAT,
    CageEditLayer,
    EditFiles,
    parse_cage_edits,
    read_cage_edits,
)
from cageik_cli.editing.edits import EditTarget, LayeredEdit
from cageik_cli.editing.handles.reader import read_schema
from cageik_cli.editing.summary import PoseStatistics
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.timeline import Timeline
from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.errors import FormatError, HandlesError
from tests.editing.handles.files import KEYS, read
from tests.refusals import refused
from tests.shapes import ball, box, moved, octahedron, rotation

COUNT = 12
NAMES = [f"f_{k}" for k in range(COUNT)]


@pytest.fixture(scope="module")
def binding():
    return bind(ball(levels=1, size=0.9), box(2.0), BindSettings("mean-value"))


@pytest.fixture(scope="module")
def cages(binding):
    return binding.cage.vertices * (1 + 0.02 * np.arange(COUNT)[:, None, None])


@pytest.fixture
def clip(binding, cages):
    scene = Scene(start=100, frame_step=2)
    return EditTarget.of_animation(binding, lambda frame: cages[frame], NAMES, scene=scene)


def moving(offset=(0.1, 0.2, 0.3), vertex=3, **others):
    return {"name": "a", "moves": [{"vertex": vertex, "offset": list(offset)}], **others}


def parse(*edits):
    return parse_cage_edits(Path("c.json"), json.dumps({"edits": edits}).encode())


def edit_of(target, *edits, handles=None):
    return LayeredEdit(EditFiles(handles, parse(*edits)), target, PosingSettings())


def apply(edit, cages):
    return edit.apply(np.arange(len(cages)), cages)[0]


def test_the_offset_is_added_where_the_edit_holds(clip, cages):
    """Frames are named by their numbers: 104 is the third."""
    found = apply(edit_of(clip, moving(frames=[104, 108], falloff=4)), cages)
    changed = np.flatnonzero((found != cages).any(axis=(1, 2)))
    assert changed.tolist() == [1, 2, 3, 4, 5]
    moved = (found - cages)[:, 3]
    np.testing.assert_allclose(moved[2:5], np.tile([0.1, 0.2, 0.3], (3, 1)), rtol=0, atol=1e-15)
    np.testing.assert_allclose(moved[[1, 5]], 0.5 * moved[[2, 2]], rtol=0, atol=1e-15)
    others = np.arange(8) != 3
    np.testing.assert_array_equal(found[:, others], cages[:, others])


def test_what_does_not_move_keeps_its_bits(clip, cages):
    """Also the sign of a zero, which 0 + -0 would lose."""
    zeros = np.full_like(cages, -0.0)
    found = apply(edit_of(clip, moving([0, 0.5, 0])), zeros)
    assert np.signbit(found[:, 3, 0]).all()
    assert (found[:, 3, 1] == 0.5).all()


def test_keys_are_those_of_handles(clip, cages):
    keys = {"frames": [104, 110, 118], "values": KEYS["values"]}
    document = {"name": "a", "moves": [{"vertex": 3, "offset": keys}]}
    moved = (apply(edit_of(clip, document), cages) - cages)[:, 3]
    np.testing.assert_allclose(moved[[0, 2]], np.tile(KEYS["values"][0], (2, 1)), atol=1e-14)
    np.testing.assert_allclose(moved[5], KEYS["values"][1], atol=1e-14)
    np.testing.assert_allclose(moved[9:], np.tile(KEYS["values"][2], (3, 1)), atol=1e-14)


def test_edits_add_up_in_any_order(clip, cages):
    first, second = moving([0.25, 0, 0]), moving([0.5, 1, 0], name="b", frames=[102, 104])
    found = apply(edit_of(clip, first, second), cages)
    np.testing.assert_allclose(found, apply(edit_of(clip, second, first), cages), atol=1e-15)
    np.testing.assert_allclose((found - cages)[1, 3], [0.75, 1, 0], atol=1e-15)


def test_handles_act_after_cage_edits(tmp_path, clip, cages):
    """A pin holds a point where the cage edit has put it."""
    pin = {"handles": [{"name": "p", "vertex": 1, "pin": True, "hard": True}]}
    both = edit_of(clip, moving(), handles=read(tmp_path, pin))
    np.testing.assert_allclose(
        apply(both, cages), apply(edit_of(clip, moving()), cages), rtol=0, atol=1e-12
    )
    target = {"handles": [{"name": "p", "vertex": 1, "target": [0, 0, 0], "hard": True}]}
    block = edit_of(clip, moving(), handles=read(tmp_path, target)).edit_frames(
        np.arange(COUNT), cages
    )
    np.testing.assert_allclose(block.anchors_after, 0, atol=1e-9)


def test_a_model_is_moved(binding):
    target = EditTarget.of_model(binding)
    cage = binding.cage.vertices
    found = apply(edit_of(target, moving()), cage[None])[0]
    np.testing.assert_allclose((found - cage)[3], [0.1, 0.2, 0.3], atol=1e-15)
    for wrong in (moving(frames=[1, 2]), moving_by_keys([1], [[0, 0, 0]])):
        with refused(HandlesError, "not possible for a single pose"):
            edit_of(target, wrong)


def moving_by_keys(frames, values):
    return {"name": "a", "moves": [{"vertex": 3, "offset": {"frames": frames, "values": values}}]}


def test_statistics_tell_how_far_each_edit_moves(clip, cages):
    edit = edit_of(clip, moving([3, 4, 0], frames=[104, 104]), moving([0, 0, 0], name="still"))
    statistics = PoseStatistics(edit)
    statistics.update(edit.edit_frames(np.arange(COUNT), cages))
    summary = statistics.summarize()
    first, second = summary.cage_edits
    assert (first.name, first.vertices, first.vertex, first.frame) == ("a", 1, 3, "f_2")
    assert first.moved == pytest.approx(5)
    assert (second.name, second.moved) == ("still", 0)
    assert (summary.changed, summary.condition_number) == (("f_2", "f_2"), None)
    assert summary.anchors == ()


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        (moving(vertex=8), "edit 'a': vertex 8: there is no such cage vertex; the cage has 8"),
        (moving(frames=[101, 104]), "edit 'a': frames: "),
        (moving(frames=[104, 200]), "edit 'a': frames: "),
        (moving_by_keys([103], [[0, 0, 0]]), "edit 'a': vertex 3: offset: "),
    ],
)
def test_what_the_cage_or_the_clip_lacks_is_named(clip, edit, told):
    with refused(HandlesError, told):
        edit_of(clip, edit)


def test_a_vertex_that_goes_too_far_is_named(clip, cages):
    edit = edit_of(clip, moving([1e50, 0, 0]), moving([1e50, 0, 0], name="b", frames=[104, 104]))
    with refused(HandlesError, "c.json: edit 'b': vertex 3: frame 104: is moved too far away"):
        apply(edit, cages)


GOOD = {
    "an offset": [moving()],
    "keys": [moving_by_keys([1, 2], [[0, 0, 0], [1, 0, 0]])],
    "frames": [moving(frames=[1, 1], falloff=3)],
    "extremes": [moving([1e50, -1e50, 0], vertex=10**9, name="n" * 100)],
}

BAD = {
    "no edits": ({"edits": []}, "edits: is an empty list, expected a list of edits, at least one"),
    "no list": ({"edits": 1}, "edits: is 1, expected a list of edits"),
    "another field": ({"edit": []}, '"edit" is not a field of a cage edits file; did you mean'),
    "handles": ({"handles": []}, '"handles" is not a field of a cage edits file'),
    "no name": ({"edits": [{"moves": moving()["moves"]}]}, "edits[0]: has no name, which an"),
    "no moves": ({"edits": [moving() | {"moves": []}]}, "edit 'a': moves: is an empty list"),
    "no offset": ({"edits": [{"name": "a", "moves": [{"vertex": 1}]}]},
                  "edit 'a': moves[0]: has no offset, which a move needs"),
    "no vertex": ({"edits": [moving(vertex=-1)]}, "moves[0]: vertex: is -1, expected a whole"),
    "two numbers": ({"edits": [moving([1, 2])]}, "offset: is a list of 2, expected 3 numbers"),
    "a text": ({"edits": [moving(["1", 2, 3])]}, 'offset[0]: is "1", expected a number'),
    "too large": ({"edits": [moving([1e51, 2, 3])]}, "offset[0]: is 1e+51, expected a number"),
    "true": ({"edits": [moving([True, 2, 3])]}, "offset[0]: is true, expected a number"),
    "one frame": ({"edits": [moving(frames=[1])]}, "edit 'a': frames: is a list of 1, expected"),
    "backward": ({"edits": [moving(frames=[3, 1])]}, "edit 'a': frames: the last, 1, is before"),
    "falloff alone": ({"edits": [moving(falloff=3)]}, "edit 'a': has falloff without frames"),
    "no keys": ({"edits": [moving_by_keys([], [])]}, "offset.frames: is an empty list"),
    "fewer values": ({"edits": [moving_by_keys([1, 2], [[0, 0, 0]])]},
                     "edit 'a': vertex 3: offset: has 2 frames and 1 values"),
    "keys backward": ({"edits": [moving_by_keys([2, 1], [[0, 0, 0]] * 2)]},
                      "offset: has frame 1 after frame 2"),
    "a vertex twice": ({"edits": [{"name": "a", "moves": 2 * moving()["moves"]}]},
                       "edit 'a': vertex 3: is moved twice"),
    "a name twice": ({"edits": [moving(), moving()]}, "two edits are named 'a'"),
    "a name of escapes": ({"edits": [moving(name="a\x1b")]}, "cannot be displayed"),
}  # fmt: skip


@pytest.mark.parametrize("edits", GOOD.values(), ids=GOOD)
def test_valid_files_pass(edits):
    assert len(parse(*edits).edits) == len(edits)
    schema = json.loads(read_schema("cage_edits"))
    Draft202012Validator.check_schema(schema)
    assert Draft202012Validator(schema).is_valid({"edits": edits})


@pytest.mark.parametrize(("document", "told"), BAD.values(), ids=BAD)
def test_wrong_files_are_refused(document, told):
    with refused(HandlesError, told):
        parse_cage_edits(Path("c.json"), json.dumps(document).encode())


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b'{"edits": [{"name": "a", "moves": [{"vertex": 1, "offset": [0, NaN, 0]}]}]}',
         "edit 'a': moves[0]: offset[1]: is NaN, expected a finite number"),
        (b"{", "is not JSON"),
        (b'{"edits": [], "edits": []}', '"edits" twice'),
        (b"[" * 99_999, "levels deep; give a cage edits file"),
    ],
)  # fmt: skip
def test_what_is_no_json_is_refused(tmp_path, data, told):
    path = tmp_path / "c.json"
    path.write_bytes(data)
    with refused(FormatError, told):
        read_cage_edits(path)


def test_a_file_that_is_too_large_is_not_read(tmp_path):
    path = tmp_path / "c.json"
    path.write_bytes(b" " * (CAGE_EDITS_FORMAT.max_bytes + 1))
    with pytest.raises(Exception, match="a cage edits file"):
        read_cage_edits(path)


def test_a_layer_of_one_pose_ignores_the_number_of_its_frame():
    (edit,) = parse(moving()).edits
    moves = CageEditLayer(edit, box(2.0), None).displacements(np.zeros(1, int))
    np.testing.assert_allclose(moves, [[[0.1, 0.2, 0.3]]])
    moves = CageEditLayer(edit, box(2.0), Timeline(3, 7)).displacements(np.arange(3))
    assert moves.shape == (3, 1, 3)


def mirrored(target, *edits, handles=None):
    return LayeredEdit(EditFiles(handles, parse(*edits)), target, PosingSettings(mirror=True))


def test_the_partner_of_a_vertex_moves_as_its_mirror_image(binding, cages, clip):
    """Of the box, 3 and 7 are partners across x."""
    edit = mirrored(clip, moving())
    assert str(edit.mirror) == "the plane x = 0"
    moved = apply(edit, cages) - cages
    np.testing.assert_allclose(moved[:, 3], np.tile([0.1, 0.2, 0.3], (COUNT, 1)), atol=1e-15)
    np.testing.assert_allclose(moved[:, 7], np.tile([-0.1, 0.2, 0.3], (COUNT, 1)), atol=1e-15)
    assert not np.delete(moved, [3, 7], axis=1).any()


def test_what_a_file_says_of_both_sides_holds(cages, clip):
    edit = moving()
    edit["moves"].append({"vertex": 7, "offset": [0.0, 0, 1]})
    np.testing.assert_array_equal(
        apply(mirrored(clip, edit), cages), apply(edit_of(clip, edit), cages)
    )


def test_the_mirror_turns_with_each_frame(binding):
    """An edit of a turned clip is the turned edit."""
    turn = np.stack([rotation(seed) for seed in range(COUNT)])
    turned = EditTarget.of_animation(
        binding, lambda frame: binding.cage.vertices @ turn[frame], NAMES, turn, Scene(start=0)
    )
    cages = binding.cage.vertices @ turn
    offset = np.array([0.1, 0.2, 0.3])
    values = (offset @ turn).tolist()
    key = {"frames": list(range(COUNT)), "values": values}
    edit = {"name": "a", "moves": [{"vertex": 3, "offset": key}]}
    moved = apply(mirrored(turned, edit), cages) - cages
    np.testing.assert_allclose(moved[:, 7], offset * [-1, 1, 1] @ turn, rtol=0, atol=1e-14)


def test_a_vertex_of_the_plane_stays_on_it():
    """An octahedron has four of them across x; they keep their height."""
    cage = moved(octahedron(3.0), (0.5, 0, 0))
    binding = bind(ball(levels=1), cage, BindSettings("mean-value"))
    edit = mirrored(EditTarget.of_model(binding), moving(vertex=2))
    change = apply(edit, cage.vertices[None]) - cage.vertices
    np.testing.assert_allclose(change[0, 2], [0, 0.2, 0.3], rtol=0, atol=1e-15)
    assert np.count_nonzero(change.any(axis=2)) == 1


def test_handles_are_mirrored_too_unless_their_file_states_a_plane(clip, tmp_path):
    point = {"name": "a", "vertex": 1, "offset": [0.0, 0, 0.1]}
    files = [
        {"handles": [point]},
        {"handles": [point], "mirror": {"normal": [0, 1, 0], "point": [0, 0, 0]}},
    ]
    normals = []
    for document in files:
        edit = LayeredEdit(EditFiles(read(tmp_path, document)), clip, PosingSettings(mirror=True))
        normals.append(edit.layers[0].poser.constraints.mirror.normal.tolist())
    assert normals == [[1, 0, 0], [0, 1, 0]]


def test_a_cage_that_is_not_its_own_mirror_image_mirrors_nothing(binding):
    bent = binding.cage.vertices + 0.3 * np.random.default_rng(0).random((8, 3))
    other = bind(binding.rest, binding.cage.move(bent), BindSettings("mean-value"))
    with pytest.raises(HandlesError, match="not its own mirror image"):
        mirrored(EditTarget.of_model(other), moving())


def test_moves_in_the_axes_of_the_surface_turn_with_the_cage(binding, cages):
    """Also those of partners across a mirror."""
    turn = rotation(4)
    turned = cages @ turn
    for mirror in (False, True):
        found = []
        for axes, of in (("surface", cages), ("surface", turned), ("world", turned)):
            target = EditTarget.of_animation(
                binding, lambda frame, of=of: of[frame], NAMES,
                np.repeat((turn if of is turned else np.eye(3))[None], COUNT, axis=0),
            )  # fmt: skip
            files = EditFiles(None, parse(moving(axes=axes)))
            edit = LayeredEdit(files, target, PosingSettings(mirror=mirror))
            found.append(edit.apply(np.arange(COUNT), of)[0])
        straight, around, world = found
        np.testing.assert_allclose(around, straight @ turn, rtol=0, atol=1e-9)
        assert np.abs(world - around).max() > 0.05
