"""Frame numbers through the commands: in the files, in the result, in every export and report."""

import json
import struct
from pathlib import Path

import h5py
import meshio
import numpy as np
import pygltflib
import pytest
import trimesh
from alembic3d.Abc import IArchive
from alembic3d.AbcGeom import IPolyMesh
from pxr import Usd, UsdGeom, UsdSkel

from cageik_cli.store.binding_file import read_binding
from cageik_cli.store.result import read_cages, read_result
from tests.formats.gltf.built import Built
from tests.shapes import ball

NUMBERS = [1001, 1003, 1007, 1009, 1011]
"""Frames that have files; 1005 is missing."""

TIMELINE = [1001, 1003, 1005, 1007, 1009, 1011]
GAP = TIMELINE.index(1005)
EXTRACT = ("extract", "frames", "--cage", "cage.obj", "-q", "--overwrite")


@pytest.fixture
def numbered(folder):
    """`frames/walk.1001.obj` and so on, in the current folder."""
    for k, number in reversed(list(enumerate(NUMBERS, start=1))):
        (folder / f"frames/frame_{k}.obj").rename(folder / f"frames/walk.{number}.obj")
    return folder


@pytest.fixture
def cages(run, numbered):
    """All cages of `cages.h5`, the missing one filled, (6, n, 3)."""
    assert run(*EXTRACT, "--allow-gaps").code == 0
    return np.concatenate(list(read_cages(read_result(Path("cages.h5")), 4)))


def export(run, output, *words):
    outcome = run("export", "cages.h5", output, *words)
    assert outcome.code == 0, outcome.err
    assert "1 of 6 frames skipped (walk.1005.obj); their cages are interpolated" in outcome.err
    return Path(output)


def load(path):
    with np.load(path) as file:
        return dict(file)


def test_a_result_has_the_numbers_and_the_gap(run, cages):
    result = read_result(Path("cages.h5"))
    assert (result.scene.start, result.scene.frame_step) == (1001, 2)
    assert result.frames == tuple(f"walk.{number}.obj" for number in TIMELINE)
    (skipped,) = result.skipped.items()
    assert skipped[0] == GAP
    assert "walk.1005.obj: missing between walk.1003.obj and walk.1007.obj" in str(skipped[1])
    np.testing.assert_allclose(cages[GAP], (cages[GAP - 1] + cages[GAP + 1]) / 2, rtol=1e-12)
    with h5py.File("cages.h5") as file:
        assert (file.attrs["start"], file.attrs["frame_step"]) == (1001, 2)
        assert np.isnan(file["verts"][GAP]).all()
        assert np.isfinite(np.delete(file["verts"][:], GAP, axis=0)).all()
    assert "from frame 1001 in steps of 2" in run("info", "cages.h5").out
    described = run("info", "frames").out
    assert "1 of these frames: walk.1005.obj" in described
    assert "from frame 1001, in steps of 2" in described


def test_other_frames_are_those_of_a_clip_without_gap(run, cages):
    """Frames beside the gap have the same cages, whether it is kept or closed."""
    assert run(*EXTRACT, "--close-gaps").code == 0
    closed = np.concatenate(list(read_cages(read_result(Path("cages.h5")), 4)))
    np.testing.assert_allclose(np.delete(cages, GAP, axis=0), closed, rtol=0, atol=1e-12)


def test_a_gap_is_refused_kept_or_closed(run, numbered):
    outcome = run(*EXTRACT)
    assert outcome.code == 1
    for option in ("--allow-gaps", "--close-gaps"):
        assert option in outcome.err
    assert run(*EXTRACT, "--allow-gaps", "--close-gaps").code == 2
    kept = run("extract", "frames", "--cage", "cage.obj", "--allow-gaps", "-v")
    assert kept.code == 0
    assert "  skipped        1 of 6 frames: walk.1005.obj; " in kept.err
    closed = run("extract", "frames", "--cage", "cage.obj", "--close-gaps", "--overwrite", "-v")
    assert closed.code == 0
    assert "gaps in frame numbers are closed at walk.1007.obj; frames are numbered" in closed.err
    result = read_result(Path("cages.h5"))
    assert (len(result.frames), result.skipped) == (5, {})
    assert (result.scene.start, result.scene.frame_step) == (1001, 2)


@pytest.mark.parametrize("pattern", ["c/c_####.obj", "c/c_####.ply"])
def test_files_have_the_numbers_of_the_input(run, cages, pattern):
    export(run, pattern)
    suffix = Path(pattern).suffix
    assert sorted(path.name for path in Path("c").iterdir()) == [
        f"c_{number}{suffix}" for number in TIMELINE
    ]
    for number, cage in zip(TIMELINE, cages, strict=True):
        path = f"c/c_{number}{suffix}"
        np.testing.assert_allclose(meshio.read(path).points, cage, rtol=0, atol=1e-8)
        loaded = trimesh.load(path, process=False)
        np.testing.assert_allclose(loaded.vertices, cage, rtol=0, atol=1e-8)


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usdz"])
def test_usd_time_codes_are_the_numbers_of_the_input(run, cages, suffix):
    stage = Usd.Stage.Open(str(export(run, f"c.{suffix}")))
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/cage/cage")).GetPointsAttr()
    assert points.GetTimeSamples() == TIMELINE
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1001, 1011)
    for number, cage in zip(TIMELINE, cages, strict=True):
        np.testing.assert_allclose(np.array(points.Get(number)), cage, rtol=0, atol=1e-6)


def test_a_usd_skeleton_has_the_numbers_of_the_input(run, cages):
    stage = Usd.Stage.Open(str(export(run, "c.usdc", "--skeleton")))
    (motion,) = (UsdSkel.Animation(p) for p in stage.Traverse() if p.IsA(UsdSkel.Animation))
    assert motion.GetTranslationsAttr().GetTimeSamples() == TIMELINE


def test_alembic_times_are_the_numbers_of_the_input(run, cages):
    archive = IArchive(str(export(run, "c.abc")))
    schema = IPolyMesh(archive.getTop(), "cage").getSchema()
    times = schema.getTimeSampling()
    count = schema.getNumSamples()
    found = [times.getSampleTime(k) * 24 for k in range(count)]
    np.testing.assert_allclose(found, TIMELINE, rtol=1e-12)
    for k, cage in enumerate(cages):
        points = np.array(schema.getPositionsProperty().getValue(k)).reshape(-1, 3)
        np.testing.assert_allclose(points, cage, rtol=0, atol=1e-6)


def test_gltf_begins_at_0_s_in_the_steps_of_the_input(run, cages):
    loaded = pygltflib.GLTF2().load(str(export(run, "c.glb")))
    accessor = loaded.accessors[loaded.animations[0].samplers[0].input]
    view = loaded.bufferViews[accessor.bufferView]
    times = np.frombuffer(loaded.binary_blob(), "<f4", accessor.count, view.byteOffset)
    np.testing.assert_allclose(times * 24, np.subtract(TIMELINE, TIMELINE[0]), rtol=1e-6)
    assert (accessor.min, accessor.max) == ([float(times[0])], [float(times[-1])])


def test_point_caches_have_the_numbers_of_the_input(run, cages):
    data = export(run, "c.mdd").read_bytes()
    np.testing.assert_allclose(np.frombuffer(data, ">f4", 6, 8) * 24, TIMELINE, rtol=1e-6)
    data = export(run, "c.pc2").read_bytes()
    assert struct.unpack("<ff", data[20:28]) == (1001, 2)
    found = np.frombuffer(data, "<f4", offset=32).reshape(cages.shape)
    np.testing.assert_allclose(found, cages, rtol=0, atol=1e-6)


def test_npz_has_the_numbers_of_the_input(run, cages):
    held = load(export(run, "c.npz"))
    assert (held["start"], held["frame_step"], held["fps"]) == (1001, 2, 24)
    np.testing.assert_array_equal(held["vertices"], cages)


@pytest.mark.parametrize(
    "name", ["c.usdc", "c.abc", "c.mdd", "c.pc2", "c.npz", "c/c.####.obj", "c/c.####.ply"]
)
def test_every_export_is_read_back_with_its_numbers(run, cages, name):
    path = export(run, name)
    source = path.parent if "#" in name else path
    words = ("deform", "cages.h5", "--cages", source, "-o", "out/m_####.obj")
    assert run(*words).code == 0
    assert sorted(path.name for path in Path("out").iterdir()) == [
        f"m_{number}.obj" for number in TIMELINE
    ]
    outcome = run("deform", "cages.h5", "--cages", source, "-o", "m.npz")
    assert outcome.code == 0
    again = run("deform", "cages.h5", "-o", "own.npz")
    assert again.code == 0
    held, own = load("m.npz"), load("own.npz")
    assert (held["start"], held["frame_step"], held["fps"]) == (1001, 2, 24)
    np.testing.assert_allclose(held["vertices"], own["vertices"], rtol=0, atol=1e-5)


def test_start_and_step_override(run, cages):
    export(run, "c/c_#.obj", "--start", "7", "--frame-step", "1")
    assert {path.name for path in Path("c").iterdir()} == {f"c_{k}.obj" for k in range(7, 13)}
    assert run(*EXTRACT, "--allow-gaps", "--start", "0").code == 0
    result = read_result(Path("cages.h5"))
    assert (result.scene.start, result.scene.frame_step) == (0, 2)
    for word in ("0", "-1", "nan"):
        assert run("export", "cages.h5", "d.npz", "--frame-step", word).code == 2


def test_chosen_frames_keep_their_numbers(run, numbered):
    assert run(*EXTRACT, "--allow-gaps", "--frames", "1::2").code == 0
    result = read_result(Path("cages.h5"))
    assert result.frames == ("walk.1003.obj", "walk.1007.obj", "walk.1011.obj")
    assert (result.scene.start, result.scene.frame_step) == (1003, 4)
    assert result.skipped == {}


def test_reports_have_the_numbers_of_the_input(run, cages):
    assert run("report", "--json", "r.json", "--csv", "r.csv", "--html", "r.html", "-q").code == 0
    record = json.loads(Path("r.json").read_text())
    assert [frame["number"] for frame in record["frames"]] == TIMELINE
    assert (record["clip"]["start"], record["clip"]["frame_step"]) == (1001, 2)
    assert "missing between" in record["frames"][GAP]["skipped"]
    head, *rows = (line.split(",") for line in Path("r.csv").read_text().splitlines())
    assert [row[head.index("number")] for row in rows] == list(map(str, TIMELINE))
    page = Path("r.html").read_text()
    assert all(f'<td class="number">{number}</td>' in page for number in TIMELINE)
    worst = record["summary"]["worst_frame_index"]
    assert f"frame {TIMELINE[worst]}" in page


def test_a_gap_of_cages_is_filled_and_said(run, cages):
    export(run, "c/c.####.obj")
    Path("c/c.1009.obj").unlink()
    words = ("deform", "cages.h5", "--cages", "c", "-o", "m.npz")
    assert run(*words).code == 1
    outcome = run(*words, "--allow-gaps")
    assert outcome.code == 0
    assert "1 cages are missing (c.1009.obj) and interpolated" in outcome.err
    vertices = load("m.npz")["vertices"]
    np.testing.assert_allclose(vertices[4], (vertices[3] + vertices[5]) / 2, rtol=0, atol=1e-9)


def test_a_kept_gap_stops_neither_fit_nor_resume(run, numbered):
    words = (*EXTRACT, "--allow-gaps")
    assert run(*words, "--fit").code == 0
    assert run(*words).code == 0
    before = Path("cages.h5").read_bytes()
    again = run("extract", "frames", "--cage", "cage.obj", "--allow-gaps", "--resume")
    assert "up to date" in again.err
    assert Path("cages.h5").read_bytes() == before


def test_a_frame_that_cannot_be_read_is_no_gap(run, numbered):
    """Missing numbers are accepted; damaged files are not, unless that is asked for too."""
    Path("frames/walk.1007.obj").write_text("no mesh")
    outcome = run(*EXTRACT, "--allow-gaps")
    assert outcome.code == 1
    assert "walk.1007.obj: " in outcome.err
    assert run(*EXTRACT, "--allow-gaps", "--on-bad-frame", "skip").code == 0
    assert set(read_result(Path("cages.h5")).skipped) == {2, 3}


def test_the_missing_frame_is_no_rest_pose(run, numbered):
    outcome = run(*EXTRACT, "--allow-gaps", "--rest-frame", "1005")
    assert outcome.code == 1
    assert "walk.1005.obj: missing between" in outcome.err
    assert run(*EXTRACT, "--allow-gaps", "--rest-frame", "auto").code == 0


def test_a_cage_is_built_and_checked_whatever_is_missing(run, numbered):
    for words in (["--allow-gaps"], ["--close-gaps"]):
        outcome = run("check", "frames", "--cage", "cage.obj", *words)
        assert "missing" not in outcome.err + outcome.out


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("walk.1003.obj", "walk.-3.obj", "has a negative frame number"),
        ("walk.1003.obj", "walk.1001.5.obj", "is a subframe of walk.1001"),
        ("walk.1003.obj", "walk.01001.obj", "has the frame number of walk."),
    ],
)
def test_numbers_that_are_no_places_in_time_are_refused(run, numbered, old, new, says):
    (Path("frames") / old).rename(Path("frames") / new)
    outcome = run(*EXTRACT, "--allow-gaps")
    assert outcome.code == 1
    assert says in outcome.err
    assert len(outcome.err.splitlines()) == 1
    assert run(*EXTRACT, "--close-gaps").code == 0


SECONDS = 0.5
LAST = {24: 12, 10: 5}
"""The number of the last frame, by the rate."""


@pytest.fixture
def rig(folder):
    """The current folder, with a ball that a node moves for half a second."""
    file, mesh = Built(), ball(1, 0.8)
    primitive = {
        "attributes": {"POSITION": file.array(mesh.vertices)},
        "indices": file.array(mesh.faces.ravel(), "H"),
    }
    file.add("nodes", {"name": "ball", "mesh": file.add("meshes", {"primitives": [primitive]})})
    places = np.array([[0, 0, 0], [0, 0.3, 0]])
    file.animate("rise", (0, "translation", [0, SECONDS], places, "LINEAR"))
    return file.save(folder / "rig.glb")


@pytest.mark.parametrize(
    "command", ["check rig.glb --cage cage.obj", "cage rig.glb -o new.obj", "extract rig.glb"]
)
@pytest.mark.parametrize("rate", LAST)
def test_the_last_frame_is_that_of_the_rate(run, rig, command, rate):
    words = [*command.split(), "--fps", rate, "--rest-frame"]
    outcome = run(*words, LAST[rate] + 1)
    assert outcome.code == 1
    assert f"the clip has {LAST[rate] + 1} frames" in outcome.err


@pytest.mark.parametrize("rate", LAST)
def test_a_fit_of_a_binding_takes_the_frames_of_the_rate(run, rig, rate):
    words = ("--cage", "cage.obj", "--rest", "rig.glb", "--fit", "rig.glb", "--fps", rate)
    outcome = run("bind", *words)
    assert outcome.code == 0, outcome.err
    assert run("info", "rig.glb", "--fps", rate).out.count(f"rig.glb[{LAST[rate]}]") == 1
    (clip,) = read_binding(Path("binding.h5")).fit.clips
    assert clip.frames == LAST[rate] + 1


@pytest.mark.parametrize("rate", ["0", "-24", "nan"])
def test_a_rate_that_is_none_is_refused(run, rig, rate):
    outcome = run("info", "rig.glb", "--fps", rate)
    assert outcome.code == 2
    assert f"{float(rate):g} frames per second" in outcome.err


def test_a_rate_without_a_clip_to_fit_is_wrong_usage(run, rig):
    outcome = run("bind", "--cage", "cage.obj", "--rest", "rig.glb", "--fps", "10")
    assert outcome.code == 2
    assert "--fps" in outcome.err
