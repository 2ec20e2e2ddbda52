"""Which of a file's meshes is meant."""

import pytest

from cageik_cli.formats.base.scene_graph import choose_mesh
from cageik_cli.util.errors import InputError


@pytest.mark.parametrize(
    ("meshes", "member", "mesh"),
    [(["/a"], None, "/a"), (["/a"], "/a", "/a"), (["/a", "/b"], "/b", "/b")],
)
def test_the_one_that_is_named_or_the_only_one(meshes, member, mesh):
    assert choose_mesh(meshes, member) == mesh


@pytest.mark.parametrize(
    ("meshes", "member", "sentence"),
    [
        ([], None, "holds no mesh"),
        ([], "/a", "holds no mesh"),
        (["/a"], "/b", "no mesh `/b`.* /a"),
        (["/a", "/b"], None, "2 meshes.* /a, /b; .*FILE::/a"),
    ],
)
def test_otherwise_what_there_is_to_choose_from(meshes, member, sentence):
    with pytest.raises(InputError, match=sentence):
        choose_mesh(meshes, member)
