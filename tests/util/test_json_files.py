"""JSON files within limits: what is read, what is refused, and how places are named."""

import pytest

from cageik_cli.util.errors import FileAccessError, FormatError
from cageik_cli.util.json_files import MAX_DEPTH, JsonFormat, format_steps, format_value, read_json

SETTINGS = JsonFormat("a settings file", 2000)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "file.json"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ('{"a": [1, 2.5, true, null, "x"]}', {"a": [1, 2.5, True, None, "x"]}),
        ("\ufeff{}", {}),
        ("3", 3),
        ('{"ä": "\\u00e4"}', {"ä": "ä"}),
        ("[" * MAX_DEPTH + "]" * MAX_DEPTH, None),
        ("[]" + " " * (SETTINGS.max_bytes - 2), []),
    ],
    ids=["values", "mark", "a number", "letters", "deep", "long"],
)
def test_json_is_read(path, text, value):
    path.write_text(text, encoding="utf-8")
    found = read_json(path, SETTINGS)
    assert value is None or found == value


FAULTS = {
    "not JSON": (b'{"a": 1,}', "line 1, column 9"),
    "a comment": (b"{\n  // no\n}", "line 2, column 3"),
    "empty": (b"", "the file is empty"),
    "a blank": (b" ", "line 1, column 2"),
    "not UTF-8": (b'{"a": "\xff"}', "UTF-8 text at byte 7"),
    "deep": (b"[" * (MAX_DEPTH + 1) + b"]" * (MAX_DEPTH + 1), f"{MAX_DEPTH} levels deep"),
    "too deep for Python": (b"[" * 100_000, f"{MAX_DEPTH} levels deep"),
    "digits": (b"9" * 5000, "thousands of digits"),
    "not a number": (b'{"a": [1, NaN]}', "a[1]: is NaN, expected a finite number"),
    "infinite": (b"-Infinity", "is -Infinity, expected a finite number"),
    "too large a number": (b'{"a": {"b": 1e999}}', "a.b: is Infinity, expected a finite number"),
    "too many digits": (b'{"a": 1' + b"0" * 400 + b"}", "a: is 1000000000"),
    "the first of several": (b'{"a": [{"b": NaN}, Infinity], "c": NaN}', "c: is NaN"),
    "twice": (b'{"a": 1, "b": 2, "a": 1}', 'has "a" twice'),
    "twice inside": (b'{"a": [0, {"b": 1, "c": 2, "c": 3}]}', 'a[1]: has "c" twice'),
    "three times": (b'{"a": [{"b": 1, "b": 2}], "c": 1, "c": 2, "c": 3}', 'has "c" twice'),
}


@pytest.mark.parametrize(("content", "says"), FAULTS.values(), ids=FAULTS)
def test_other_content_is_refused(path, content, says):
    path.write_bytes(content)
    with pytest.raises(FormatError) as error:
        read_json(path, JsonFormat("a settings file", 1 << 20))
    assert says in str(error.value)


def test_a_file_that_is_too_large_is_not_read(path):
    path.write_bytes(b"[]" + b" " * (SETTINGS.max_bytes - 1))
    with pytest.raises(FileAccessError, match=r"2 kB, expected at most 2 kB; give a settings file"):
        read_json(path, SETTINGS)


def test_a_missing_file_is_refused(path):
    with pytest.raises(FileAccessError, match="no such file"):
        read_json(path, SETTINGS)


@pytest.mark.parametrize(
    ("steps", "place"),
    [
        ([], ""),
        (["a"], "a"),
        ([2, "b", 0], "[2].b[0]"),
        (["clips", 1, "odd name"], 'clips[1]."odd name"'),
    ],
)
def test_places_are_formatted(steps, place):
    assert format_steps(None, steps) == place


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
def test_values_are_formatted(value, text):
    assert format_value(value) == text
