"""Folders whose meshes are not frames of one clip are not silently their first mesh."""

from pathlib import Path

import pytest

from cageik_cli.formats.open import open_sequence
from cageik_cli.util.errors import FileAccessError, InputError, SettingError
from tests.shapes import ball, box, octahedron
from tests.texts import texts


@pytest.fixture
def place(tmp_path, monkeypatch, write_obj):
    """Write meshes below the current folder, by their names."""
    monkeypatch.chdir(tmp_path)

    def write(**meshes):
        for name, mesh in meshes.items():
            path = Path(name.replace("__", "/") + ".obj")
            write_obj(path, mesh.vertices, mesh.faces)

    return write


def refused_folder(*names):
    with pytest.raises(InputError) as caught:
        open_sequence([*names])
    return str(caught.value)


def test_meshes_of_one_character_are_named(place):
    place(hero__body=ball(1), hero__cap=octahedron(), hero__eye_L=box(), hero__eye_R=box())
    said = refused_folder("hero")
    assert said.startswith("hero: holds 4 meshes that are no frames of one clip (body.obj of 18 ")
    assert "name one of them, as in hero/body.obj, or export them as one file of several" in said


def test_a_folder_of_frames_beside_a_cage_and_a_rest_pose_is_suggested(place):
    place(hero__cage=box(), hero__rest=ball(1))
    place(**{f"hero__frames__walk_{k}": ball(1) for k in range(5)}, hero__other__a=box())
    assert refused_folder("hero").endswith("; did you mean hero/frames, 5 meshes?")
    assert len(open_sequence(["hero/frames"])) == 5


@pytest.mark.parametrize("beside", [{}, {"hero__rest": ball(1)}])
def test_a_folder_of_frames_below_is_suggested(place, beside):
    place(**beside, **{f"hero__{name}__{k}": ball(1) for name in "ab" for k in range(3)})
    assert refused_folder("hero").endswith("did you mean hero/a, 3 meshes or hero/b, 3 meshes?")


def test_numbered_parts_are_no_frames(place):
    place(hero__part_1=ball(1), hero__part_2=box(), hero__part_3=octahedron())
    assert "holds 3 meshes that are no frames of one clip" in refused_folder("hero")


def test_frames_without_numbers_and_one_that_is_damaged_are_a_clip(place):
    place(hero__a=ball(1), hero__b=ball(1))
    assert len(open_sequence(["hero"])) == 2
    place(walk__1=ball(1), walk__2=box(), walk__3=ball(1))
    assert len(open_sequence(["walk"])) == 3
    Path("walk/3.obj").write_text("f 1 2")
    assert len(open_sequence(["walk"])) == 3
    place(one__mesh=ball(1), one__empty__mesh=box())
    assert len(open_sequence(["one"])) == 1


@pytest.mark.parametrize("names", [("hero/body.obj", "hero/cap.obj"), ("hero/*.obj",)])
def test_meshes_that_are_named_one_by_one_are_told_the_same(place, names):
    place(hero__body=ball(1), hero__cap=octahedron())
    said = refused_folder(*names)
    assert said.startswith("hero/body.obj: one of 2 meshes that are no frames of one clip (body.")
    assert "name one of them, as in hero/body.obj, or export them as one file of several" in said
    place(**{f"hero__frames__walk_{k}": ball(1) for k in range(5)})
    assert refused_folder(*names).endswith("; did you mean hero/frames, 5 meshes?")


def test_named_frames_are_a_clip_also_if_a_numbered_one_is_damaged(place):
    place(hero__a=ball(1), hero__b=ball(1), hero__frames__1=ball(1))
    assert len(open_sequence(["hero/a.obj", "hero/b.obj"])) == 2
    place(walk__1=ball(1), walk__2=box(), walk__3=ball(1))
    assert len(open_sequence(["walk/1.obj", "walk/2.obj", "walk/3.obj"])) == 3
    assert len(open_sequence(["walk/*.obj"])) == 3


@pytest.mark.parametrize("name", ["walk_####.obj", "walk_%04d.obj", "walk_$F4.obj"])
def test_the_pattern_of_an_output_is_no_input(place, name):
    place(**{f"frames__walk_{k}": box() for k in range(2)})
    with pytest.raises(FileAccessError, match="folder of the frames, frames, ") as caught:
        open_sequence([f"frames/{name}"])
    assert "'frames/walk_*.obj'" in str(caught.value)
    assert len(open_sequence(["frames/walk_*.obj"])) == 2


def test_a_pattern_that_finds_nothing_says_what_there_is(place):
    place(**{f"frames__walk_{k}": box() for k in range(4)})
    with pytest.raises(FileAccessError, match=r"frames holds walk_0\.obj, .*walk_2\.obj, \.\.\."):
        open_sequence(["frames/*.ply"])
    with pytest.raises(FileAccessError, match="no folder nowhere; this folder holds frames"):
        open_sequence(["nowhere/*.obj"])


def test_named_files_whose_vertices_differ_are_no_clip_with_missing_numbers(place):
    place(cage_60=box(), cage_120=octahedron(), cage_300=ball(1))
    for arguments in (["cage_*.obj"], ["cage_60.obj", "cage_120.obj", "cage_300.obj"]):
        with pytest.raises(SettingError, match="3 meshes that are no frames of one clip"):
            open_sequence(arguments)


def test_frames_beside_cages_of_several_sizes_are_the_clip(place):
    place(cage_60=box(), cage_120=octahedron(), **{f"f_{k}": ball(1) for k in range(3)})
    clip = open_sequence(["."])
    assert len(clip) == 3
    assert "cage_60.obj, cage_120.obj" in " ".join(texts(clip.notes))
