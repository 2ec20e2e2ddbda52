"""The worst regions of a clip that is extracted, and the frames that are kept in full."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.solve.regions import Cause
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.run.edit import edit
from cageik_cli.run.extraction import Extraction, extract
from cageik_cli.run.settings import EditSettings, ExtractSettings
from cageik_cli.store.result import read_animation, read_binding, read_key_frames
from tests.cages.check.test_sections import trousers
from tests.shapes import box, finer


@pytest.fixture
def plain(folder):
    """Settings for the little animation, which a cage of eight vertices misses by far."""
    return ExtractSettings(("frames",), Path("cage.obj"), Path("cages.h5"), overwrite=True)


@pytest.fixture
def trouser_clip(tmp_path, write_obj, coarse_panels):
    """Settings for trousers whose legs step past each other, in one box that fits closely."""
    model = finer(trousers(0.5), 3)
    x, y, _ = model.vertices.T
    depth = np.maximum(0.8 - y, 0.0)
    frames = np.array([model.vertices] * 3)
    frames[1, :, 2] += 0.2 * depth * np.sign(x - 1.25)
    frames[2, :, 2] -= 0.6 * depth * np.sign(x - 1.25)
    np.savez(tmp_path / "clip.npz", verts=frames, faces=model.faces)
    low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
    cage = box().vertices * ((high - low) / 2 + 0.05) + (low + high) / 2
    write_obj(tmp_path / "cage.obj", cage, box().faces)
    return ExtractSettings(
        (str(tmp_path / "clip.npz"),), tmp_path / "cage.obj", tmp_path / "cages.h5"
    )


def kept_frames(result):
    return read_key_frames(result, read_binding(result)).indices.tolist()


def test_the_worst_region_is_where_the_largest_deviation_is(plain, animation):
    result = extract(plain)
    with h5py.File(result.path) as file:
        rebuilt = file["weights"][:] @ file["verts"][:]
    misses = np.linalg.norm(rebuilt - animation.frames, axis=2)
    worst = result.regions[0]
    frame, vertex = np.unravel_index(misses.argmax(), misses.shape)
    assert (worst.frame, worst.worst_vertex) == (frame, vertex)
    assert worst.max_deviation == pytest.approx(misses.max(), rel=1e-12)
    assert worst.max_deviation == result.metrics.max_deviation.max()
    assert worst.max_deviation > 0.03 * result.rest.diagonal
    deviations = [region.max_deviation for region in result.regions]
    assert deviations == sorted(deviations, reverse=True)
    assert min(deviations) > 0.5 * misses.max()


def test_a_clip_that_is_met_has_no_regions(fixtures_folder, tmp_path, weights_cache):
    frames = fixtures_folder / "walker" / "frames"
    result = extract(
        ExtractSettings(
            tuple(str(frames / f"walker_{k}.obj") for k in (1, 26)),
            fixtures_folder / "walker" / "cage.obj",
            tmp_path / "cages.h5",
            cache=weights_cache,
        )
    )
    assert result.regions == ()
    with h5py.File(result.path) as file:
        assert len(file["poses/frame"]) == 3


@pytest.mark.parametrize("is_loose", [True, False, None])
def test_what_the_bind_found_of_the_room_is_not_measured_again(plain, is_loose, monkeypatch):
    measured = []
    monkeypatch.setattr(
        "cageik_cli.run.extraction.is_too_loose", lambda *_: measured.append(1) or True
    )
    extraction = Extraction(plain)
    extraction.open()
    stored = extraction.bind()
    stored = replace(stored, has_loose_cage=is_loose)
    result = Extraction(plain, stored=stored).run()
    causes = {region.cause for region in result.regions}
    assert (causes == {Cause.LOOSE_CAGE}) == (is_loose is not False)
    assert bool(measured) == (is_loose is None)


def test_limbs_in_one_loop_of_the_cage_are_the_cause(trouser_clip):
    result = extract(trouser_clip)
    assert result.regions[0].cause is Cause.SHARED_LOOP
    assert result.regions[0].frame == 2
    assert result.regions[0].centre[1] < 0.8


def test_a_cage_that_is_far_too_loose_is_the_cause_of_all_regions(trouser_clip, write_obj):
    """Limbs share its loops, too, but so does all else."""
    write_obj(trouser_clip.cage, box(3.0).vertices + np.array([1.25, 1, 0.5]), box().faces)
    result = extract(trouser_clip)
    assert {region.cause for region in result.regions} == {Cause.LOOSE_CAGE}
    assert result.regions[0].evidence.has_loose_cage


@pytest.mark.parametrize("options", [{"jobs": 3}, {"keep_weights": False}])
def test_regions_do_not_depend_on_threads_or_on_what_is_kept(plain, options):
    expected = extract(plain).regions
    assert extract(replace(plain, **options)).regions == expected


def test_the_frame_of_the_worst_region_is_kept(plain, animation, write_obj):
    """One point is far off in a frame that is neither the worst nor the median nor the best."""
    generator = np.random.default_rng(0)
    for k, length in enumerate((0.0, 0.05, 0.1, 0.5), start=1):
        shaken = animation.frames[k].copy()
        away = generator.normal(size=shaken.shape)
        shaken += length * away / np.linalg.norm(away, axis=1)[:, None]
        if length == 0:
            shaken[5] += [0.0, 0.0, 2.0]
        write_obj(Path(f"frames/frame_{k + 1}.obj"), shaken, animation.rest.faces)
    result = extract(plain)
    worst = result.regions[0]
    kept = kept_frames(result)
    assert (len(kept), kept[3], worst.frame) == (4, 1, 1)
    held = read_key_frames(result, read_binding(result))
    error = np.linalg.norm(held.errors[kept.index(worst.frame)][worst.worst_vertex])
    assert error * result.rest.diagonal == pytest.approx(worst.max_deviation, rel=1e-5)


def test_the_best_frame_is_not_the_rest_pose(plain, write_obj, animation):
    ranked = np.argsort(extract(plain).metrics.rms)
    assert ranked[0] == 0
    assert kept_frames(extract(plain))[2] == ranked[1]
    # Nor a frame that is the rest pose of a file, or a later copy of it.
    write_obj(Path("rest.obj"), animation.frames[0], animation.rest.faces)
    assert kept_frames(extract(replace(plain, rest=Path("rest.obj"))))[2] == ranked[1]
    write_obj(Path("frames/frame_6.obj"), animation.frames[0] + 3.0, animation.rest.faces)
    assert kept_frames(extract(plain))[2] == ranked[1]


def test_a_clip_of_nothing_but_the_rest_pose_has_a_best_frame(plain):
    result = extract(replace(plain, frames=("frames/frame_1.obj",)))
    assert kept_frames(result) == [0, 0, 0]
    assert result.regions == ()


def test_the_best_of_exact_frames_is_another_than_the_rest_frame(plain, write_obj, animation):
    moved = TriMesh(animation.frames[0] * [1.0, 1.5, 1.0], animation.rest.faces)
    for k in range(2, 6):
        write_obj(Path(f"frames/frame_{k}.obj"), moved.vertices, moved.faces)
    result = extract(replace(plain, solve=SolveSettings(alpha=0.0)))
    assert result.metrics.max_deviation.max() < 1e-9
    assert kept_frames(result)[2] != 0
    assert result.regions == ()


def test_an_edit_has_no_regions(plain):
    result = extract(plain)
    Path("handles.json").write_text(
        '{"handles": [{"name": "tip", "vertex": 0, "offset": [9, 0, 0]}]}'
    )
    edit(EditSettings(result.path, Path("handles.json"), Path("edited.h5")))
    assert read_animation(Path("edited.h5")).worst_region is None
