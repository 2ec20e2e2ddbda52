"""One set of weights for all clips of a model."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

import cageik_cli.cli.batch as command
from cageik_cli.run.extraction import Extraction
from cageik_cli.store.binding_file import is_binding
from cageik_cli.store.result import read_binding, read_result
from tests.cli.conftest import Here
from tests.conftest import run_in_process as run
from tests.formats.gltf.evaluated import Evaluated
from tests.shapes import box

BATCH = ("batch", "anim", "-o", "out", "--no-pages", "--cage", "cage.obj", "--shared-fit")
"""With a cage that surrounds the models."""


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch):
    monkeypatch.setattr(command, "_choose_scheduler", lambda *options: Here())


@pytest.fixture
def anim(folder, animation) -> Path:
    """Clips `fast` and `walk` of the little animation, from other frames."""
    Path("anim").mkdir()
    frames, faces = np.stack(animation.frames), animation.rest.faces
    for name, chosen in (("walk", [0, 1, 2, 3]), ("fast", [1, 4, 3])):
        np.savez(f"anim/{name}.npz", vertices=frames[chosen], faces=faces, fps=24.0)
    return Path("anim")


def weights_of(name):
    result = read_result(Path(f"out/clips/{name}.npz.h5"))
    return result, read_binding(result).weights


def test_all_clips_have_the_weights_of_one_binding(anim):
    outcome = run(*BATCH)
    assert outcome.code == 0, outcome.err
    assert "bindings/fast.npz.h5: one set of weights for 2 clips: fast.npz, walk.npz" in outcome.err
    (binding,) = Path("out/bindings").iterdir()
    assert is_binding(binding)
    (fast, first), (walk, second) = weights_of("fast"), weights_of("walk")
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(fast.rest.vertices, walk.rest.vertices)
    with h5py.File(binding) as file:
        np.testing.assert_array_equal(file["weights"][:], first)
    assert [clip.name for clip in fast.fit.clips] == ["fast.npz", "walk.npz"]
    report = json.loads(Path("out/report.json").read_text())
    errors = [clip["summary"]["rms_percent"] for clip in report["clips"]]
    assert len(errors) == 2
    assert max(errors) < 3


def test_their_results_are_the_animations_of_one_skeleton(anim):
    assert run(*BATCH).code == 0
    results = [f"out/clips/{name}.npz.h5" for name in ("walk", "fast")]
    export = ("export", *results, "hero.glb", "--skeleton", "--influences", "4")
    assert run(*export).code == 0
    animations = Evaluated(Path("hero.glb")).json["animations"]
    assert [each["name"] for each in animations] == ["walk", "fast"]


def test_weights_are_fitted_to_all_clips(anim):
    """The weights of one clip alone fit the others less closely."""
    assert run(*BATCH).code == 0
    together = weights_of("walk")[0].metrics.rms.max()
    bind = ("bind", "--rest", "out/bindings/fast.npz.h5", "--cage", "cage.obj", "-q")
    assert run(*bind, "--fit", "anim/fast.npz", "-o", "alone.h5").code == 0
    extract = ("extract", "anim/walk.npz", "--rest", "alone.h5", "--binding", "alone.h5", "-q")
    assert run(*extract, "-o", "alone_walk.h5").code == 0
    assert together < 0.9 * read_result(Path("alone_walk.h5")).metrics.rms.max()


def test_what_is_up_to_date_stays(anim):
    assert run(*BATCH).code == 0
    before = {path: path.read_bytes() for path in Path("out").rglob("*.h5")}
    outcome = run(*BATCH, "--resume")
    assert outcome.code == 0
    assert outcome.err.count("unchanged") == 2
    assert {path: path.read_bytes() for path in Path("out").rglob("*.h5")} == before


def test_a_new_clip_changes_the_weights_of_all(anim, animation):
    assert run(*BATCH).code == 0
    frames = np.stack(animation.frames)[[0, 4, 2]] * [1, 1.2, 1]
    np.savez("anim/hop.npz", vertices=frames, faces=animation.rest.faces, fps=24.0)
    before = weights_of("walk")[1]
    outcome = run(*BATCH, "--resume")
    assert outcome.code == 0
    assert "unchanged" not in outcome.err
    assert not np.array_equal(weights_of("walk")[1], before)
    np.testing.assert_array_equal(weights_of("walk")[1], weights_of("hop")[1])


def test_each_model_has_weights_of_its_own(anim):
    other = box(1.0)
    frames = other.vertices * np.linspace(0.8, 1, 4)[:, None, None]
    np.savez("anim/box.npz", vertices=frames, faces=other.faces, fps=24.0)
    assert run(*BATCH).code == 0
    names = sorted(path.name for path in Path("out/bindings").iterdir())
    assert names == ["box.npz.h5", "fast.npz.h5"]


def test_a_clip_that_cannot_be_read_is_left_out(anim):
    Path("anim/broken.npz").write_bytes(b"PK")
    outcome = run(*BATCH)
    assert outcome.code == 4
    assert "one set of weights for 2 clips" in outcome.err
    assert "1 failed" in outcome.err


def test_a_frame_that_cannot_be_read_costs_its_own_clip_alone(anim, animation, write_obj):
    for k, vertices in enumerate(animation.frames, start=1):
        write_obj(Path(f"anim/late/f_{k}.obj"), vertices, animation.rest.faces)
    Path("anim/late/f_4.obj").write_text("v 1 2 x\n")
    outcome = run(*BATCH)
    assert outcome.code == 4
    assert "one set of weights for 2 clips: fast.npz, walk.npz" in outcome.err
    assert "f_4.obj" in outcome.err
    assert "2 done, 1 failed" in outcome.err
    np.testing.assert_array_equal(weights_of("fast")[1], weights_of("walk")[1])


def test_clips_whose_frames_have_the_same_names_are_not_taken_for_one(anim, animation, write_obj):
    for name in ("early", "late"):
        for k, vertices in enumerate(animation.frames, start=1):
            write_obj(Path(f"anim/{name}/f_{k}.obj"), vertices, animation.rest.faces)
    Path("anim/late/f_4.obj").write_text("v 1 2 x\n")
    outcome = run(*BATCH)
    assert outcome.code == 4
    assert "one set of weights for 3 clips: fast.npz, walk.npz, early" in outcome.err
    assert "3 done, 1 failed" in outcome.err


def read_faults():
    clips = json.loads(Path("out/report.json").read_text())["clips"]
    return {clip["name"]: clip["fault"] for clip in clips}


@pytest.mark.parametrize("error", [MemoryError(), OSError("the disk is gone")])
def test_any_error_of_the_fit_is_that_of_its_clips(anim, monkeypatch, error):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("cageik_cli.batch.shared_fit.fit_to_clips", fail)
    assert run(*BATCH).code == 1
    assert set(read_faults()) == {"fast.npz", "walk.npz"}
    assert all(read_faults().values())


def test_any_error_of_opening_a_clip_is_its_own(anim, monkeypatch):
    opened = Extraction.open

    def fail_for_one(extraction):
        if "fast" in str(extraction.settings.frames):
            raise MemoryError
        return opened(extraction)

    monkeypatch.setattr(Extraction, "open", fail_for_one)
    outcome = run(*BATCH)
    assert outcome.code == 4
    assert "one set of weights for 1 clip: walk.npz" in outcome.err
    assert [name for name, fault in read_faults().items() if fault] == ["fast.npz"]


def test_a_fit_that_is_interrupted_says_how_to_continue(anim, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("cageik_cli.batch.shared_fit.fit_to_clips", stop)
    outcome = run(*BATCH)
    assert outcome.code == 1
    assert "0 of 2 clips are done; continue with --resume" in outcome.err


def test_where_no_weights_can_be_fitted_all_clips_of_the_model_say_so(anim, write_obj):
    small = box(0.01)
    write_obj(Path("small.obj"), small.vertices, small.faces)
    outcome = run(*[word.replace("cage.obj", "small.obj") for word in BATCH])
    assert outcome.code == 1
    assert "2 failed" in outcome.err
    report = json.loads(Path("out/report.json").read_text())
    assert all("small.obj" in clip["fault"] for clip in report["clips"])


def test_a_dry_run_fits_nothing(anim):
    words = [word for word in BATCH if word not in ("--cage", "cage.obj")]
    outcome = run(*words, "--dry-run")
    assert outcome.code == 0
    assert outcome.out.count("weights fitted to all clips of its model") == 2
    assert not Path("out").exists()


@pytest.mark.parametrize(
    "words", [("--binding", "b.h5"), ("--no-fit",), ("--no-weights",), ("--robust",)]
)
def test_what_leaves_no_weights_to_fit_is_refused(anim, words):
    outcome = run(*BATCH, *words)
    assert outcome.code == 2
    named = words[0] if words != ("--robust",) else "captured"
    assert "--shared-fit does not go with" in outcome.err
    assert named in outcome.err
