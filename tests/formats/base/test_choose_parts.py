"""Which meshes of a file are read."""

import pytest

from cageik_cli.formats.base.choose_parts import choose_parts, drop_parts, select_parts
from cageik_cli.geometry.parts import join_meshes, list_part_names
from cageik_cli.util.errors import InputError
from tests.shapes import box

PATHS = ["/hero/geo/body", "/hero/geo/eye_L", "/hero/geo/eye_R", "/hero/rig/guide", "/prop"]
HIDDEN = {"/hero/rig/guide": "purpose guide", "/prop": "invisible"}


@pytest.mark.parametrize(
    ("member", "exclude", "chosen"),
    [
        (None, (), [0, 1, 2]),
        ("/hero", (), [0, 1, 2]),
        ("/hero/geo/body", (), [0]),
        ("/prop", (), [4]),
        ("/hero/rig", (), [3]),
        ("body", (), [0]),
        ("geo", ("eye_?",), [0]),
        ("hero/geo", (), [0, 1, 2]),
        ("geo/eye_R", (), [2]),
        ("prop", (), [4]),
        (None, ("eye_?",), [0]),
        (None, ("geo",), [3, 4]),
        (None, ("/hero/geo/e*", "/prop"), [0]),
    ],
)
def test_meshes_at_or_below_a_path_but_for_patterns(member, exclude, chosen):
    assert choose_parts(PATHS, member, exclude, HIDDEN)[0] == [PATHS[k] for k in chosen]


def test_notes_name_what_is_left_out_and_why():
    assert choose_parts(PATHS, None, ("eye_L",), HIDDEN)[1] == [
        "left out /hero/geo/eye_L (`exclude=eye_L`)",
        "left out /hero/rig/guide (purpose guide)",
        "left out /prop (invisible)",
    ]


@pytest.mark.parametrize(
    ("paths", "member", "exclude", "sentence"),
    [
        ([], None, (), "holds no mesh"),
        (PATHS, "/her", (), "no mesh `/her`.*/hero/geo/body"),
        (PATHS, "bod", (), "no mesh `bod`.*/hero/geo/body"),
        (PATHS, "/geo/body", (), "no mesh `/geo/body`"),
        (["/a/geo/x", "/b/geo/x"], "geo", (), "2 meshes or groups `geo`: /a/geo, /b/geo; .* ::/a"),
        (PATHS, None, ("hand",), "`exclude=hand` matches none.*/hero/geo/body"),
        (PATHS, None, ("*",), "leaves none"),
    ],
)
def test_a_choice_of_nothing_is_refused(paths, member, exclude, sentence):
    with pytest.raises(InputError, match=sentence):
        choose_parts(paths, member, exclude)


def test_a_transform_and_its_mesh_of_one_name_are_one_part():
    assert choose_parts(["/hero/body/body", "/hero/hat"], "body", ())[0] == ["/hero/body/body"]
    assert choose_parts(["body", "/hero/body"], "body", ())[0] == ["body"]


MODEL = join_meshes([box(1.0), box(2.0), box(3.0)], PATHS[:3])


def test_the_chosen_parts_of_a_mesh_keep_their_names_and_vertices():
    mesh, kept, notes = select_parts(MODEL, "/hero/geo", ("eye_L",))
    assert list_part_names(mesh) == ("/hero/geo/body", "/hero/geo/eye_R")
    assert kept.tolist() == [*range(8), *range(16, 24)]
    assert (mesh.vertices == MODEL.vertices[kept]).all()
    assert notes == ["left out /hero/geo/eye_L (`exclude=eye_L`)"]


def test_nothing_is_chosen_from_a_mesh_that_came_as_one():
    whole = box()
    assert select_parts(whole, None, ()) == (whole, None, [])
    with pytest.raises(InputError, match="has no objects to choose from"):
        select_parts(box(), None, ("body",))


def test_a_rest_pose_may_lack_what_is_left_out():
    mesh, notes = drop_parts(MODEL, ("eye_?", "props"))
    assert list_part_names(mesh) == ("/hero/geo/body",)
    assert notes == ["left out /hero/geo/eye_L, /hero/geo/eye_R (`exclude=`)"]
    assert drop_parts(MODEL, ("props",)) == (MODEL, [])
    with pytest.raises(InputError, match="leaves none"):
        drop_parts(MODEL, ("hero",))
