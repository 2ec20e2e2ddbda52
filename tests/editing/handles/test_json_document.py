import pytest

from cageik_cli.editing.handles.reader import HANDLES_FORMAT, MAX_HANDLES_BYTES, describe_location
from cageik_cli.util.errors import FileAccessError, FormatError
from cageik_cli.util.json_files import read_json


@pytest.fixture
def path(tmp_path):
    return tmp_path / "drag.json"


def test_a_file_of_the_largest_size_is_read(path):
    path.write_text("[]" + " " * (MAX_HANDLES_BYTES - 2))
    assert read_json(path, HANDLES_FORMAT) == []
    path.write_text("[]" + " " * (MAX_HANDLES_BYTES - 1))
    with pytest.raises(FileAccessError, match=r"2 MB, expected at most 2 MB; give a handles file"):
        read_json(path, HANDLES_FORMAT)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (
            '{"sets": [{"handles": [{"name": "hand", "target": [0, NaN, 0]}]}]}',
            "sets[0]: handle 'hand': target[1]: is NaN",
        ),
        (
            '{"handles": [{"pin": true, "name": "hand", "pin": true}]}',
            "handle 'hand': has \"pin\" twice",
        ),
    ],
)
def test_the_handle_at_fault_is_named(path, content, says):
    path.write_text(content)
    with pytest.raises(FormatError) as error:
        read_json(path, HANDLES_FORMAT)
    assert str(error.value).startswith(says)


@pytest.mark.parametrize(
    ("steps", "place"),
    [
        ([], ""),
        (["camera", "view", 2, 3], "camera.view[2][3]"),
        (["handles"], "handles"),
        (["handles", 0], "handle 'hand'"),
        (["handles", 0, "target", "values", 1], "handle 'hand': target.values[1]"),
        (["handles", 1, "vertex"], "handles[1]: vertex"),
        (["handles", 2], "handles[2]"),
        (["sets", 0, "handles", 0, "odd name"], "sets[0]: handle 'arm': \"odd name\""),
    ],
)
def test_places_are_in_words(steps, place):
    inner = {"name": "hand", "target": {"values": [0, 0]}}
    document = {
        "handles": [inner, {"name": "", "vertex": 2}, 3],
        "sets": [{"handles": [{"name": "arm", "odd name": 1}]}],
        "camera": {"view": [[0] * 4] * 4},
    }
    assert describe_location(document, steps) == place
