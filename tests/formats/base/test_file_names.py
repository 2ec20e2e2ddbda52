"""Names of files: suffixes, and the number of a frame in names that are written."""

import re
from pathlib import Path

import pytest

from cageik_cli.formats.base.file_numbers import FrameNames
from cageik_cli.formats.base.files import file_stem, file_suffix
from cageik_cli.util.errors import SettingError


@pytest.mark.parametrize(
    ("name", "stem", "kind"),
    [
        ("f.obj", "f", ".obj"),
        ("F.OBJ.GZ", "F", ".obj.gz"),
        ("f.2.low.ply.gz", "f.2.low", ".ply.gz"),
        ("f.gz", "f", ".gz"),
        ("f", "f", ""),
        (".gz", ".gz", ""),
    ],
)
def test_the_kind_of_a_packed_file_has_two_suffixes(name, stem, kind):
    assert file_suffix(Path("folder.obj") / name) == kind
    assert file_stem(Path("folder.obj") / name) == stem


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("cage_####.obj", ("cage_0007.obj", "cage_12345.obj")),
        ("cage.#.ply", ("cage.7.ply", "cage.12345.ply")),
        ("cage_%04d.ply", ("cage_0007.ply", "cage_12345.ply")),
        ("cage_%4d.ply", ("cage_0007.ply", "cage_12345.ply")),
        ("cage_%d.ply", ("cage_7.ply", "cage_12345.ply")),
        ("cage.$F4.obj", ("cage.0007.obj", "cage.12345.obj")),
        ("cage.$F.obj", ("cage.7.obj", "cage.12345.obj")),
        ("##x", ("07x", "12345x")),
    ],
)
def test_patterns(pattern, names):
    found = FrameNames.parse(pattern)
    assert (found.file_name(7), found.file_name(12345)) == names
    assert all(map(found.matches, names))
    assert FrameNames.parse(found.pattern) == found


@pytest.mark.parametrize("name", ["cage.obj", "cage_%x.obj", "cage_0001.obj", "$cage.obj", ""])
def test_what_has_no_number_is_no_pattern(name):
    assert FrameNames.parse(name) is None


@pytest.mark.parametrize("name", ["a_##_##.obj", "a_%d_$F.obj", "$F_%04d"])
def test_a_number_stands_there_once(name):
    with pytest.raises(SettingError, match=rf"{re.escape(name)} has 2 "):
        FrameNames.parse(name)


@pytest.mark.parametrize(
    "name",
    ["c_01.obj", "c_001.ply", "d_001.obj", "c_001.obj.txt", "xc_001.obj", "c_0x1.obj", "c+001.obj"],
)
def test_other_names_are_not_ours(name):
    """Names around the number are taken letter by letter."""
    assert not FrameNames("c_", 3, ".obj").matches(name)
    assert not FrameNames("c.", 3, ".obj").matches(name)
