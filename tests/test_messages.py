"""The exact words of about twenty messages, so that a change of wording is seen in one place.

All other tests assert the exit code, the kind of the error, and the offending name or number.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.refusals import refused
from tests.shapes import box

EXTRACT = ("extract", "frames", "--cage", "cage.obj")
POSE = ("pose", "frames/frame_1.obj", "handles.json", "--cage", "cage.obj", "-o", "posed.obj")


def write_handles(*handles):
    Path("handles.json").write_text(json.dumps({"handles": handles}))


def break_frame(text):
    path = Path("frames/frame_2.obj")
    path.write_text(text(path.read_text()))


def write_box(write_obj, size=2.0, faces=slice(None)):
    mesh = box(size)
    write_obj(Path("cage.obj"), mesh.vertices, mesh.faces[faces])


SETUPS = {
    "frame of other size": lambda write_obj: break_frame(lambda text: text + "v 0 0 0\n"),
    "frame not finite": lambda write_obj: break_frame(
        lambda text: "v 0 nan 1\n" + text.split("\n", 1)[1]
    ),
    "missing frame": lambda write_obj: Path("frames/frame_3.obj").unlink(),
    "unsupported file": lambda write_obj: Path("cage.fbx").write_text("scene"),
    "open cage": lambda write_obj: write_box(write_obj, faces=slice(1, None)),
    "small cage": lambda write_obj: write_box(write_obj, size=0.97),
    "result exists": lambda write_obj: Path("cages.h5").write_text("old"),
    "not a result": lambda write_obj: Path("cages.h5").write_text("old"),
    "checkpoint as result": lambda write_obj: Path("cages.h5.partial").write_text("old"),
    "missing option": lambda write_obj: Path("cageik.toml").write_text("[extract]\nalfa = 1\n"),
    "no such vertex": lambda write_obj: write_handles(
        {"name": "tip", "vertex": 99, "target": [0, 0, 0]}
    ),
    "field of wrong type": lambda write_obj: write_handles({"name": "tip", "vertex": "a"}),
    "two targets": lambda write_obj: write_handles(
        {"name": "a", "vertex": 1, "target": [0, 0, 0]},
        {"name": "b", "vertex": 1, "target": [1, 0, 0]},
    ),
    "vertex weights": lambda write_obj: np.save("w.npy", np.ones(17)),
}
"""What is written beside the frames and the cage before the command runs."""

MESSAGES = {
    "no frames": (
        ["extract", "nowhere", "--cage", "cage.obj"],
        1,
        "Error: nowhere: no such file or folder; check the path",
    ),
    "unsupported file": (
        ["extract", "cage.fbx", "--cage", "cage.obj"],
        1,
        "Error: cage.fbx: is a scene of another program; export it as glTF, USD or Alembic, or "
        "bake it: blender --background --python docs/scripts/bake_rig.py -- cage.fbx cage.abc",
    ),
    "frame of other size": (
        EXTRACT,
        1,
        "Error: frames/frame_2.obj: 19 vertices, the rest pose has 18; all must share one "
        "connectivity",
    ),
    "frame not finite": (
        EXTRACT,
        1,
        "Error: frames/frame_2.obj: vertex 0 is (0, nan, 1) and 1 of 18 vertices are not "
        "finite; expected finite numbers; export the file again, or take them as missing with "
        "--missing of cageik extract",
    ),
    "open cage": (
        EXTRACT,
        1,
        "Error: cage.obj: the cage is open: no second face at 3 edges (0-3, 0-1, 1-3); close "
        "the hole; to repair the cage: cageik cage --repair cage.obj --rest frames/frame_1.obj -o "
        "cage_repaired.obj",
    ),
    "small cage": (
        EXTRACT,
        1,
        "Error: cage.obj: 6 of 18 vertices of the rest pose are outside the cage, the worst, 0, by "
        "0.866 % of the diagonal: numbers 0, 1, 2, 3, 4, 5 (from 0); the cage is not inflated: "
        "inflate it by 1.6 % of the diagonal (0.0554) along its normals, or take the nearest "
        "points of the cage with --outside project; to repair the cage: cageik cage --repair "
        "cage.obj --rest frames/frame_1.obj -o cage_repaired.obj",
    ),
    "vertex weights": (
        [*EXTRACT, "--vertex-weights", "w.npy"],
        1,
        "Error: w.npy: vertex weights have shape (17,), the model has 18 vertices; expected "
        "one number per vertex",
    ),
    "missing frame": (
        EXTRACT,
        1,
        "Error: frames/frame_3.obj: missing between frame_2.obj and frame_4.obj, where "
        "frames are numbered in steps of 1 (1 such gap); restore it, keep gaps in time "
        "with --allow-gaps, or number the frames one after another with --close-gaps",
    ),
    "result exists": (
        EXTRACT,
        1,
        "Error: cages.h5: exists already; choose another name, or replace it with --overwrite",
    ),
    "output over input": (
        [*EXTRACT, "-o", "cage.obj", "--overwrite"],
        1,
        "Error: cage.obj: is read or written by this command already; choose another name",
    ),
    "no result": (
        ["report"],
        1,
        "Error: cages.h5: no such file; create it with cageik extract, or give another",
    ),
    "not a result": (
        ["report"],
        1,
        "Error: cages.h5: is not an HDF5 file, expected the result of cageik extract, such as "
        "cages.h5; extract one from frames, or look at the file by cageik info",
    ),
    "checkpoint as result": (
        ["report", "cages.h5.partial"],
        1,
        "Error: cages.h5.partial: is a checkpoint, not a result; rerun the command with --resume",
    ),
    "unknown format": (
        ["deform", "cages.h5", "-o", "mesh.xyz"],
        1,
        "Error: mesh.xyz: `.xyz` is not an animation format that can be written, expected "
        ".abc, .glb, .mdd, .npz, .obj, .pc2, .ply, .usd, .usda, .usdc, .usdz, .vat",
    ),
    "no such vertex": (
        POSE,
        1,
        "Error: handles.json: handle 'tip': vertex: there is no vertex 99; the mesh has 18, "
        "numbered from 0 to 17",
    ),
    "field of wrong type": (
        POSE,
        1,
        "Error: handles.json: handle 'tip': vertex: is \"a\", expected a whole number from 0 "
        "to 1000000000",
    ),
    "two targets": (
        POSE,
        1,
        "Error: handles.json: handles 'a' and 'b' conflict: they are on the same point, and "
        "their targets are 1 apart; remove one, or use the mean of their targets with "
        "--allow-conflicts",
    ),
    "a small cage": (
        ["extract", "frames", "--cage-vertices", "3"],
        2,
        "Error: a cage of 3 vertices is asked for, expected 8 to 2000",
    ),
    "two rest poses": (
        [*EXTRACT, "--rest", "cage.obj", "--rest-frame", "1"],
        2,
        "Error: --rest and --rest-frame both give the rest pose; leave one out",
    ),
    "impossible setting": (
        [*EXTRACT, "--alpha", "-1"],
        2,
        "Error: --alpha is -1.0, expected a finite number, zero or above",
    ),
    "missing option": (
        [*EXTRACT, "--config", "cageik.toml"],
        2,
        "Error: Invalid value for '--config': cageik.toml: [extract] has no option alfa; did "
        "you mean alpha?",
    ),
    "jobs of a cluster": (
        ["batch", ".", "-o", "out", "--cage", "cage.obj", "--scheduler", "a", "--jobs", "2"],
        2,
        "Error: --jobs applies to local runs only; leave it out with --scheduler",
    ),
}
"""Words of the command, exit code, and the last line on stderr."""


@pytest.mark.parametrize("name", MESSAGES)
def test_the_message_is_this_one(run, folder, write_obj, name):
    words, code, message = MESSAGES[name]
    if name in SETUPS:
        SETUPS[name](write_obj)
    outcome = run(*words)
    assert (outcome.code, outcome.out) == (code, "")
    assert outcome.err.splitlines()[-1] == message


def test_an_unexpected_error_is_called_internal(run, folder, monkeypatch):
    def fail(settings, progress):
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr("cageik_cli.run.extraction.extract", fail)
    assert run(*EXTRACT).err == (
        "Error: internal error (ZeroDivisionError: by zero); please report it with the output of "
        "the same command with -vv\n"
    )


def test_a_limit_that_is_exceeded_is_said_with_what_was_found(run, folder):
    outcome = run(*EXTRACT, "-q", "--max-rms", "0.5%")
    assert outcome.code == 3
    assert outcome.err == (
        "cages.h5: over limit: rms 4.5699 %, limit 0.5 %, worst frame frame_5.obj\n"
    )


FAULTS = {
    "of another place": "b.obj: is cut short",
    "of another fault": "a.obj: is empty",
    "of several lines": "a.obj: is cut short\nat its end",
}


def test_what_is_expected_passes():
    with refused(ValueError, "cut short", at="a.obj"):
        raise ValueError("a.obj: is cut short")


@pytest.mark.parametrize("sentence", FAULTS.values(), ids=FAULTS)
def test_another_sentence_fails(sentence):
    with pytest.raises(AssertionError), refused(ValueError, "cut short", at="a.obj"):
        raise ValueError(sentence)


def test_no_error_fails():
    with pytest.raises(pytest.fail.Exception), refused(ValueError, "cut short"):
        pass
