"""Settings name the files that a command reads and writes, for the check that none is both."""

from pathlib import Path

import pytest

from cageik_cli.formats.write import Output
from cageik_cli.run.settings import (
    BindRunSettings,
    CageSettings,
    CheckSettings,
    DeformSettings,
    EditSettings,
    ExportSettings,
    ExtractSettings,
    PoseSettings,
    RepairCageSettings,
    ViewSettings,
)
from cageik_cli.util.errors import InputError, SettingError
from cageik_cli.util.outputs import check_no_overlap

FRAMES = [f"frames/frame_{k}.obj" for k in range(1, 6)]
CAGE, REST, RESULT, OUT = map(Path, ("cage.obj", "rest.obj", "cages.h5", "out.h5"))
HANDLES, MESH = Path("handles.json"), Path("mesh.obj")

CASES = {
    "bind": (BindRunSettings(CAGE, REST, OUT), [CAGE, REST], [OUT]),
    "cage": (CageSettings("frames/frame_2.obj", OUT, rest=REST), [REST, FRAMES[1]], [OUT]),
    "cage for frames": (
        CageSettings(FRAMES[0], OUT, animation=("frames",)),
        [FRAMES[0], *FRAMES],
        [OUT],
    ),
    "check": (CheckSettings(CAGE), [CAGE], []),
    "check frames": (CheckSettings(CAGE, ("frames",), REST), [CAGE, REST, *FRAMES], []),
    "deform": (DeformSettings(RESULT, Output(Path("a.npz"))), [RESULT], ["a.npz"]),
    "deform by cages": (
        DeformSettings(RESULT, Output(Path("a/b_##.obj")), (MESH,), cages="frames/*.obj"),
        [RESULT, MESH, *FRAMES],
        ["a"],
    ),
    "edit": (EditSettings(RESULT, HANDLES, OUT), [RESULT, HANDLES], [OUT]),
    "export": (ExportSettings((RESULT,), Output(Path("a.pc2"))), [RESULT], ["a.pc2"]),
    "extract": (ExtractSettings(("frames",), CAGE, OUT), [CAGE, *FRAMES], [OUT]),
    "extract all": (
        ExtractSettings(("frames/frame_2.obj",), CAGE, OUT, RESULT, rest=REST, vertex_weights=MESH),
        [CAGE, RESULT, REST, MESH, FRAMES[1]],
        [OUT],
    ),
    "pose": (PoseSettings(REST, HANDLES, MESH), [REST, HANDLES], [MESH]),
    "pose with cages": (
        PoseSettings(REST, HANDLES, MESH, CAGE, cage_output=Path("posed.obj")),
        [REST, HANDLES, CAGE],
        [MESH, "posed.obj"],
    ),
    "repair": (RepairCageSettings(CAGE, REST, MESH), [CAGE, REST], [MESH]),
    "view": (ViewSettings(REST, CAGE, handles=HANDLES), [REST, CAGE, HANDLES], []),
    "view with saved handles": (
        ViewSettings(RESULT, handles=HANDLES, output=OUT, handles_output=HANDLES, overwrite=True),
        [RESULT],
        [OUT, HANDLES],
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_settings_name_what_is_read_and_written(folder, name):
    settings, inputs, outputs = CASES[name]
    assert sorted(settings.inputs()) == sorted(map(Path, inputs))
    assert settings.outputs() == list(map(Path, outputs))
    check_no_overlap([*settings.outputs()], [*settings.inputs()])


def test_an_output_that_is_an_input_is_refused(folder):
    settings = ExtractSettings(("frames",), CAGE, Path(FRAMES[3]))
    with pytest.raises(InputError, match=r"frame_4\.obj"):
        check_no_overlap([*settings.outputs()], [*settings.inputs()])


def test_a_rest_pose_is_a_mesh_or_a_frame():
    with pytest.raises(SettingError, match="`rest=` and `rest_frame=` both give the rest pose"):
        ExtractSettings(("frames",), CAGE, OUT, rest=REST, rest_frame="2")
    with pytest.raises(SettingError, match="`rest=` and `rest_frame=` both give the rest pose"):
        ExtractSettings(("frames",), CAGE, OUT, rest=REST, rest_frame="")
    assert ExtractSettings(("frames",), CAGE, OUT, rest=REST, rest_frame=0).rest == REST
