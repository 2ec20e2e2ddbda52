"""What is refused as the file of a cage."""

from pathlib import Path

import pytest

from cageik_cli.inputs.source import load_source
from cageik_cli.util.errors import FileAccessError


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("frames", "is a folder, "),
        ("frames/*.obj", r"is a pattern \(frame_1\.obj, frame_2\.obj, frame_3\.obj and \d+ more\)"),
        ("nowhere/*.obj", r"is a pattern \(no file\)"),
    ],
)
def test_a_clip_in_place_of_the_cage_says_where_to_give_both(folder, name, found):
    with pytest.raises(FileAccessError, match=found) as caught:
        load_source(Path(name), "cage")
    assert "`frames=`" in str(caught.value)
    assert "`cage=`" in str(caught.value)


def test_a_file_with_marks_of_a_pattern_is_a_file(folder):
    Path("cage.obj").rename("cage[1].obj")
    assert len(load_source(Path("cage[1].obj"), "cage").mesh.vertices) == 8
