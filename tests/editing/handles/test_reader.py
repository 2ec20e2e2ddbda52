import copy
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cageik_cli.editing.handles.placement import place_handles
from cageik_cli.editing.handles.reader import read_handles
from cageik_cli.method.pose.camera import Camera
from cageik_cli.util.errors import CageikError, InputError
from tests.editing.handles.files import CAMERA, CLIP, HAND, KEYS, STILL, read, read_set
from tests.method.pose.test_camera import stand
from tests.refusals import refused

EYE = np.eye(4).tolist()
MATRICES = {"view": EYE, "projection": EYE, "width": 640, "height": 480}
SCREEN = {"name": "nose", "screen": {"source": [1, 2], "target": [3, 4]}}


def test_handles_have_the_values_of_the_file(tmp_path):
    found = read_set(
        tmp_path,
        HAND | {"weight": 2, "hard": True, "radius": 3},
        {"name": "knee", "face": 3, "barycentric": [0.2, 0.3, 0.5], "offset": KEYS, "radius": 0.5},
        {"name": "foot", "position": [1, 2, 3], "pin": True},
        SCREEN | {"radius": 1},
        {"name": "ear", "screen": {"source": [1, 2], "offset": [3, 4]}, "radius": 1},
        frames=[3, 8],
        falloff=2,
        pick_frame=1,
    )
    assert (found.frames, found.falloff, found.pick_frame) == ((3, 8), 2, 1)
    hand, knee, foot, nose, ear = found.handles
    assert (hand.name, hand.weight, hand.hard) == ("hand", 2.0, True)
    assert [one.radius for one in found.handles] == [3, 0.5, None, 1, 1]
    assert (hand.place.kind, hand.place.number) == ("vertex", 7)
    assert hand.motion.kind == "target"
    np.testing.assert_array_equal(hand.motion.values, [[1, 2, 3]])
    assert (knee.weight, knee.hard) == (1.0, False)
    assert (knee.place.kind, knee.place.number) == ("face", 3)
    np.testing.assert_array_equal(knee.place.values, [0.2, 0.3, 0.5])
    assert knee.motion.kind == "offset"
    np.testing.assert_array_equal(knee.motion.frames, KEYS["frames"])
    np.testing.assert_array_equal(knee.motion.values, KEYS["values"])
    assert foot.place.kind == "position"
    np.testing.assert_array_equal(foot.place.values, [1, 2, 3])
    assert (foot.motion.kind, foot.motion.values) == ("pin", None)
    assert nose.place.kind == ear.place.kind == "screen.source"
    assert (nose.motion.kind, ear.motion.kind) == ("screen.target", "screen.offset")
    np.testing.assert_array_equal(ear.place.values, [1, 2])
    np.testing.assert_array_equal(ear.motion.values, [[3, 4]])
    assert nose.place.camera is ear.motion.camera is nose.motion.camera is ear.place.camera


def test_missing_fields_have_defaults(tmp_path):
    found = read(tmp_path, {"handles": [HAND]})
    (only,) = found.sets
    assert (only.frames, only.falloff, only.pick_frame) == (None, 0, None)
    assert (found.constraints.locked, found.constraints.mirror) == ((), None)


def test_constraints_are_read(tmp_path):
    mirror = {"normal": [0, 2, 0], "point": [1, 2, 3]}
    found = read(tmp_path, {"handles": [HAND], "locked": [4, 0], "mirror": mirror}).constraints
    assert found.locked == (4, 0)
    np.testing.assert_array_equal(found.mirror.normal, [0, 1, 0])
    np.testing.assert_array_equal(found.mirror.point, [1, 2, 3])


def test_cameras_are_read(tmp_path):
    stance = (np.array(CAMERA[name], float) for name in ("position", "look_at", "up"))
    standing = stand(*stance, width=640, height=480)
    for said, camera in ((CAMERA, standing), (MATRICES, Camera(np.eye(4), np.eye(4), 640, 480))):
        (seen,) = read(tmp_path, {"handles": [SCREEN], "camera": said}).sets[0].handles
        found = seen.place.camera
        np.testing.assert_array_equal(found.view, camera.view)
        np.testing.assert_array_equal(found.projection, camera.projection)
        assert (found.width, found.height) == (640, 480)


def test_sets_share_the_camera_of_the_file(tmp_path):
    sets = [
        {"handles": [SCREEN], "frames": [0, 1]},
        {"handles": [SCREEN], "camera": MATRICES},
        {"handles": [SCREEN]},
    ]
    found = read(tmp_path, {"sets": sets, "camera": CAMERA}).sets
    assert found[0].frames == (0, 1)
    first, second, third = (one.handles[0].place.camera for one in found)
    assert first is third
    np.testing.assert_array_equal(second.view, np.eye(4))


SINGULAR = [[1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
TINY = np.diag([1e-160] * 3 + [1]).tolist()
OF_ROWS = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 5, 1]]

REFUSED = {
    "frames the wrong way": (
        {"handles": [HAND], "frames": [5, 4]},
        "frames: the last, 4, is before the first, 5",
    ),
    "a name twice": ({"handles": [HAND, HAND]}, "two handles are named 'hand'"),
    "a name twice in a set": (
        {"sets": [{"handles": [HAND]}, {"handles": [HAND, HAND]}]},
        "sets[1]: two handles are named 'hand'",
    ),
    "a name that cannot be shown": (
        {"handles": [HAND | {"name": "a\nb\ud800"}]},
        "handle 'a\\nb\\ud800': name ",
    ),
    "a radius without a hold": (
        {"handles": [HAND | {"radius": 1}], "hold": False},
        "handle 'hand': radius: needs `hold`, which is false; remove one of them",
    ),
    "no camera": ({"handles": [SCREEN]}, "handle 'nose': screen: there is no camera"),
    "a camera of another set": (
        {"sets": [{"handles": [HAND], "camera": CAMERA}, {"handles": [SCREEN]}]},
        "sets[1]: handle 'nose': screen: there is no camera",
    ),
    "a singular matrix": (
        {"handles": [HAND], "camera": MATRICES | {"view": SINGULAR}},
        "camera: view is singular",
    ),
    "a field of view that is nearly none": (
        {"handles": [HAND], "camera": CAMERA | {"fov_degrees": 5e-324}},
        "camera: ",
    ),
    "matrices of rows": (
        {"sets": [{"handles": [HAND], "camera": MATRICES | {"view": OF_ROWS}}]},
        "sets[0]: camera: the last row of view is 0, 0, 5, 1, expected 0, 0, 0, 1",
    ),
    "numbers that vanish": (
        {"handles": [HAND], "camera": MATRICES | {"view": TINY, "projection": TINY}},
        "camera: view times projection",
    ),
    "a camera that looks nowhere": (
        {"handles": [HAND], "camera": CAMERA | {"look_at": CAMERA["position"]}},
        "camera: position and look_at are the same point",
    ),
    "a mirror without a direction": (
        {"handles": [HAND], "mirror": {"normal": [0, 0, 0], "point": [0, 0, 0]}},
        "mirror: normal is [0.0, 0.0, 0.0]",
    ),
    "fewer values than keys": (
        {"handles": [HAND | {"target": {"frames": [1, 2], "values": [[1, 2, 3]]}}]},
        "handle 'hand': target: has 2 frames and 1 values",
    ),
    "keys the wrong way": (
        {"handles": [HAND | {"target": KEYS | {"frames": [2, 9, 9]}}]},
        "handle 'hand': target: has frame 9 after frame 9",
    ),
    "keys of pixels the wrong way": (
        {
            "handles": [
                {
                    "name": "nose",
                    "screen": {
                        "source": [0, 0],
                        "offset": {"frames": [2, 1], "values": [[1, 2], [1, 2]]},
                    },
                }
            ],
            "camera": CAMERA,
        },
        "handle 'nose': screen: offset: has frame 1 after frame 2",
    ),
    "what the schema refuses": ({"handles": []}, "handles: is an empty list"),
}


@pytest.mark.parametrize(("document", "said"), REFUSED.values(), ids=REFUSED)
def test_refused(tmp_path, document, said):
    with refused(InputError, said, at=tmp_path / "drag.json"):
        read(tmp_path, document)


def test_a_missing_file_is_refused(tmp_path):
    with refused(InputError, "no such file", at=tmp_path / "none.json"):
        read_handles(tmp_path / "none.json")


NUMBERS = st.one_of(
    st.integers(-3, 20),
    st.integers(),
    st.floats(-10, 10),
    st.floats(),
    st.sampled_from([1e50, -1e50, 5e-324, 1e-200, 1e9]),
)
ANYTHING = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=12,
)
WHOLE = {
    "sets": [
        {
            "handles": [
                HAND,
                {"name": "near", "position": [0, 0, 3], "offset": KEYS},
                {"name": "knee", "face": 3, "barycentric": [0.2, 0.3, 0.5], "pin": True},
                SCREEN | {"screen": {"source": [320, 240], "target": [300, 200]}},
                {"name": "ear", "screen": {"source": [330, 250], "offset": [3, 4]}, "weight": 2},
            ],
            "frames": [3, 8],
            "falloff": 2,
            "pick_frame": 1,
        },
        {"handles": [HAND], "camera": MATRICES},
    ],
    "camera": CAMERA,
    "locked": [1],
    "mirror": {"normal": [1, 0, 0], "point": [0, 0, 0]},
}


def steps_of(value, before=()):
    """The steps to every value in a document."""
    inner = value.items() if isinstance(value, dict) else ()
    inner = enumerate(value) if isinstance(value, list) else inner
    return [before] + [path for step, one in inner for path in steps_of(one, (*before, step))]


@st.composite
def altered(draw):
    """A good document in which a few values are something else, or not there."""
    document = {"in": copy.deepcopy(WHOLE)}
    for _ in range(draw(st.integers(1, 3))):
        *way, last = draw(st.sampled_from(steps_of(document)[1:]))
        place = document
        for step in way:
            place = place[step]
        if draw(st.booleans()) and len(way) > 0:
            del place[last]
        else:
            place[last] = draw(st.one_of(NUMBERS, ANYTHING))
    return document["in"]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz") / "drag.json"


def faults_of(path):
    """What is said when a file is read, placed and moved, by whatever is refused of it."""
    try:
        handles = read_handles(path)
    except InputError as error:
        return [str(error).removeprefix(f"{path}: ")]
    faults = []
    for one in handles.sets:
        for surface in (CLIP, STILL):
            try:
                drag = place_handles(one, surface, snap=100, allow_conflicts=True)
                frames = np.arange(drag.affected_frames.start, drag.affected_frames.stop)
                positions = np.zeros((len(frames), len(drag.anchors), 3))
                assert np.isfinite(drag.displacements(frames, positions)).all()
            except CageikError as error:
                faults.append(str(error))
    return faults


def is_sentence(text):
    """On one line, with words, and none of a library's or of Python's own."""
    words = ("Traceback", "Error(", "<class", "None is not", "jsonschema")
    return len(text) > 10 and "\n" not in text and not any(word in text for word in words)


@pytest.mark.slow
@given(document=ANYTHING)
def test_any_json_is_read_or_refused(path, document):
    path.write_text(json.dumps(document))
    assert all(map(is_sentence, faults_of(path)))


@settings(max_examples=25)
@given(document=altered())
def test_any_mistake_is_refused_in_a_sentence(path, document):
    path.write_text(json.dumps(document))
    assert all(map(is_sentence, faults_of(path)))


@settings(max_examples=25)
@given(content=st.binary())
def test_any_bytes_are_refused_in_a_sentence(path, content):
    path.write_bytes(content)
    (fault,) = faults_of(path)  # no bytes at random are a handles file
    assert is_sentence(fault)


def test_other_texts_are_no_sentences():
    for text in ("", "two\nlines of it", "ValidationError('x') is wrong", "Traceback (most recent"):
        assert not is_sentence(text)


def test_the_whole_document_passes(tmp_path):
    """So that the mistakes are the mistakes."""
    first, second = read(tmp_path, WHOLE).sets
    assert place_handles(first, CLIP, snap=100).affected_frames == range(2, 10)
    assert place_handles(second, CLIP).full_strength == range(12)
