"""`cageik info`: what a result, a clip or a mesh holds."""

from pathlib import Path

import numpy as np
import pytest

from cageik_cli.method.weights.harmonic import MAX_HARMONIC_FACES
from cageik_cli.run import info


def rows_of(outcome):
    assert outcome.code == 0, outcome.err
    lines = outcome.out.splitlines()
    return lines[0], {line[2:16].strip(): line[17:] for line in lines[1:]}


@pytest.mark.parametrize(
    "words",
    [["frames"], ["frames/*.obj"], [f"frames/frame_{k}.obj" for k in range(1, 6)]],
)
def test_frames_are_a_clip(run, folder, words):
    headline, rows = rows_of(run("info", *words))
    assert headline == ", ".join(words[:3]) + (
        f" and {len(words) - 3} more" if len(words) > 3 else ""
    )
    assert rows["holds"] == "a clip"
    assert rows["frames"] == "5, frame_1.obj to frame_5.obj"
    assert (rows["vertices"], rows["triangles"]) == ("18", "32")
    assert rows["surface"].startswith("closed, volume 2.94")
    assert rows["bounds"] == "(-1, -1, -1) to (1, 1, 1), diagonal 3.4641"


def test_a_clip_with_gaps_is_described(run, folder):
    Path("frames/frame_3.obj").unlink()
    rows = rows_of(run("info", "frames"))[1]
    assert rows["frames"] == "5, frame_1.obj to frame_5.obj"
    assert rows["missing"] == "1 of these frames: frame_3.obj"
    assert rows["scene"] == "from frame 1"


def test_arrays_are_a_clip(run, folder, animation):
    np.savez("clip.npz", verts=animation.frames, faces=animation.rest.faces[1:])
    headline, rows = rows_of(run("info", "clip.npz"))
    assert headline == "clip.npz"
    assert rows["frames"] == "5, clip.npz[1] to clip.npz[5]"
    assert rows["surface"] == "open, 1 component"


def test_a_result_tells_what_it_was_made_of(run, folder):
    assert run("extract", "frames", "--cage", "cage.obj", "-q").code == 0
    headline, rows = rows_of(run("info", "cages.h5"))
    assert headline == "cages.h5"
    assert rows["holds"].startswith("a result of cageik extract ")
    assert rows["frames"] == "5, frame_1.obj to frame_5.obj"
    assert rows["model"] == "18 vertices, 32 triangles"
    assert rows["cage"] == "8 vertices, 12 triangles"
    assert rows["from cage"] == "cage.obj"
    assert "alpha 0.001" in rows["settings"]


def test_another_hdf5_file_is_a_clip(run, folder, animation):
    import h5py

    with h5py.File("clip.h5", "w") as file:
        file["verts"], file["tris"] = animation.frames, animation.rest.faces
    assert rows_of(run("info", "clip.h5"))[1]["holds"] == "a clip"


def test_positions_without_faces_are_outlined(run, folder, animation):
    frames = animation.frames.astype(">f4")
    times = (np.arange(5) / 30).astype(">f4").tobytes()
    Path("clip.mdd").write_bytes(
        np.array(frames.shape[:2], ">i4").tobytes() + times + frames.tobytes()
    )
    headline, rows = rows_of(run("info", "clip.mdd"))
    assert headline == "clip.mdd"
    assert rows == {
        "holds": "positions without faces, which cageik extract takes from --rest",
        "frames": "5",
        "vertices": "18",
        "scene": "30 frames per second, from frame 0",
    }


def test_an_array_of_two_readings_is_asked_about(run, folder, animation):
    np.save("clip.npy", animation.frames.transpose(1, 2, 0))
    outcome = run("info", "clip.npy")
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.rstrip().endswith(
        "clip.npy: positions can be read as vxf (5 frames of 18 vertices) or fxv (18 frames of 5 "
        "vertices); choose with --layout"
    )
    _, rows = rows_of(run("info", "clip.npy", "--layout", "vxf"))
    assert (rows["frames"], rows["vertices"]) == ("5", "18")


def test_a_clip_tells_its_scene_and_its_notes(run, folder, animation):
    np.savez("clip.npz", v=animation.frames, f=animation.rest.faces, fps=30.0, up_axis="up")
    _, rows = rows_of(run("info", "clip.npz"))
    assert rows["scene"] == "30 frames per second"
    assert rows["note"].startswith("clip.npz: ignored `up_axis`: `up_axis=` is 'up'")


def test_several_clips_are_listed(run, folder, animation):
    import h5py

    with h5py.File("clip.hdf5", "w") as file:
        file["faces"] = animation.rest.faces
        file["run"], file["walk"] = [animation.frames[k:].transpose(1, 2, 0) for k in (3, 0)]
    outcome = run("info", "clip.hdf5")
    assert outcome.out.splitlines() == [
        "clip.hdf5",
        "  holds          2 clips; choose one as FILE::CLIP",
        "  clip           run, 2 frames of 18 vertices",
        "  clip           walk, 5 frames of 18 vertices",
    ]
    _, rows = rows_of(run("info", "clip.hdf5::walk"))
    assert rows["frames"] == "5, clip.hdf5::walk[1] to clip.hdf5::walk[5]"


def test_files_that_are_no_frames_of_one_clip_are_described_one_by_one(run, folder, animation):
    np.savez("a.npz", v=animation.frames, f=animation.rest.faces)
    np.savez("b.npz", v=animation.frames[:2], f=animation.rest.faces)
    blocks = run("info", "a.npz", "cage.obj", "b.npz").out.split("\n\n")
    assert [block.split("\n")[0] for block in blocks] == ["a.npz", "cage.obj", "b.npz"]
    assert "frames         2, b.npz[1]" in blocks[2]
    outcome = run("info", "a.npz", "lost.obj")
    assert outcome.code == 1
    assert "lost.obj" in outcome.err


def test_a_sound_cage_is_said_to_be_one(run, folder):
    _, rows = rows_of(run("info", "cage.obj"))
    assert rows["holds"] == "a mesh"
    assert rows["surface"] == "closed, volume 64, 1 component"
    assert rows["as a cage"] == "sound"


@pytest.mark.parametrize(
    ("case", "says"),
    [
        ("cage_open", "unfit: the cage is open: no second face at 3 edges"),
        ("cage_non_manifold", "unfit: the cage is not manifold"),
        ("cage_two_components", "unfit: the cage has 2 components"),
        ("cage_inside_out", "sound; the cage's faces turn inward"),
    ],
)
def test_another_mesh_is_told_why_it_is_no_cage(run, fixtures_folder, case, says):
    _, rows = rows_of(run("info", fixtures_folder / "broken" / case / "cage.obj"))
    assert rows["as a cage"].startswith(says)


def test_a_mesh_too_large_for_a_cage_is_not_tested_as_one(run, folder, monkeypatch):
    """Copies of one face would have taken gigabytes and minutes."""
    count = MAX_HARMONIC_FACES + 1
    Path("a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n" + "f 1 2 3\n" * count)
    monkeypatch.setattr(info, "find_cage_faults", None)
    _, rows = rows_of(run("info", "a.obj"))
    assert rows["as a cage"] == "unfit: it has 5 001 faces, at most 5 000 are used"


def test_polygons_are_noted(run, fixtures_folder):
    _, rows = rows_of(run("info", fixtures_folder / "broken" / "cage_quads" / "cage.obj"))
    assert rows["note"] == "6 polygons cut into triangles to compute with"
