"""The schema, and the messages on what it refuses."""

import json
from importlib.resources import files

import pytest
from jsonschema import Draft202012Validator

from cageik_cli.editing.handles.reader import check_schema, read_schema
from cageik_cli.util.errors import HandlesError
from tests.editing.handles.files import CAMERA, HAND, KEYS
from tests.refusals import refused

EYE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
MATRICES = {"view": EYE, "projection": EYE, "width": 640, "height": 480}
FACE = {"name": "knee", "face": 3, "barycentric": [0.2, 0.3, 0.5], "offset": [0, 1, 0]}
NOSE = {"name": "nose", "screen": {"source": [1, 2], "target": [3, 4.5]}}


def with_one(without=(), **fields):
    """A file of one handle, changed."""
    return {"handles": [{k: v for k, v in (HAND | fields).items() if k not in without}]}


def on_screen(**fields):
    return {"handles": [{"name": "nose", "screen": fields}]}


GOOD = {
    "a target": with_one(),
    "an offset": with_one(["target"], offset=[1, 2, 3]),
    "a pin": with_one(["target"], pin=True),
    "a face": {"handles": [FACE]},
    "a position": with_one(["vertex"], position=[0, 0.5, 1e50]),
    "a screen": {"handles": [NOSE], "camera": CAMERA},
    "a screen offset": on_screen(source=[1, 2], offset=[-1, 2]),
    "keyframes": with_one(target=KEYS),
    "keys of pixels": on_screen(source=[0, 0], target={"frames": [1], "values": [[2, 3]]}),
    "extremes": with_one(weight=1e-12, hard=True, vertex=10**9, name="n" * 100),
    "a weight": with_one(weight=1e12, hard=False),
    "a whole number with a point": with_one(vertex=7.0),
    "frames": with_one() | {"frames": [3, 3], "falloff": 0, "pick_frame": 0},
    "matrices": with_one() | {"camera": MATRICES},
    "ties": with_one() | {"locked": [0, 3], "mirror": {"normal": [1, 0, 0], "point": [0, 0, 0]}},
    "a schema": with_one() | {"$schema": "handles.schema.json"},
    "sets": {"$schema": "", "sets": [with_one(), {"handles": [HAND], "camera": CAMERA}]},
}

BAD = {
    "a list": ([], "is an empty list, expected a handles file"),
    "nothing in it": ({}, "has no handles, which a handles file without sets needs; add it"),
    "no handles": ({"handles": []}, "handles: is an empty list, expected a list of handles, at"),
    "no sets": ({"sets": []}, "sets: is an empty list, expected a list of sets, at least one"),
    "a set of nothing": ({"sets": [{}]}, "sets[0]: has no handles, which a set of handles needs"),
    "an empty set": ({"sets": [with_one(), {"handles": []}]}, "sets[1]: handles: is an empty"),
    "sets and handles": (
        {"sets": [with_one()], "handles": [HAND]},
        '"handles" is not a field of a handles file with sets; expected one of $schema, sets',
    ),
    "frames beside sets": ({"sets": [with_one()], "frames": [1, 2]}, '"frames" is not a field of'),
    "sets in sets": ({"sets": [{"sets": []}]}, 'sets[0]: "sets" is not a field of a set of'),
    "ties of a set": ({"sets": [with_one() | {"locked": []}]}, 'sets[0]: "locked" is not a field'),
    "a name of a set": (
        {"sets": [with_one() | {"name": "wave"}]},
        'sets[0]: "name" is not a field of a set of handles; expected one of handles, camera,',
    ),
    "a handle that is none": ({"handles": [3]}, "handles[0]: is 3, expected a handle"),
    "no name": (with_one(["name"]), "handles[0]: has no name, which a handle needs; add it"),
    "an empty name": (with_one(name=""), 'handles[0]: name: is "", expected a string of 1 to 100'),
    "a long name": (with_one(name="n" * 101), "expected a string of 1 to 100 characters"),
    "a misspelt field": (
        {"handles": [{"name": "knee", "face": 4, "barycentic": [1, 0, 0], "pin": True}]},
        "handle 'knee': \"barycentic\" is not a field of a handle; did you mean barycentric?",
    ),
    "an unknown field": (
        with_one(colour="red"),
        "handle 'hand': \"colour\" is not a field of a handle; expected one of name, vertex,",
    ),
    "no place": (
        with_one(["vertex"]),
        "handle 'hand': has no place; expected exactly one of vertex, face, position, screen",
    ),
    "two places": (
        with_one(position=[0, 0, 0]),
        "handle 'hand': has 2 places, vertex and position; keep one of them",
    ),
    "no motion": (with_one(["target"]), "handle 'hand': has no motion; expected exactly one of"),
    "two motions": (
        with_one(offset=[0, 0, 0], pin=True),
        "has 3 motions, target and offset and pin",
    ),
    "a screen handle moved in space": (
        {"handles": [NOSE | {"pin": True}]},
        "handle 'nose': has 2 motions, pin and screen; keep one of them",
    ),
    "a screen handle that stays": (on_screen(source=[1, 2]), "screen: has no motion; expected"),
    "a screen handle moved twice": (
        on_screen(source=[1, 2], target=[1, 2], offset=[1, 2]),
        "handle 'nose': screen: has 2 motions, target and offset",
    ),
    "a screen handle of nowhere": (on_screen(target=[1, 2]), "screen: has no source, which"),
    "a face alone": (
        with_one(["vertex"], face=1),
        "handle 'hand': has face without barycentric; add it, or remove face",
    ),
    "barycentric alone": (with_one(barycentric=[1, 0, 0]), "has barycentric without face; add"),
    "a falloff alone": (with_one() | {"falloff": 2}, "has falloff without frames; add it"),
    "a negative vertex": (with_one(vertex=-1), "handle 'hand': vertex: is -1, expected a whole"),
    "half a vertex": (with_one(vertex=1.5), "vertex: is 1.5, expected a whole number"),
    "a vertex of truth": (with_one(vertex=True), "vertex: is true, expected a whole number"),
    "a huge vertex": (with_one(vertex=10**400), "vertex: is 100000"),
    "two coordinates": (
        with_one(target=[1, 2]),
        "handle 'hand': target: is a list of 2, expected 3 numbers, or keyframes",
    ),
    "a word for a target": (with_one(target="up"), 'target: is "up", expected 3 numbers, or'),
    "a word in a target": (with_one(target=[1, "x", 2]), "handle 'hand': target[1]: is \"x\","),
    "a target of truth": (with_one(target=[1, True, 2]), "target[1]: is true, expected a number"),
    "a far target": (with_one(target=[1, 2, 2e50]), "target[2]: is 2e+50, expected a number"),
    "no shares": ({"handles": [FACE | {"barycentric": [0.5, 0.5]}]}, "barycentric: is a list of 2"),
    "a far pixel": (
        on_screen(source=[1, -2e9], target=[1, 2]),
        "screen.source[1]: is -2000000000.0",
    ),
    "a point for a pixel": (
        on_screen(source=[1, 2], target=[1, 2, 3]),
        "handle 'nose': screen.target: is a list of 3, expected 2 numbers of pixels, or keyframes",
    ),
    "keys without frames": (with_one(target={"values": []}), "target: has no frames, which"),
    "no keys": (with_one(offset={"frames": [], "values": []}), "offset.frames: is an empty list"),
    "a key of two numbers": (
        with_one(target={"frames": [1], "values": [[1, 2]]}),
        "handle 'hand': target.values[0]: is a list of 2, expected 3 numbers",
    ),
    "no pin": (with_one(pin=False), "handle 'hand': pin: is false, expected true"),
    "no weight": (with_one(weight=0), "handle 'hand': weight: is 0, expected a number from 1e-12"),
    "a heavy handle": (with_one(weight=1e13), "weight: is 10000000000000.0, expected a number"),
    "a hard word": (with_one(hard="yes"), "handle 'hand': hard: is \"yes\", expected true or"),
    "no radius": (with_one(radius=0), "handle 'hand': radius: is 0, expected a number above 0"),
    "a negative radius": (with_one(radius=-1), "radius: is -1, expected a number above 0"),
    "a far radius": (with_one(radius=2e50), "radius: is 2e+50, expected a number above 0, up to"),
    "a word for a radius": (with_one(radius="1 m"), 'radius: is "1 m", expected a number above 0'),
    "one frame": (with_one() | {"frames": [1]}, "frames: is a list of 1, expected two frames"),
    "a word for a frame": (
        with_one() | {"frames": ["1", 2]},
        'frames[0]: is "1", expected the number of a frame',
    ),
    "a falloff of halves": (
        with_one() | {"frames": [1, 2], "falloff": 0.5},
        "falloff: is 0.5, expected a whole number from 0",
    ),
    "a camera that is none": (with_one() | {"camera": 3}, "camera: is 3, expected a camera"),
    "half a camera": (
        with_one() | {"camera": {"view": EYE, "width": 1, "height": 1}},
        "camera: has no projection, which a camera with matrices needs; add it",
    ),
    "a camera without direction": (
        with_one() | {"camera": {k: v for k, v in CAMERA.items() if k != "up"}},
        "camera: has no up, which a camera with a position needs; add it",
    ),
    "two cameras in one": (
        with_one() | {"camera": MATRICES | {"up": [0, 1, 0]}},
        'camera: "up" is not a field of a camera with matrices',
    ),
    "three rows": (
        with_one() | {"camera": MATRICES | {"view": EYE[:3]}},
        "camera.view: is a list of 3, expected 4 rows of 4 numbers",
    ),
    "a short row": (
        with_one() | {"camera": MATRICES | {"view": [*EYE[:3], [0, 0, 1]]}},
        "camera.view[3]: is a list of 3, expected a row of 4 numbers",
    ),
    "no picture": (
        with_one() | {"camera": MATRICES | {"width": 0}},
        "camera.width: is 0, expected a number of pixels above 0",
    ),
    "a flat view": (
        with_one() | {"camera": CAMERA | {"fov_degrees": 180}},
        "camera.fov_degrees: is 180, expected a number above 0 and below 180",
    ),
    "a lock on nothing": (with_one() | {"locked": [-1]}, "locked[0]: is -1, expected a whole"),
    "a mirror without a place": (
        with_one() | {"mirror": {"normal": [1, 0, 0]}},
        "mirror: has no point, which a mirror needs; add it",
    ),
    "a number for a schema": (with_one() | {"$schema": 1}, '"$schema": is 1, expected a string'),
}


def test_the_packaged_schema_is_valid():
    schema = json.loads(read_schema())
    Draft202012Validator.check_schema(schema)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert files("cageik_cli.editing.handles").joinpath("schema.json").is_file()


def test_every_field_is_described():
    """An editor shows it, of the field itself or of what it refers to."""
    defined = json.loads(read_schema())["$defs"]
    for title, record in defined.items():
        for name, field in record.get("properties", {}).items():
            meant = defined[field["$ref"].split("/")[-1]] if "$ref" in field else {}
            assert "description" in field or "description" in meant, (title, name)


@pytest.mark.parametrize("document", GOOD.values(), ids=GOOD)
def test_valid_documents_pass(document):
    assert check_schema(document) is None
    assert Draft202012Validator(json.loads(read_schema())).is_valid(document)


@pytest.mark.parametrize(("document", "said"), BAD.values(), ids=BAD)
def test_invalid_documents_are_refused(document, said):
    with refused(HandlesError, said):
        check_schema(document)


def test_the_first_fault_in_the_file_is_reported():
    document = {"handles": [HAND | {"vertex": "a", "weight": "b"}, HAND | {"vertex": "c"}]}
    for said in ("handle 'hand': vertex: is \"a\"", 'weight: is "b"', 'vertex: is "c"'):
        with refused(HandlesError, said):
            check_schema(document)
        first = next(one for one in document["handles"] if any(map(is_letter, one.values())))
        first[next(key for key, value in first.items() if is_letter(value))] = 1


def is_letter(value):
    return isinstance(value, str) and len(value) == 1


def test_a_misspelt_field_is_reported_before_the_missing_one():
    with pytest.raises(HandlesError, match="did you mean target"):
        check_schema(with_one(["target"], targt=[1, 2, 3]))
