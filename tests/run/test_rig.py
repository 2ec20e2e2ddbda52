"""Results as skeletons, skinned by USD itself: they give what the cages of the results give."""

import gc
import re
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel

from cageik_cli.formats.open import open_sequence
from cageik_cli.geometry.shape import compute_vertex_normals
from cageik_cli.inputs.reconstruction import CageFrames, Reconstruction
from cageik_cli.method.weights.binding import reconstruct_frames
from cageik_cli.run import rig as rigs
from cageik_cli.run.rig import make_rig
from cageik_cli.store.result import read_binding, read_cages, read_poses, read_result
from cageik_cli.util.errors import FormatError
from cageik_cli.util.progress import ProgressListener
from tests.clips import frames_of
from tests.formats.gltf.decoded import Glb
from tests.shapes import finer

WALKER = Path(__file__).parents[2] / "data_fixtures" / "walker"
EXTRACT = ("extract", "frames", "--cage", "cage.obj", "-q", "--no-cache")
FEW = ("--fit", "--influences", "3")
TRANSLATE = ("--joints", "translate")
SINGLE = 1e-5
"""Of the diagonal: sums in single precision."""


# In test_skin_of_input.py they follow the input.
pytestmark = pytest.mark.usefixtures("input_elsewhere")


def skinned(path):
    """The mesh at each frame, (F, m, 3), by USD's own skinning."""
    stage = Usd.Stage.Open(str(path))
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetDefaultPrim()))
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/cage/mesh")).GetPointsAttr()
    times = np.arange(stage.GetStartTimeCode(), stage.GetEndTimeCode() + 1)
    return np.array([np.array(points.Get(time)) for time in times], float)


def skin_weights(path):
    """The weights, (m, K), and the joints that they are for."""
    stage = Usd.Stage.Open(str(path))
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath("/cage/mesh"))
    primvars = binding.GetJointWeightsPrimvar(), binding.GetJointIndicesPrimvar()
    count = primvars[0].GetElementSize()
    return [np.array(primvar.Get()).reshape(-1, count) for primvar in primvars]


def reconstructed(path="cages.h5"):
    """What the result itself gives, (F, m, 3), and the diagonal."""
    result = read_result(Path(path))
    binding = read_binding(result)
    (poses,) = read_poses(result, len(result.frames))
    return reconstruct_frames(binding, poses), result.rest.diagonal


def furthest(path):
    expected, diagonal = reconstructed()
    return np.linalg.norm(skinned(path) - expected, axis=2).max() / diagonal


def rig(count=None, joints="turn", compares=False, **changes):
    result = replace(read_result(Path("cages.h5")), **changes)
    binding = read_binding(result)
    target = Reconstruction(binding, CageFrames.from_result(result, binding))
    words = {"influences": count, "joints": joints, "name": "c.usdc", "compares": compares}
    return make_rig(result, target, ProgressListener(), is_shaded=True, **words)


def frames_in(path):
    """The frames of a file that `deform` wrote, (F, m, 3)."""
    return frames_of(open_sequence([str(path)]))


def test_few_influences_of_a_result_are_written_as_they_are(run, folder):
    assert run(*EXTRACT, *FEW).code == 0
    outcome = run("export", "cages.h5", "c.usdc", "--skeleton", *TRANSLATE)
    assert "the mesh moves as with the full weights" in " ".join(outcome.err.split())
    assert furthest("c.usdc") < SINGLE
    weights, joints = skin_weights("c.usdc")
    assert weights.shape == (18, 3)
    dense = np.zeros((18, 9))
    np.put_along_axis(dense, joints, weights, axis=1)
    held = read_binding(read_result(Path("cages.h5"))).weights
    np.testing.assert_allclose(dense[:, 1:], held, atol=1e-6)
    assert not dense[:, 0].any()  # the root moves no vertex itself


def test_as_many_influences_as_the_result_has_are_not_fitted_again(run, folder):
    assert run(*EXTRACT, *FEW).code == 0
    assert rig(3, "translate").message == rig(None, "translate").message
    assert rig(2, "translate").skin.weights.joints.shape == (18, 2)


@pytest.mark.parametrize("fit", [(), ("--fit",)])
@pytest.mark.parametrize("count", [1, 3, 8])
def test_weights_of_any_result_are_fitted_again(run, folder, fit, count):
    assert run(*EXTRACT, *fit).code == 0
    assert run("export", "cages.h5", "c.usdc", "--skeleton", "--influences", count).code == 0
    weights, _ = skin_weights("c.usdc")
    assert weights.shape[1] <= count
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
    error = rig(count)
    assert error.rms <= error.largest
    assert abs(100 * furthest("c.usdc") - error.largest) < 100 * SINGLE


def test_a_frame_that_was_skipped_has_a_pose(run, folder):
    Path("frames/frame_3.obj").write_text("v 1\n")
    assert run(*EXTRACT, *FEW, "--on-bad-frame", "skip").code == 0
    outcome = run("export", "cages.h5", "c.usdc", "--skeleton", *TRANSLATE)
    assert "1 of 5 frames skipped (frame_3.obj)" in outcome.err
    assert len(skinned("c.usdc")) == 5
    assert furthest("c.usdc") < SINGLE


def test_a_frame_that_was_skipped_is_not_fitted(run, folder):
    Path("frames/frame_1.obj").rename("rest.obj")
    Path("frames/frame_3.obj").write_text("v 1\n")
    assert run(*EXTRACT, "--rest", "rest.obj", "--on-bad-frame", "skip").code == 0
    assert run("export", "cages.h5", "c.usdc", "--skeleton", "--influences", 4).code == 0
    assert len(skinned("c.usdc")) == 4


def test_vertices_that_are_missing_data_follow_too(run, folder):
    Path("w.txt").write_text("0\n0\n" + "1\n" * 16)
    assert run(*EXTRACT, "--vertex-weights", "w.txt").code == 0
    assert run("export", "cages.h5", "c.usdc", "--skeleton", "--influences", 8).code == 0
    assert abs(100 * furthest("c.usdc") - rig(8).largest) < 100 * SINGLE


def test_far_from_the_origin_it_is_as_exact_as_single_precision(run, folder, animation, write_obj):
    far = np.array([3e4, -2e4, 1e4])
    for k, vertices in enumerate(animation.frames, start=1):
        write_obj(Path(f"frames/frame_{k}.obj"), vertices + far, animation.rest.faces)
    write_obj(Path("cage.obj"), animation.cage.vertices + far, animation.cage.faces)
    assert run(*EXTRACT, *FEW).code == 0
    assert run("export", "cages.h5", "c.usdc", "--skeleton", *TRANSLATE).code == 0
    expected, _ = reconstructed()
    assert np.abs(skinned("c.usdc") - expected).max() < 4e-7 * np.abs(expected).max()
    assert rig(None, "translate").largest < 1e-6


def test_the_same_result_gives_the_same_bytes_whatever_the_threads(run, folder, monkeypatch):
    assert run(*EXTRACT).code == 0
    for jobs in (1, 3):
        monkeypatch.setattr("cageik_cli.run.export.count_processors", lambda jobs=jobs: jobs)
        words = ("--skeleton", "--influences", 3)
        assert run("export", "cages.h5", f"{jobs}.usdc", *words).code == 0
    assert Path("1.usdc").read_bytes() == Path("3.usdc").read_bytes()


def test_more_influences_than_cage_vertices_are_refused(run, folder):
    assert run(*EXTRACT).code == 0
    words = ("export", "cages.h5", "c.usdc", "--skeleton"), ("deform", "cages.h5", "-o", "c.npz")
    for command in words:
        outcome = run(*command, "--influences", 9)
        assert outcome.code == 1
        assert "cages.h5: --influences 9, " in outcome.err


def test_settings_that_are_no_numbers_are_refused(run, folder):
    assert run(*EXTRACT).code == 0
    with pytest.raises(FormatError, match=r"cages.h5: attribute `settings`.*alpha"):
        rig(3, settings={"alpha": "much"})


def test_a_mesh_that_is_deformed_moves_as_the_skeleton_does(run, folder):
    assert run(*EXTRACT).code == 0
    words = ("--influences", 3)
    exported = run("export", "cages.h5", "c.usdc", "--skeleton", *words, "-v")
    outcome = run("deform", "cages.h5", "-o", "m.npz", *words, "-v")
    assert outcome.code == 0, outcome.err
    meshes, diagonal = frames_in("m.npz"), read_result(Path("cages.h5")).rest.diagonal
    assert np.abs(meshes - skinned("c.usdc")).max() < SINGLE * diagonal
    said = "up to 3 influences per vertex; it adds an rms of "
    (expected,) = [line.split(said)[1] for line in exported.err.splitlines() if said in line]
    added = expected.partition("; against the input")[0]
    assert f"m.npz: {said}{added} of the diagonal, against the full" in outcome.err
    assert "normals" not in outcome.err
    distances = np.linalg.norm(meshes - reconstructed()[0], axis=2)
    assert 100 * distances.max() / diagonal == pytest.approx(rig(3).largest, rel=1e-9)


def test_a_mesh_that_is_deformed_has_as_many_joints_as_the_skeleton(run, folder):
    assert run(*EXTRACT).code == 0
    words = ("--influences", 3, "--joints", 6)
    assert run("export", "cages.h5", "c.usdc", "--skeleton", *words).code == 0
    outcome = run("deform", "cages.h5", "-o", "m.npz", *words)
    assert "m.npz: 6 joints (root, 5 that move the mesh); up to 3" in " ".join(outcome.err.split())
    diagonal = read_result(Path("cages.h5")).rest.diagonal
    assert np.abs(frames_in("m.npz") - skinned("c.usdc")).max() < SINGLE * diagonal


def test_few_influences_of_a_result_deform_as_they_are(run, folder):
    assert run(*EXTRACT, *FEW).code == 0
    outcome = run("deform", "cages.h5", "-o", "m.npz", "--influences", 3, *TRANSLATE)
    assert "m.npz: up to 3 influences per vertex; the mesh moves as with the full" in outcome.err
    np.testing.assert_allclose(frames_in("m.npz"), reconstructed()[0], rtol=0, atol=1e-12)


def test_another_mesh_has_influences_of_its_own(run, folder, animation, write_obj):
    """They are fitted to its motion by its full weights, and nearer than a cut-off of these."""
    fine = finer(animation.rest, 1)
    write_obj(Path("fine.obj"), fine.vertices, fine.faces)
    assert run(*EXTRACT).code == 0
    words = ("deform", "cages.h5", "--mesh", "fine.obj", "--no-cache")
    assert run(*words, "-o", "full.npz").code == 0
    errors = []
    for count in (2, 8):
        outcome = run(*words, "--influences", count, "-o", f"{count}.npz")
        assert f"up to {count} influences per vertex; it adds an rms" in outcome.err
        distances = np.linalg.norm(frames_in(f"{count}.npz") - frames_in("full.npz"), axis=2)
        rms, largest = np.sqrt(np.mean(distances**2)), distances.max()
        percent = [f"{100 * value / fine.diagonal:.2g}" for value in (rms, largest)]
        assert f"rms of {percent[0]} %, largest {percent[1]} %" in outcome.err
        errors.append(rms)
    assert errors[1] < errors[0]


@pytest.mark.parametrize("fit", [(), FEW])
def test_the_results_own_cages_from_elsewhere_change_nothing(run, folder, fit):
    assert run(*EXTRACT, *fit).code == 0
    assert run("export", "cages.h5", "own.npz").code == 0
    words = ("deform", "cages.h5", "--influences", 2)
    assert run(*words, "-o", "m.npz").code == 0
    assert run(*words, "--cages", "own.npz", "-o", "same.npz").code == 0
    np.testing.assert_array_equal(frames_in("same.npz"), frames_in("m.npz"))


def test_cages_that_do_not_move_leave_the_mesh(run, folder, animation, write_obj):
    assert run(*EXTRACT).code == 0
    write_obj(Path("still/c_1.obj"), animation.cage.vertices, animation.cage.faces)
    words = ("deform", "cages.h5", "--cages", "still", "--influences", 2, "-o", "m.npz")
    assert "the mesh moves as with the full weights" in run(*words).err
    np.testing.assert_allclose(frames_in("m.npz")[0], animation.rest.vertices, rtol=0, atol=1e-9)


def test_deform_compares_influences_when_it_is_to_say_more(run, folder):
    assert run(*EXTRACT).code == 0
    outcome = run("deform", "cages.h5", "-o", "m.npz", "--influences", 3, "-v")
    (line,) = [line for line in outcome.err.splitlines() if line.startswith("  influences")]
    assert f"4: {rig(4).rms:.2g}, {rig(4).largest:.2g} %; 8: " in line
    (line,) = [line for line in outcome.err.splitlines() if line.startswith("  weights")]
    assert f"{rig(3).roughness:.2g} times as rough over the surface as the 3 largest of" in line
    outcome = run("deform", "cages.h5", "-o", "m.pc2", "-v")
    assert "influences" not in outcome.err


def test_few_points_need_the_laplacian_of_the_cage(run, folder, write_obj):
    points = np.random.default_rng(7).uniform(-1, 1, (6, 3))
    write_obj(Path("teeth.obj"), points, np.array([[0, 1, 2], [3, 4, 5]]))
    words = ("deform", "cages.h5", "--mesh", "teeth.obj", "--influences", 2, "-o", "m.npz")
    assert run(*EXTRACT, "--alpha", 0).code == 0
    outcome = run(*words)
    assert outcome.code == 1
    assert "few influences, with the alpha and beta of the result: the system is" in outcome.err
    assert not Path("m.npz").exists()
    assert run(*EXTRACT, "--overwrite").code == 0
    outcome = run(*words)
    assert outcome.code == 0, outcome.err
    assert frames_in("m.npz").shape == (5, 6, 3)


@pytest.mark.parametrize("count", [None, 8])
def test_projected_vertices_start_where_the_cage_has_them(run, folder, animation, write_obj, count):
    write_obj(Path("cage.obj"), 0.4 * animation.cage.vertices, animation.cage.faces)
    assert run(*EXTRACT, "--outside", "project").code == 0
    words = () if count is None else ("--influences", count)
    assert run("export", "cages.h5", "c.usdc", "--skeleton", *TRANSLATE, *words).code == 0
    assert furthest("c.usdc") < 0.02


@pytest.mark.parametrize("fit", [(), ("--fit",)])
def test_fewer_joints_move_as_the_rig_does(run, folder, fit):
    """Four influences are the default then; the note is what the file gives."""
    assert run(*EXTRACT, *fit).code == 0
    outcome = run("export", "cages.h5", "c.usdc", "--skeleton", "--joints", 6, "-v")
    assert outcome.code == 0, outcome.err
    note = " ".join(outcome.err.split())
    assert "6 joints (root, 5 that move the mesh); up to 4 influences per vertex" in note
    assert "6 joints that move 18 vertices" in note
    weights, joints = skin_weights("c.usdc")
    assert weights.shape[1] <= 4
    assert set(joints[weights > 0]) <= set(range(1, 6))
    few = rig(None, joints=6)
    assert abs(100 * furthest("c.usdc") - few.largest) < 100 * SINGLE
    assert few.rms > rig(4).rms
    stage = Usd.Stage.Open("c.usdc")
    cage = stage.GetPrimAtPath("/cage/skeleton").GetCustomDataByKey("cage")
    assert sorted(" ".join(cage).split()) == [f"cage_00{k}" for k in range(8)]


def test_joints_are_compared_by_their_number(run, folder, animation, write_obj):
    """Half and a quarter of the 26 vertices of the cage, with no more influences than joints."""
    cage = finer(animation.cage, 1)
    write_obj(folder / "cage.obj", cage.vertices, cage.faces)
    assert run(*EXTRACT).code == 0
    words = ("export", "cages.h5", "c.glb", "--skeleton", "--joints", 12, "-v")
    lines = [line for line in run(*words).err.splitlines() if line.startswith("  joints")]
    starts = [f"{count} joints, {k} influences: " for count, k in ((13, 4), (13, 8), (6, 4))]
    assert len(lines) == len(starts)
    for line, expected in zip(lines, starts, strict=True):
        assert expected in line
        assert "degrees off, about " in line


@pytest.mark.parametrize("suffix", [".usdc", ".glb"])
def test_a_skeleton_of_any_format_moves_as_the_rig(run, folder, suffix):
    assert run(*EXTRACT).code == 0
    outcome = run("export", "cages.h5", f"c{suffix}", "--skeleton", "--influences", 3)
    assert outcome.code == 0, outcome.err
    expected = np.concatenate([block.meshes for block in rig(3).blocks()])
    if suffix == ".glb":
        found = np.array([Glb(Path("c.glb")).skinned(k) for k in range(len(expected))])
    else:
        found = skinned("c.usdc")
    np.testing.assert_allclose(found, expected, rtol=0, atol=SINGLE)


def test_joints_are_posed_as_they_are_written(run, folder, monkeypatch):
    """Only those of one block of frames are held, where all would take too much."""
    assert run(*EXTRACT).code == 0
    monkeypatch.setattr(rigs, "FRAMES_PER_RIG_BLOCK", 2)
    monkeypatch.setattr(rigs, "MAX_HELD_BYTES", 0)
    made, counts = rig(3), []

    def blocks():
        for block in made.blocks():
            counts.append(len(block.cages))
            yield block

    skin, places = replace(made, blocks=blocks).stream(turns=True)
    turns = iter(skin.turns)
    for k, expected in enumerate(made.blocks()):
        assert len(counts) == k
        np.testing.assert_array_equal(next(places), expected.cages)
        for turned in expected.turns:
            np.testing.assert_array_equal(next(turns), turned)
    assert counts == [2, 2, 1]


@pytest.mark.parametrize("joints", ["turn", "translate"])
def test_joints_that_take_little_are_posed_once(run, folder, monkeypatch, joints):
    assert run(*EXTRACT).code == 0
    monkeypatch.setattr(rigs, "FRAMES_PER_RIG_BLOCK", 2)
    made = rig(3, joints)
    skin, places = replace(made, blocks=None).stream(turns=joints == "turn")
    blocks = list(made.blocks())
    for block, found in zip(blocks, places, strict=True):
        np.testing.assert_array_equal(found, block.cages)
    if joints == "turn":
        expected = np.concatenate([block.turns for block in blocks])
        np.testing.assert_array_equal(np.stack(list(skin.turns)), expected)


def test_rigs_that_are_compared_are_held_one_at_a_time(run, folder, monkeypatch):
    assert run(*EXTRACT).code == 0
    held, counts, fit = [], [], rigs._measure_rig

    def measure(*given, **named):
        gc.collect()
        counts.append(sum(each() is not None for each in held))
        made = fit(*given, **named)
        held.append(weakref.ref(made.skin.rotations))
        return made

    monkeypatch.setattr(rigs, "_measure_rig", measure)
    rig(3, compares=True)
    assert counts == [0, 1, 1]


@pytest.mark.parametrize("is_flat", [False, True])
def test_the_stated_angles_are_those_of_the_file(run, folder, animation, write_obj, is_flat):
    """Of its normals, as programs turn them, from those of the reconstruction."""
    if is_flat:  # each face has its own corners
        corners = animation.rest.faces.ravel()
        for k, vertices in enumerate(animation.frames, start=1):
            faces = np.arange(len(corners)).reshape(-1, 3)
            write_obj(Path(f"frames/frame_{k}.obj"), vertices[corners], faces)
    assert run(*EXTRACT).code == 0
    assert run("export", "cages.h5", "c.glb", "--skeleton", "--influences", 3).code == 0
    rest, (expected, _) = read_result(Path("cages.h5")).rest, reconstructed()
    angles = []
    for k, frame in enumerate(expected):
        shaded = Glb(Path("c.glb")).skinned(k, "NORMAL")
        shaded /= np.linalg.norm(shaded, axis=1, keepdims=True)
        cosines = (shaded * compute_vertex_normals(rest.polygons, frame)).sum(axis=1)
        angles.append(np.degrees(np.arccos(cosines.clip(-1, 1))))
    found = rig(3)
    assert found.angles[0] == pytest.approx(np.sqrt(np.mean(np.square(angles))), rel=1e-3)
    assert found.angles[1] == pytest.approx(
        np.percentile(angles, 99, method="inverted_cdf"), abs=0.1
    )


def test_a_surface_in_both_windings_has_no_normals_to_speak_of(run, folder, animation, write_obj):
    faces = np.vstack([animation.rest.faces, animation.rest.faces[:, ::-1]])
    for k, vertices in enumerate(animation.frames, start=1):
        write_obj(Path(f"frames/frame_{k}.obj"), vertices, faces)
    assert run(*EXTRACT).code == 0
    outcome = run("export", "cages.h5", "c.glb", "--skeleton", "--influences", 3)
    assert "up to 3 influences per vertex" in outcome.err
    assert "degrees" not in outcome.err
    assert rig(3).angles is None


@pytest.mark.parametrize("words", [(), ("--influences", 3)])
def test_a_clip_of_one_frame_is_at_rest(run, folder, words):
    assert run("extract", "frames/frame_1.obj", *EXTRACT[2:], "--no-fit").code == 0
    outcome = run("export", "cages.h5", "c.usdc", "--skeleton", *words)
    assert "moves as with the full weights; normals are 0 degrees off" in " ".join(
        outcome.err.split()
    )
    assert furthest("c.usdc") < SINGLE


@pytest.mark.slow
def test_fitting_again_is_far_better_than_cutting_off(run, folder):
    words = ("extract", WALKER / "frames", "--cage", WALKER / "cage.obj", "-o", "cages.h5")
    assert run(*words, "-q", "--no-cache", "--frames", "0:48:2").code == 0
    result = read_result(Path("cages.h5"))
    weights = read_binding(result).weights.copy()
    least = np.argsort(-weights, axis=1)[:, 4:]
    np.put_along_axis(weights, least, 0, axis=1)
    weights /= weights.sum(axis=1, keepdims=True)
    cages = np.concatenate(list(read_cages(result, 50)))
    expected, diagonal = reconstructed()
    moved = result.rest.vertices + weights @ (cages - result.cage.vertices)
    cut_off = 100 * np.sqrt(np.square(moved - expected).sum(axis=2).mean()) / diagonal
    errors = [rig(count).rms for count in (4, 8)]
    assert errors[1] < errors[0] < cut_off / 3


SKINS = {
    "joints that turn": ("--influences", "3"),
    "joints that translate": ("--influences", "3", "--joints", "translate"),
    "merged joints": ("--joints", "4"),
    "the weights of the result": (),
}


def refuse_to_fit(monkeypatch):
    """Let fits and poses fail; what the cache holds needs none."""
    for name in ("limit_influences", "_measure_rig"):
        monkeypatch.setattr(rigs, name, lambda *_, **__: pytest.fail("fitted or posed again"))


@pytest.mark.parametrize("skin", SKINS)
def test_another_format_fits_nothing_again_and_is_written_the_same(run, folder, monkeypatch, skin):
    assert run(*EXTRACT).code == 0
    words = ("export", "cages.h5", "--skeleton", *SKINS[skin])
    for suffix in ("usdc", "glb"):
        assert run(*words, f"cold.{suffix}", "--no-cache").code == 0
    assert run(*words, "first.usdc", "--cache", "kept").code == 0
    assert [path.suffix for path in Path("kept").iterdir()] == [".rig"]
    refuse_to_fit(monkeypatch)
    for suffix in ("usdc", "glb"):
        assert run(*words, f"cached.{suffix}", "--cache", "kept").code == 0
        assert Path(f"cached.{suffix}").read_bytes() == Path(f"cold.{suffix}").read_bytes()


def test_a_rig_of_a_clip_with_seams_is_kept_with_its_welded_rows(
    run, folder, animation, write_obj, monkeypatch
):
    """Each corner of the first faces is a vertex of its own."""
    faces = animation.rest.faces.copy()
    origins = np.concatenate([np.arange(18), faces[:6].ravel()])
    faces[:6] = 18 + np.arange(18).reshape(6, 3)
    for k, vertices in enumerate(animation.frames, start=1):
        write_obj(Path(f"frames/frame_{k}.obj"), vertices[origins], faces)
    assert run(*EXTRACT).code == 0
    words = ("export", "cages.h5", "--skeleton", "--influences", 3)
    for suffix in ("usdc", "glb"):
        assert run(*words, f"cold.{suffix}", "--no-cache").code == 0
    assert run(*words, "first.usdc", "--cache", "kept").code == 0
    refuse_to_fit(monkeypatch)
    for suffix in ("usdc", "glb"):
        assert run(*words, f"cached.{suffix}", "--cache", "kept").code == 0
        assert Path(f"cached.{suffix}").read_bytes() == Path(f"cold.{suffix}").read_bytes()


def test_joints_that_are_not_held_are_posed_again_from_the_cache(run, folder, monkeypatch):
    assert run(*EXTRACT).code == 0
    words = ("export", "cages.h5", "--skeleton", "--influences", 3)
    monkeypatch.setattr(rigs, "FRAMES_PER_RIG_BLOCK", 2)
    assert run(*words, "held.glb", "--no-cache").code == 0
    words = (*words, "--cache", "kept")
    monkeypatch.setattr(rigs, "MAX_HELD_BYTES", 0)
    assert run(*words, "first.glb").code == 0
    refuse_to_fit(monkeypatch)
    assert run(*words, "second.glb").code == 0
    contents = {Path(f"{name}.glb").read_bytes() for name in ("held", "first", "second")}
    assert len(contents) == 1


def test_a_mesh_is_moved_by_the_rig_in_the_cache(run, folder, monkeypatch):
    assert run(*EXTRACT).code == 0
    words = ("deform", "cages.h5", "--influences", 3)
    assert run(*words, "-o", "cold.npz", "--no-cache").code == 0
    assert run(*words, "-o", "first.npz", "--cache", "kept").code == 0
    refuse_to_fit(monkeypatch)
    assert run(*words, "-o", "cached.npz", "--cache", "kept").code == 0
    np.testing.assert_array_equal(frames_in("cached.npz"), frames_in("cold.npz"))


@pytest.mark.parametrize("change", [("2",), ("3", "--joints", "4"), ("3", "--joints", "translate")])
def test_other_settings_are_another_rig(run, folder, change):
    assert run(*EXTRACT).code == 0
    words = ("export", "cages.h5", "--skeleton", "--cache", "kept", "--influences")
    assert run(*words, "3", "a.glb").code == 0
    assert run(*words, *change, "b.glb").code == 0
    assert len(list(Path("kept").iterdir())) == 2


def test_other_cages_are_another_rig(run, folder):
    assert run(*EXTRACT).code == 0
    words = ("export", "cages.h5", "--skeleton", "--cache", "kept", "--influences", 3)
    assert run(*words, "a.glb").code == 0
    assert run(*EXTRACT, "--alpha", 0.1, "--overwrite").code == 0
    assert run(*words, "b.glb").code == 0
    assert len(list(Path("kept").iterdir())) == 2


def test_a_damaged_rig_is_fitted_again(run, folder):
    assert run(*EXTRACT).code == 0
    words = ("export", "cages.h5", "--skeleton", "--cache", "kept", "--influences", 3)
    assert run(*words, "a.glb").code == 0
    (kept,) = Path("kept").iterdir()
    kept.write_bytes(kept.read_bytes()[:-1] + b"\1")
    outcome = run(*words, "b.glb", "-v")
    assert "is damaged; it is deleted and the skin is computed" in " ".join(outcome.err.split())
    assert Path("b.glb").read_bytes() == Path("a.glb").read_bytes()


def test_seconds_of_the_fit_and_of_the_poses_are_told_apart(run, folder):
    assert run(*EXTRACT).code == 0
    words = ("export", "cages.h5", "--skeleton", "--influences", 3, "--no-cache")
    assert "seconds" not in run(*words, "a.glb").err
    outcome = run(*words, "b.glb", "-v")
    (line,) = (line for line in outcome.err.splitlines() if line.split()[:1] == ["seconds"])
    assert all(f"{name} 0." in line for name in ("fit", "pose", "export"))


@pytest.fixture
def crushed_clip(folder, animation, write_obj):
    """A clip pressed to a thread, which noise turns and mirrors: joints jump."""
    noise = np.random.default_rng(0).normal(0, 0.03, (5, *animation.rest.vertices.shape))
    frames = animation.rest.vertices * [0.1, 0.1, 1] + noise
    write_obj(Path("rest.obj"), animation.rest.vertices, animation.rest.faces)
    for k, vertices in enumerate(frames, start=1):
        write_obj(Path(f"frames/frame_{k}.obj"), vertices, animation.rest.faces)


def joint_steps(path):
    """Degrees by which joints turn from frame to frame, by USD, (F - 1, n), and their names."""
    stage = Usd.Stage.Open(str(path))
    skeleton = next(prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Skeleton))
    query = UsdSkel.Cache().GetSkelQuery(UsdSkel.Skeleton(skeleton))
    times = np.arange(stage.GetStartTimeCode(), stage.GetEndTimeCode() + 1)
    matrices = np.array([np.array(query.ComputeJointSkelTransforms(time)) for time in times])
    turns = matrices[:, :, :3, :3]
    traces = np.einsum("fnab,fnab->fn", turns[1:], turns[:-1])
    names = [name.rpartition("/")[2] for name in query.GetJointOrder()]
    return np.degrees(np.arccos(((traces - 1) / 2).clip(-1, 1))), names


def export_crushed(run, path):
    """The joints that a note says jump, and the frames of each that it names."""
    assert run(*EXTRACT, "--rest", "rest.obj", "--overwrite").code == 0
    words = ("export", "cages.h5", path, "--skeleton", "--influences", 8, "--cache", "kept", "-v")
    outcome = run(*words, "--overwrite")
    assert outcome.code == 0
    message = " ".join(outcome.err.split())
    found = re.findall(r" (\d+) joints? turns? by more than 60 degrees.* not: (.*?); p", message)
    return [(int(count), re.findall(r"(\w+) \((.*?)\)", text)) for count, text in found]


def test_joints_of_a_crushed_clip_do_not_jump(run, crushed_clip):
    assert export_crushed(run, "c.usdc") == []


@pytest.mark.parametrize("held", [1 << 27, 0])
def test_joints_that_jump_are_named_with_their_frames(run, crushed_clip, monkeypatch, held):
    """Also out of the cache; they turn so far in the file."""
    monkeypatch.setattr("cageik_cli.rigs.jumps.MAX_SMOOTHINGS", 0)
    monkeypatch.setattr(rigs, "MAX_HELD_BYTES", held)
    monkeypatch.setattr(rigs, "FRAMES_PER_RIG_BLOCK", 2)
    for path in ("first.usdc", "second.usdc"):
        ((count, joints),) = export_crushed(run, path)
        steps, names = joint_steps(path)
        assert 0 < count <= (steps > 60).any(axis=0).sum()
        assert len(joints) == min(count, 3)
        for joint, frames in joints:
            jumps = re.findall(r"frame_(\d)\.obj", frames)
            assert jumps
            for number in map(int, jumps):
                assert steps[number - 2, names.index(joint)] > 60  # the first frame has number 1
        monkeypatch.setattr(rigs, "limit_influences", lambda *_, **__: pytest.fail("fitted again"))
