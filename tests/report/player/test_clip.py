"""What a page calls a clip, and the words of its command."""

import shlex
import shutil

import pytest

from cageik_cli.report.player.clip import load_player_clip, make_single_pose
from cageik_cli.store.result import read_result


@pytest.mark.parametrize(
    ("name", "title"),
    [
        ("walker.h5", "walker.h5"),
        ("$(touch x) it's.h5", "$(touch x) it's.h5"),
        ("bad\udcff.h5", "bad\ufffd.h5"),
        ("two\nlines.h5", "two lines.h5"),
    ],
)
def test_any_file_name_is_one_word_of_the_command(closed, tmp_path, name, title):
    copy = shutil.copy(closed.result.path, tmp_path / name)
    clip = load_player_clip(read_result(copy))
    assert clip.title == title
    assert shlex.split(clip.target) == [title]


def test_a_model_is_named_with_its_options(clip):
    clip = make_single_pose(clip.binding, ["my model.obj", "--cage", "cage.obj"])
    assert (clip.title, clip.target) == ("my model.obj", "'my model.obj' --cage cage.obj")


def test_a_model_in_no_file_has_a_place_to_fill_in(clip):
    clip = make_single_pose(clip.binding)
    assert (clip.title, clip.target) == ("", "MODEL.obj --cage CAGE.obj")
