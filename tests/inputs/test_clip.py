"""The frame that is the rest pose: a number, or the one in which least touches."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.open import open_sequence
from cageik_cli.inputs import clip as module
from cageik_cli.inputs.clip import choose_rest_frame, open_clip_and_choose_rest
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.report.views.cage import format_cage_json
from cageik_cli.run.cage import build_cage_file
from cageik_cli.run.check import check_cage
from cageik_cli.run.extraction import Extraction, extract
from cageik_cli.run.settings import CageSettings, CheckSettings, ExtractSettings
from cageik_cli.util.errors import CheckpointError
from tests.shapes import box
from tests.strips import fold_strip, make_strip
from tests.texts import format_check_text, texts

ANGLES = (0.02, 0.2, 0.5, 0.4, 0.0)
"""Legs touch in all frames but the third and the fourth."""


@pytest.fixture
def clip(folder, write_obj):
    """A clip of a strip that opens and closes, in a cage; its settings."""
    for k, angle in enumerate(ANGLES, start=1):
        write_obj(Path(f"strip/strip_{k}.obj"), fold_strip(angle), make_strip(angle).faces)
    write_obj(Path("around.obj"), box(3).vertices, box(3).faces)
    return ExtractSettings(("strip",), Path("around.obj"), Path("strip.h5"), rest_frame="auto")


def choose():
    return choose_rest_frame(open_sequence(["strip"]))


@pytest.mark.usefixtures("clip")
def test_the_first_of_the_best_frames_is_chosen():
    index, reason = choose()
    assert index == 2
    assert reason.startswith("frame 3 is the rest pose: 0.0 % of its surface")
    assert "the least of 5 frames (" in reason
    assert reason.endswith(" % in frame 5)")


@pytest.mark.usefixtures("clip")
def test_of_a_long_clip_spread_frames_are_compared(monkeypatch):
    monkeypatch.setattr(module, "MAX_COMPARED_FRAMES", 2)
    index, reason = choose()
    assert index == 0
    assert "the least of 2 of 5 frames" in reason


@pytest.mark.usefixtures("clip")
def test_a_frame_that_cannot_be_read_is_not_chosen():
    Path("strip/strip_3.obj").write_text("v 1 2\n")
    index, reason = choose()
    assert index == 3
    assert "4 of 5 frames" in reason


def test_a_model_without_area_has_its_first_frame(folder, write_obj):
    for k in range(2):
        write_obj(Path(f"line/line_{k}.obj"), np.outer(np.arange(3.0), [1, 0, 0]), [[0, 1, 2]])
    assert choose_rest_frame(open_sequence(["line"]))[0] == 0


def test_a_result_is_that_of_the_chosen_number(clip):
    result = extract(clip)
    assert result.settings["rest_frame"] == 2
    np.testing.assert_array_equal(result.rest.vertices, fold_strip(ANGLES[2]))
    assert [
        note for note in texts(result.notes) if note.startswith("strip_3.obj: frame 3 is the rest")
    ]
    same = extract(replace(clip, rest_frame=2, output=Path("same.h5")))
    assert same.settings == result.settings
    np.testing.assert_array_equal(same.rest.vertices, result.rest.vertices)


def test_a_result_is_up_to_date_for_the_number_and_for_the_choice(clip):
    extract(clip)
    for rest_frame in ("auto", 2, "3"):
        extraction = Extraction(replace(clip, resume=True, rest_frame=rest_frame))
        extraction.open()
        assert extraction.existing is not None
    with pytest.raises(CheckpointError, match="other settings"):
        Extraction(replace(clip, resume=True, rest_frame=1)).open()


def test_a_rest_pose_from_a_file_is_not_chosen(clip):
    _, rest, index = open_clip_and_choose_rest(
        clip.frames, clip.clip, Path("strip/strip_1.obj"), "auto", CommonScene()
    )
    assert (rest.source["name"], index) == ("strip_1.obj", None)


def test_check_says_which_frame_it_took(clip):
    text = format_check_text(check_cage(CheckSettings(clip.cage, ("strip",), rest_frame="auto")))
    assert "rest pose      strip_3.obj" in text
    assert "note           strip_3.obj: frame 3 is the rest pose" in text


@pytest.mark.slow
@pytest.mark.usefixtures("clip", "coarse_grids")
def test_a_cage_is_built_around_the_chosen_frame():
    settings = CageSettings("strip", Path("built.obj"), BuildSettings(20), rest_frame="auto")
    result = build_cage_file(settings)
    assert '"rest_frame": 3' in format_cage_json(result)
    assert texts(result.notes)[0].startswith("strip_3.obj: frame 3 is the rest pose")
