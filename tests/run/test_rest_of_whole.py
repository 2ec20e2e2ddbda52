"""The rest pose of a given cage is a frame of the whole clip, whichever frames are taken."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.formats.settings import ClipSettings
from cageik_cli.formats.timeline import parse_frames
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.run.check import check_cage
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import CheckSettings, ExtractSettings
from cageik_cli.util.errors import CageikError
from tests.texts import texts

WALKER = Path(__file__).parents[2] / "data_fixtures" / "walker"
PART = ClipSettings(selection=parse_frames("20-22"))


def settings(output: Path) -> ExtractSettings:
    return ExtractSettings(
        (str(WALKER / "frames"),), WALKER / "cage.obj", output, clip=PART,
        bind=BindSettings(accuracy="preview"),
    )  # fmt: skip


@pytest.mark.parametrize("rest_frame", [0, "1"])
def test_first_frame_of_the_whole_clip_is_the_rest_pose(
    tmp_path: Path, rest_frame: int | str
) -> None:
    part = extract(replace(settings(tmp_path / "part.h5"), rest_frame=rest_frame))
    end = ClipSettings(selection=parse_frames("1-22"))
    whole = extract(replace(settings(tmp_path / "whole.h5"), clip=end))
    assert part.settings["rest_frame"] is None
    assert whole.settings["rest_frame"] == 0
    assert any("frame 1 is the rest pose" in note for note in texts(part.notes))
    cages = []
    for name in ("part.h5", "whole.h5"):
        with h5py.File(tmp_path / name) as file:
            cages.append(file["verts"][-3:])
    np.testing.assert_allclose(cages[0], cages[1], rtol=0, atol=1e-12)


@pytest.mark.usefixtures("coarse_grids")
def test_frame_that_is_taken_has_its_index(tmp_path: Path) -> None:
    frame = replace(settings(tmp_path / "own.h5"), cage=None, rest_frame="21", fit=False)
    assert extract(frame).settings["rest_frame"] == 1


def test_frame_that_the_clip_does_not_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CageikError, match="no frame 99"):
        extract(replace(settings(tmp_path / "none.h5"), rest_frame="99"))


@pytest.mark.usefixtures("coarse_grids")
def test_a_cage_is_built_around_the_first_frame_taken(tmp_path: Path) -> None:
    built = extract(replace(settings(tmp_path / "built.h5"), cage=None, fit=False))
    assert built.settings["rest_frame"] == 0
    assert "walker_20" in str(built.sources["rest"])


def test_check_takes_the_same_rest_pose() -> None:
    frames = (str(WALKER / "frames"),)
    checked = check_cage(CheckSettings(WALKER / "cage.obj", frames, clip=PART))
    assert not [found for found in checked.diagnosis.findings if found.severity == "unfit"]
