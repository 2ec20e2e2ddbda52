import os

import pytest

from cageik_cli.posing.handles.json_document import (
    MAX_BYTES,
    MAX_DEPTH,
    describe_location,
    format_value,
    read_document,
)
from cageik_cli.util.errors import InputError


@pytest.fixture
def path(tmp_path):
    return tmp_path / "drag.json"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ('{"a": [1, 2.5, true, null, "x"]}', {"a": [1, 2.5, True, None, "x"]}),
        ("\ufeff{}", {}),
        ('{"ä": "\\u00e4"}', {"ä": "ä"}),
        ("[" * MAX_DEPTH + "]" * MAX_DEPTH, None),
        ("[]" + " " * (MAX_BYTES - 2), []),
    ],
    ids=["values", "mark", "letters", "deep", "long"],
)
def test_json_is_read(path, text, value):
    path.write_text(text, encoding="utf-8")
    found = read_document(path)
    assert value is None or found == value


FAULTS = {
    "not JSON": (b'{"a": 1,}', "is not JSON at line 1, column 9; check commas"),
    "a comment": (b"{\n  // no\n}", "is not JSON at line 2, column 3"),
    "empty": (b"", "is not JSON at line 1, column 1"),
    "not UTF-8": (b'{"a": "\xff"}', "is not UTF-8 text at byte 7; save it as UTF-8"),
    "too large": (b"[]" + b" " * (MAX_BYTES - 1), "is of 2 MB, more than the 2 MB that are read"),
    "deep": (b"[" * (MAX_DEPTH + 2) + b"]" * (MAX_DEPTH + 2), "nested too deeply"),
    "too deep for Python": (b"[" * 100_000, "nested too deeply"),
    "digits": (b"9" * 5000, "a number of thousands of digits"),
    "not a number": (b'{"a": [1, NaN]}', "a[1]: is NaN, expected a finite number"),
    "infinite": (b"-Infinity", "is -Infinity, expected a finite number"),
    "too large a number": (b'{"a": {"b": 1e999}}', "a.b: is Infinity, expected a finite number"),
    "not a number in a handle": (
        b'{"sets": [{"handles": [{"name": "hand", "target": [0, NaN, 0]}]}]}',
        "sets[0]: handle 'hand': target[1]: is NaN",
    ),
    "twice": (b'{"a": 1, "b": 2, "a": 1}', '"a" stands twice in one object; keep one'),
    "twice in a handle": (
        b'{"handles": [{"pin": true, "name": "hand", "pin": true}]}',
        "handle 'hand': \"pin\" stands twice",
    ),
}


@pytest.mark.parametrize(("content", "said"), FAULTS.values(), ids=FAULTS)
def test_refused(path, content, said):
    path.write_bytes(content)
    with pytest.raises(InputError) as error:
        read_document(path)
    assert str(error.value).startswith(said) or said in str(error.value)


def test_a_file_that_is_not_there(path):
    with pytest.raises(InputError, match=r"cannot be read \(.*\); check the path"):
        read_document(path)


def test_a_folder(tmp_path):
    with pytest.raises(InputError, match="is not a plain file"):
        read_document(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes on this system")
def test_a_pipe_is_not_waited_for(path):
    os.mkfifo(path)
    with pytest.raises(InputError, match="is not a plain file"):
        read_document(path)


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ([], []),
        (["camera", "view", 2, 3], ["camera.view[2][3]"]),
        (["handles"], ["handles"]),
        (["handles", 0], ["handle 'hand'"]),
        (["handles", 0, "target", "values", 1], ["handle 'hand'", "target.values[1]"]),
        (["handles", 1, "vertex"], ["handles[1]", "vertex"]),
        (["handles", 2], ["handles[2]"]),
        (["sets", 0, "handles", 0, "odd name"], ["sets[0]", "handle 'arm'", '"odd name"']),
    ],
)
def test_places_have_words(steps, words):
    inner = {"name": "hand", "target": {"values": [0, 0]}}
    document = {
        "handles": [inner, {"name": "", "vertex": 2}, 3],
        "sets": [{"handles": [{"name": "arm", "odd name": 1}]}],
        "camera": {"view": [[0] * 4] * 4},
    }
    assert describe_location(document, steps) == words


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ({"a": 1}, "an object"),
        ([], "an empty list"),
        ([1, 2], "a list of 2"),
        (True, "true"),
        (None, "null"),
        ("up", '"up"'),
        ("a" * 99, '"' + "a" * 36 + "..."),
        ("\ud800", '"\\ud800"'),
    ],
)
def test_values_have_words(value, text):
    assert format_value(value) == text
