"""Skins that follow the input of a result, where that is still to be found."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.formats.open import open_sequence
from cageik_cli.inputs import input_frames
from cageik_cli.inputs.caged_model import CagedModel
from cageik_cli.inputs.input_frames import find_input
from cageik_cli.run import rig as rigs
from cageik_cli.store.result import read_result
from tests.clips import frames_of
from tests.formats.test_keyed_motion import Turntable
from tests.run.test_rig import EXTRACT, SINGLE, skinned

EXPORT = ("export", "cages.h5", "c.usdc", "--skeleton", "--overwrite")
FEW = ("--influences", 3)
FOLLOWS_CAGES = "the skin follows what the cages give; put the input of cages.h5 beside it"


def find():
    result = read_result(Path("cages.h5"))
    caged = CagedModel.of_file(result.path, result)
    return find_input(result, caged.read_reconstruction("a skeleton"))


def write_npz(animation):
    np.savez("clip.npz", vertices=np.stack(animation.frames), faces=animation.rest.faces)


def said(outcome):
    assert outcome.code == 0, outcome.err
    return " ".join(outcome.err.split())


def distances():
    """Of the skin that was written, by USD's own skinning, from the input, in percent."""
    frames, result = frames_of(open_sequence(["frames"])), read_result(Path("cages.h5"))
    return 100 * np.linalg.norm(skinned("c.usdc") - frames, axis=2) / result.rest.diagonal


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


@pytest.mark.parametrize("words", [(), FEW, ("--joints", 5), (*FEW, "--joints", "translate")])
def test_the_stated_error_is_that_from_the_input(run, folder, words):
    assert run(*EXTRACT).code == 0
    text = said(run(*EXPORT, *words))
    found = distances()
    stated = f"an rms of {rms(found):.2g} %, largest {found.max():.2g} % of the diagonal"
    assert f"against the input, {stated}" in text
    assert FOLLOWS_CAGES not in text


def test_it_is_nearer_to_the_input_than_what_follows_the_cages(run, folder):
    assert run(*EXTRACT).code == 0
    said(run(*EXPORT, *FEW))
    near = rms(distances())
    Path("frames").rename(Path("..") / "away")
    assert FOLLOWS_CAGES in said(run(*EXPORT, *FEW))
    (Path("..") / "away").rename("frames")
    assert near < 0.8 * rms(distances())


def test_weights_as_they_are_need_no_input(run, folder):
    assert run(*EXTRACT).code == 0
    text = said(run(*EXPORT, "--joints", "translate"))
    assert "the mesh moves as with the full weights" in text
    assert FOLLOWS_CAGES not in text


def test_frames_that_have_changed_are_not_the_input(run, folder, animation, write_obj):
    assert run(*EXTRACT).code == 0
    write_obj(Path("frames/frame_2.obj"), animation.frames[1] + 0.001, animation.rest.faces)
    assert FOLLOWS_CAGES in said(run(*EXPORT, *FEW))


def test_frames_that_are_not_as_far_as_recorded_are_not_the_input(run, folder):
    assert run(*EXTRACT).code == 0
    result = read_result(Path("cages.h5"))
    target = CagedModel.of_file(result.path, result).read_reconstruction("a skeleton")
    assert find_input(result, target) is not None
    metrics = replace(result.metrics, rms=2 * result.metrics.rms)
    assert find_input(replace(result, metrics=metrics), target) is None


def test_a_damaged_file_of_the_name_is_not_the_input(run, folder, animation):
    write_npz(animation)
    assert run("extract", "clip.npz", *EXTRACT[2:]).code == 0
    assert find() is not None
    Path("clip.npz").write_bytes(b"PK damaged")
    assert find() is None
    Path("clip.npz").unlink()
    assert find() is None


def test_keys_that_were_sampled_at_another_rate_are_sampled_so_again(run, folder):
    archive = Turntable(folder, fps=24)
    archive.turn([0, 90], [0.0, 1.0])
    archive.close()
    assert run("extract", "clip.abc", *EXTRACT[2:], "--fps", 6).code == 0
    result = read_result(Path("cages.h5"))
    assert (len(result.frames), result.scene.fps, result.scene.frame_step) == (7, 6, 1)
    found = find()
    np.testing.assert_allclose(
        found.read_frame(3), frames_of(open_sequence(["clip.abc"]))[12], atol=1e-12
    )


@pytest.mark.parametrize("is_absolute", [False, True])
def test_names_that_lead_out_of_the_folder_are_not_followed(
    run, folder, animation, monkeypatch, is_absolute
):
    write_npz(animation)
    assert run("extract", "clip.npz", *EXTRACT[2:]).code == 0
    result = read_result(Path("cages.h5"))
    target = CagedModel.of_file(result.path, result).read_reconstruction("a skeleton")
    name = str(Path("clip.npz").resolve()) if is_absolute else f"../{folder.name}/clip.npz"
    sources = result.sources | {"frames": result.sources["frames"] | {"name": name}}
    opened = []
    monkeypatch.setattr(input_frames, "open_sequence", lambda *given: opened.append(given))
    assert find_input(replace(result, sources=sources, frames=(name,) * 5), target) is None
    assert not opened


@pytest.mark.parametrize("refused", ["is_file", "iterdir"])
def test_folders_that_may_not_be_read_have_no_input(run, folder, monkeypatch, refused):
    assert run(*EXTRACT).code == 0
    result = read_result(Path("cages.h5"))
    target = CagedModel.of_file(result.path, result).read_reconstruction("a skeleton")

    def refuse(path):
        raise PermissionError(path)

    monkeypatch.setattr(Path, refused, refuse)
    assert find_input(result, target) is None


def test_frames_that_were_chosen_are_those_that_are_followed(run, folder, animation):
    write_npz(animation)
    for clip in ("clip.npz", "frames"):
        words = ("--frames", "0:5:2", "--overwrite")
        assert run("extract", clip, *EXTRACT[2:], *words).code == 0
        found, expected = find(), frames_of(open_sequence([clip]))[::2]
        assert len(found) == 3
        (block,) = found.blocks(8)
        np.testing.assert_array_equal(block.meshes, expected)
        np.testing.assert_array_equal(found.read_frame(1), expected[1])


def test_parts_that_were_left_out_are_left_out_again(run, folder, animation):
    for k, frame in enumerate(animation.frames, start=1):
        lines = [f"v {x} {y} {z}" for x, y, z in frame]
        lines += ["o body", *(f"f {a} {b} {c}" for a, b, c in animation.rest.faces + 1)]
        lines += ["v 9 9 9", "v 9 8 9", "v 8 9 9", "o hat", "f 19 20 21"]
        Path(f"frames/frame_{k}.obj").write_text("\n".join(lines) + "\n")
    assert run(*EXTRACT, "--exclude", "hat").code == 0
    np.testing.assert_allclose(find().read_frame(0), animation.frames[0], rtol=1e-12)


def test_a_frame_that_was_skipped_is_as_the_cages_have_it(run, folder):
    Path("frames/frame_3.obj").write_text("v 1\n")
    assert run(*EXTRACT, "--on-bad-frame", "skip").code == 0
    found = find()
    assert len(found) == 4
    (block,) = found.blocks(8)
    assert block.meshes.shape == (5, 18, 3)
    result = read_result(Path("cages.h5"))
    target = CagedModel.of_file(result.path, result).read_reconstruction("a skeleton")
    (expected,) = target.blocks(8)
    np.testing.assert_array_equal(block.meshes[2], expected.meshes[2])
    assert np.abs(block.meshes[3] - expected.meshes[3]).max() > SINGLE
    assert "against the input, an rms" in said(run(*EXPORT, *FEW))


def test_a_skin_of_an_edit_follows_the_edit(run, folder):
    assert run(*EXTRACT).code == 0
    moves = [{"vertex": 0, "offset": [0.1, 0, 0]}]
    Path("edits.json").write_text(json.dumps({"edits": [{"name": "a", "moves": moves}]}))
    assert run("pose", "cages.h5", "--cage-edits", "edits.json", "-o", "edited.h5").code == 0
    text = said(run("export", "edited.h5", "c.usdc", "--skeleton", *FEW))
    assert "it adds an rms of" in text
    assert "the input" not in text


def test_copies_along_a_seam_stay_together(run, folder, animation, write_obj):
    """Each corner of the first faces is a vertex of its own."""
    faces = animation.rest.faces.copy()
    origins = np.concatenate([np.arange(18), faces[:6].ravel()])
    faces[:6] = 18 + np.arange(18).reshape(6, 3)
    for k, vertices in enumerate(animation.frames, start=1):
        write_obj(Path(f"frames/frame_{k}.obj"), vertices[origins], faces)
    assert run(*EXTRACT).code == 0
    text, found = said(run(*EXPORT, *FEW)), skinned("c.usdc")
    welded, whole = (f"{rms(distances()[:, used]):.2g}" for used in (slice(18), np.unique(faces)))
    assert f"against the input, an rms of {whole} %" in text
    assert welded != whole
    np.testing.assert_allclose(found[:, 18:], found[:, origins[18:]], rtol=0, atol=1e-12)


@pytest.mark.parametrize("words", [("--robust",), ("--vertex-weights", "w.txt")])
def test_where_some_data_counts_less_the_skin_follows_the_cages(run, folder, words):
    Path("w.txt").write_text("0\n" * 2 + "1\n" * 16)
    assert run(*EXTRACT, *words).code == 0
    text = said(run(*EXPORT, *FEW))
    assert "it adds an rms of" in text
    assert FOLLOWS_CAGES not in text


def test_blocks_of_frames_and_threads_change_nothing(run, folder):
    assert run(*EXTRACT).code == 0
    one = find()
    result = read_result(Path("cages.h5"))
    target = CagedModel.of_file(result.path, result).read_reconstruction("a skeleton")
    many = find_input(result, target, jobs=3)
    whole = np.concatenate([block.meshes for block in one.blocks(8)])
    parts = np.concatenate([block.meshes for block in many.blocks(2)])
    np.testing.assert_array_equal(parts, whole)


def test_a_rig_that_follows_the_input_is_kept_until_that_changes(
    run, folder, monkeypatch, animation, write_obj
):
    assert run(*EXTRACT).code == 0
    words = (*EXPORT[:2], "--skeleton", *FEW, "--cache", "kept")
    assert run(*words, "a.usdc").code == 0
    assert run(*words, "b.usdc").code == 0
    assert len(list(Path("kept").iterdir())) == 1
    assert Path("a.usdc").read_bytes() == Path("b.usdc").read_bytes()
    moved = animation.frames[1] + 0.001 * np.sin(animation.frames[1])
    write_obj(Path("frames/frame_2.obj"), moved, animation.rest.faces)
    assert run(*EXTRACT, "--overwrite").code == 0
    assert run(*words, "c.usdc").code == 0
    assert len(list(Path("kept").iterdir())) == 2


def test_an_input_that_changes_during_a_fit_is_refused(run, folder, monkeypatch):
    assert run(*EXTRACT).code == 0
    compute, text = rigs._RigFit._compute, Path("frames/frame_2.obj").read_text()

    def change_and_compute(self, *words):
        Path("frames/frame_2.obj").write_text(text + "# changed\n")
        return compute(self, *words)

    monkeypatch.setattr(rigs._RigFit, "_compute", change_and_compute)
    outcome = run(*EXPORT, *FEW, "--cache", "kept")
    assert outcome.code == 1
    assert "cages.h5: the frames changed during the run; run again" in outcome.err
    assert not list(Path("kept").glob("*.rig"))
    assert not Path("c.usdc").exists()
