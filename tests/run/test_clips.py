"""One skeleton with the motions of several results."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdSkel
from scipy.spatial.transform import Rotation

from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.usd.library import capture_diagnostics
from cageik_cli.formats.usd.motion import MotionWriter
from cageik_cli.run import rig
from cageik_cli.store.result import read_result
from cageik_cli.util.arrays import cut_blocks
from tests.clips import frames_of
from tests.formats.clips import faults_of
from tests.formats.gltf.evaluated import Evaluated

SOLVE = ("--cage", "cage.obj", "--rest", "frames/frame_1.obj", "-q", "--no-cache")
EXPORT = ("export", "walk.h5", "run.h5", "hop.h5")
SKELETON = ("--skeleton", "--influences", "3", "--no-cache")
CLIPS = {"walk": (5, 24, 1), "run": (3, 30, 1), "hop": (4, 12, 8)}
"""Frames, their rate, and the number of the first of them."""


@pytest.fixture
def results(run, folder, animation):
    """Results of three clips, of one rest pose and cage; the second turns around."""
    frames, faces = np.stack(animation.frames), animation.rest.faces
    turns = Rotation.from_rotvec(np.outer([0, 2.5, 5], [0, 1, 0])).as_matrix()
    run_frames = frames[[2, 0, 4]] @ turns + [[[0, 0, 1.0]], [[0, 0, 2.0]], [[0, 0, 3.0]]]
    np.savez("run.npz", vertices=run_frames, faces=faces, fps=30.0)
    hop = frames[[1, 1, 3, 2]] * [1, 1.1, 1]
    np.savez("hop.npz", vertices=hop, faces=faces, fps=12.0, start=8.0)
    for clip, name in (("frames", "walk"), ("run.npz", "run"), ("hop.npz", "hop")):
        assert run("extract", clip, *SOLVE, "-o", f"{name}.h5").code == 0
    return folder


def said(outcome):
    assert outcome.code == 0, outcome.err
    return " ".join(outcome.err.split())


def frames_of_clip(name):
    return frames_of(open_sequence(["frames" if name == "walk" else f"{name}.npz"]))


def list_errors(name, found):
    """The distances of corners of the triangles (F, k, 3) from those of a clip, in percent."""
    faces, diagonal = read_result(Path("walk.h5")).rest.faces, 0.01
    diagonal *= read_result(Path("walk.h5")).rest.diagonal
    expected = frames_of_clip(name)[:, faces.ravel()]
    return np.linalg.norm(found - expected, axis=2) / diagonal


def weigh(errors):
    """The rms over vertices of errors at corners (F, k), and the largest of them."""
    faces = read_result(Path("walk.h5")).rest.faces.ravel()
    firsts = np.unique(faces, return_index=True)[1]
    return np.sqrt(np.square(errors[:, firsts]).mean()), errors.max()


def evaluate(path, number):
    """The corners of the triangles in all frames of an animation, by the specification."""
    file = Evaluated(Path(path))
    (node,) = (k for k, each in enumerate(file.json["nodes"]) if "mesh" in each)
    clip = file.json["animations"][number]
    keys = max((file.rows(s["input"]) for s in clip["samplers"]), key=len)
    (rate,) = clip["extras"].values()
    times = np.arange(round(keys[-1][0] * rate[0] / rate[1]) + 1) * rate[1] / rate[0]
    return np.array([file.triangles(node, time, number) for time in times])


@pytest.mark.parametrize("more", [(), ("--joints", "5"), ("--root-motion", "extract")])
def test_each_clip_is_an_animation_as_far_off_as_is_said(run, results, more):
    text = said(run(*EXPORT, "-v", "hero.glb", *SKELETON, *more))
    animations = Evaluated(Path("hero.glb")).json["animations"]
    assert [each["name"] for each in animations] == list(CLIPS)
    for number, (name, (count, fps, start)) in enumerate(CLIPS.items()):
        (rate,) = animations[number]["extras"].values()
        assert rate == [fps, 1, start]
        errors = list_errors(name, evaluate("hero.glb", number))
        assert len(errors) == count
        rms, largest = weigh(errors)
        stated = f"an rms of {rms:.2g} %, largest {largest:.2g} %"
        assert f"clip {name}: {count} frames, {fps} fps; against the input, {stated}" in text
        assert largest < 10


def test_keys_and_rounding_of_each_clip_are_stated(run, results):
    small = ("--tolerance", "0.5", "--quantize")
    text = said(run(*EXPORT, "-v", "hero.glb", *SKELETON, *small))
    for number, name in enumerate(CLIPS):
        (stated,) = (each for each in text.split("note ") if each.startswith(f"hero.glb: {name}: "))
        bound = float(stated.rpartition("at most ")[2].split(" %")[0])
        rms = weigh(list_errors(name, evaluate("hero.glb", number)))[0]
        assert 0.5 * bound < rms <= bound * 1.05  # of two digits


def test_every_animation_is_read_back(run, results):
    said(run(*EXPORT, "hero.glb", *SKELETON))
    assert [line.split()[1] for line in run("info", "hero.glb").out.splitlines()[2:]] == list(CLIPS)
    for number, (name, (count, fps, start)) in enumerate(CLIPS.items()):
        clip = open_sequence([f"hero.glb::{name}"])
        assert (len(clip), clip.scene.fps, clip.scene.start) == (count, fps, start)
        corners = frames_of(clip)[:, clip.first.faces.ravel()]
        np.testing.assert_allclose(corners, evaluate("hero.glb", number), rtol=0, atol=1e-5)


def list_keys(path, number):
    """The values of all keys of an animation, track by track."""
    file = Evaluated(Path(path))
    return [file.rows(each["output"]) for each in file.json["animations"][number]["samplers"]]


def test_a_clip_is_written_as_if_it_was_alone(run, results):
    """Nothing of it depends on those before, but the weights that are fitted to all."""
    kept = ("--skeleton", "--joints", "translate", "--root-motion", "extract", "--no-cache", "-q")
    assert run(*EXPORT, "hero.glb", *kept).code == 0
    assert run("export", "hop.h5", "hop.glb", *kept).code == 0
    assert list_keys("hero.glb", 2) == list_keys("hop.glb", 0)
    assert [each["name"] for each in Evaluated(Path("hop.glb")).json["animations"]] == ["cage"]


def test_the_skin_follows_the_cages_if_an_input_is_gone(run, results):
    Path("run.npz").unlink()
    text = said(run(*EXPORT, "-v", "hero.glb", *SKELETON))
    assert "put the input of run.h5 beside it" in text
    assert text.count("it adds an rms of") == 4
    assert text.count("against the input, the rms is at most") == 4


def skin(path):
    """The range of a USD file, its rate, and the mesh in all frames, by USD's own skinning."""
    stage = Usd.Stage.Open(path)
    (motion,) = (prim.GetName() for prim in stage.Traverse() if prim.IsA(UsdSkel.Animation))
    assert Path(path).stem.endswith(f"_{motion}")  # after which Blender names the action
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetDefaultPrim()))
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/cage/mesh")).GetPointsAttr()
    first, last = int(stage.GetStartTimeCode()), int(stage.GetEndTimeCode())
    frames = [np.array(points.Get(time), float) for time in range(first, last + 1)]
    return (first, stage.GetTimeCodesPerSecond()), np.array(frames)


@pytest.mark.parametrize("suffix", [".usdc", ".usda"])
def test_each_clip_is_a_file_over_that_of_the_skeleton(run, results, suffix):
    text = said(run(*EXPORT, "-v", f"hero{suffix}", *SKELETON))
    assert f"hero_walk{suffix}, hero_run{suffix}, hero_hop{suffix}" in text
    faces = read_result(Path("walk.h5")).rest.faces.ravel()
    for name, (count, fps, start) in CLIPS.items():
        time, frames = skin(f"hero_{name}{suffix}")
        assert (time, len(frames)) == ((start, fps), count)
        rms, largest = weigh(list_errors(name, frames[:, faces]))
        assert f"clip {name}: {count} frames, {fps} fps; against the input, " in text
        assert f"an rms of {rms:.2g} %, largest {largest:.2g} %" in text
        clip = open_sequence([f"hero_{name}{suffix}"])
        assert clip.scene.fps == fps
        np.testing.assert_allclose(frames_of(clip), frames, rtol=0, atol=1e-5)
        assert not faults_of(f"hero_{name}{suffix}")
        layer = Sdf.Layer.FindOrOpen(f"hero_{name}{suffix}")
        assert list(layer.subLayerPaths) == [f"./hero{suffix}"]
        assert not layer.GetPrimAtPath("/cage/mesh")  # it is in the layer below


def test_the_file_of_the_skeleton_is_at_rest(run, results):
    said(run(*EXPORT, "hero.usdc", *SKELETON))
    stage = Usd.Stage.Open("hero.usdc")
    assert not stage.HasAuthoredTimeCodeRange()
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath("/cage/skeleton"))
    assert not binding.GetAnimationSourceRel().HasAuthoredTargets()
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/cage/mesh"))
    rest = read_result(Path("walk.h5")).rest
    np.testing.assert_allclose(mesh.GetPointsAttr().Get(), rest.vertices, rtol=0, atol=1e-6)


def test_files_of_clips_are_converted_and_moved_together(run, results):
    words = ("--to", "cm,z", "--recentre")
    said(run(*EXPORT, "hero.usdc", *SKELETON, *words))
    with capture_diagnostics(OSError):
        for name in CLIPS:
            stage = Usd.Stage.Open(f"hero_{name}.usdc")
            assert UsdGeom.GetStageUpAxis(stage) == "Z"
            assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    said(run(*EXPORT, "plain.usdc", *SKELETON))
    plain, turned = skin("plain_run.usdc")[1], skin("hero_run.usdc")[1]
    moved = 100 * plain[..., [0, 2, 1]] * [1, -1, 1]
    offsets = (turned - moved).reshape(-1, 3)
    np.testing.assert_allclose(offsets, np.tile(offsets[0], (len(offsets), 1)), atol=2e-3)


def test_a_skeleton_that_is_held_open_is_read_as_it_is_now(run, results):
    """Its file has other joints than the one that was written, and opened, before."""
    said(run(*EXPORT, "hero.usdc", *SKELETON, "--joints", "5"))
    held = Usd.Stage.Open("hero.usdc")
    assert held.GetPrimAtPath("/cage/skeleton")
    said(run(*EXPORT, "hero.usdc", *SKELETON, "--overwrite"))
    layer = Sdf.Layer.OpenAsAnonymous("hero_run.usdc")
    joints = layer.GetAttributeAtPath("/cage/skeleton/run.joints").default
    rest = Sdf.Layer.OpenAsAnonymous("hero.usdc")
    assert list(joints) == list(rest.GetAttributeAtPath("/cage/skeleton.joints").default)


def test_an_export_that_fails_says_which_files_are_written(run, results, monkeypatch):
    complete = MotionWriter.complete

    def fail_at_second(writer):
        if "run" in writer._target.name:
            raise OSError("the disk is full")
        complete(writer)

    monkeypatch.setattr(MotionWriter, "complete", fail_at_second)
    outcome = run(*EXPORT, "hero.usdc", *SKELETON)
    assert outcome.code == 1
    text = "hero.usdc, hero_walk.usdc are written, hero_run.usdc, hero_hop.usdc not; write all"
    assert text in " ".join(outcome.err.split())
    assert "--overwrite" in outcome.err
    assert {path.name for path in Path().glob("hero*")} == {"hero.usdc", "hero_walk.usdc"}


def test_files_of_clips_are_not_replaced_unasked(run, results):
    Path("hero_run.usdc").write_text("mine")
    outcome = run(*EXPORT, "hero.usdc", *SKELETON)
    assert outcome.code == 1
    assert "hero_run.usdc" in outcome.err
    assert not Path("hero.usdc").exists()
    assert run(*EXPORT, "hero.usdc", *SKELETON, "--overwrite", "-q").code == 0


def test_results_that_share_nothing_are_refused_with_commands_that_work(run, results):
    others = ("--cage", "cage.obj", "-q", "--overwrite", "-o", "hop.h5")
    assert run("extract", "hop.npz", *others).code == 0  # its first frame is the rest pose
    outcome = run(*EXPORT, "hero.glb", *SKELETON)
    assert outcome.code == 1
    assert "hop.h5: has another rest pose than walk.h5" in outcome.err
    advice = " ".join(outcome.err.split()).partition("clips by ")[2]
    bind, _, extracts = advice.partition(", then extract each again by ")
    assert "--fit 'frame_*.obj' --fit run.npz --fit hop.npz" in bind
    for command in (bind, *extracts.split(", ")):
        words = shlex.split(command.replace("'frame_*.obj'", "'frames/frame_*.obj'"))
        assert words.pop(0) == "cageik"
        assert run(*words).code == 0
    text = said(run(*EXPORT, "-v", "hero.glb", *SKELETON))
    assert text.count("against the input, an rms of") == 4


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("--cage", "big.obj"), "another cage"),
        (("--cage", "cage.obj", "--fit"), "other weights"),
        (("--cage", "cage.obj", "--up-axis", "Z"), "another up axis or unit"),
    ],
)
def test_what_differs_is_said(run, results, write_obj, animation, words, what):
    write_obj(Path("big.obj"), 1.1 * animation.cage.vertices, animation.cage.faces)
    rest = ("--rest", "frames/frame_1.obj", "-q", "--overwrite", "-o", "hop.h5")
    assert run("extract", "hop.npz", *rest, *words).code == 0
    outcome = run(*EXPORT, "hero.glb", *SKELETON)
    assert outcome.code == 1
    assert f"hop.h5: has {what} than walk.h5" in outcome.err


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("hero.npz",), "--skeleton"),
        (("hero.usdc", *SKELETON, "--with-model"), "--with-model"),
        (("hero.usdz", *SKELETON), ".usdc"),
        (("walk.h5", "hero.glb", *SKELETON), "walk.h5: is named twice"),
    ],
)
def test_what_holds_one_result_takes_no_more(run, results, words, named):
    outcome = run(*EXPORT, *words)
    assert outcome.code in (1, 2)
    assert named in outcome.err


def test_names_are_those_of_clips_in_a_file_or_of_results(run, results):
    """The animations of a file have names; those of results with one source differ by a number."""
    said(run(*EXPORT, "hero.glb", *SKELETON))
    for name, result in (("walk", "a"), ("run", "b"), ("run", "c")):
        rest = ("--rest", "hero.glb::walk", "--cage", "cage.obj", "-q")
        assert run("extract", f"hero.glb::{name}", *rest, "-o", f"{result}.h5").code == 0
    said(run("export", "a.h5", "b.h5", "c.h5", "again.glb", *SKELETON))
    animations = Evaluated(Path("again.glb")).json["animations"]
    assert [each["name"] for each in animations] == ["walk", "run", "run_2"]


def test_joints_are_smooth_within_each_clip_only(run, results, monkeypatch):
    follow, counts = rig.follow_frames, []

    def count(joints, blocks):
        posed = list(follow(joints, blocks))
        counts.append(sum(len(block.rotations) for block in posed))
        return iter(posed)

    monkeypatch.setattr(rig, "follow_frames", count)
    said(run(*EXPORT, "hero.glb", *SKELETON))
    assert counts[:3] == [5, 3, 4]


def test_blocks_are_cut_where_clips_end():
    frames = np.arange(30.0).reshape(10, 1, 3)
    for size in (1, 3, 4, 10):
        blocks = iter([frames[k : k + size] for k in range(0, 10, size)])
        found = [np.concatenate(list(own)) for own in cut_blocks(blocks, [2, 5, 3])]
        np.testing.assert_array_equal(np.concatenate(found), frames)
        assert [len(each) for each in found] == [2, 5, 3]
