"""Vertices that are split at seams have the same weights, of whatever format the clip is."""

import numpy as np
import pytest
from scipy.linalg import null_space

from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.write import Output
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs.reconstruction import CageFrames, Reconstruction
from cageik_cli.method.weights.binding import Binding
from cageik_cli.run import rig
from cageik_cli.run.deform import deform
from cageik_cli.run.extraction import extract
from cageik_cli.run.fit import fit_weights
from cageik_cli.run.settings import DeformSettings, ExtractSettings
from cageik_cli.store.result import read_binding
from tests.clips import frames_of
from tests.fitted import small_binding, smooth_motion
from tests.formats.written import write
from tests.shapes import merged
from tests.texts import texts

BINDING = small_binding()
FRAMES = smooth_motion(BINDING, 8)
HALVES = np.sign(BINDING.rest.vertices[BINDING.rest.faces].mean(axis=1)[:, 0]) > 0


def cut():
    """The model cut along a seam, with the vertex of the model that each of its vertices is."""
    rest = BINDING.rest
    copies, faces = {}, np.empty_like(rest.faces)
    for k, face in enumerate(rest.faces.tolist()):
        for corner, vertex in enumerate(face):
            faces[k, corner] = copies.setdefault((vertex, bool(HALVES[k])), len(copies))
    origins = np.array([vertex for vertex, _ in copies])
    return TriMesh(rest.vertices[origins], faces), origins


MESH, ORIGINS = cut()
SEAM = np.flatnonzero(np.bincount(ORIGINS) > 1)
"""Vertices of the model that have copies."""


def find_gap(frames):
    """The largest distance between copies of a vertex in frames (F, m, 3)."""
    pairs = [np.flatnonzero(vertex == ORIGINS) for vertex in SEAM]
    return max(np.ptp(frames[:, pair], axis=1).max() for pair in pairs)


def check_rows(weights):
    for vertex in SEAM:
        rows = weights[vertex == ORIGINS]
        np.testing.assert_array_equal(rows, np.tile(rows[0], (len(rows), 1)))


def write_cage(folder):
    path = folder / "cage_0001.obj"
    write(folder / "cage_####.obj", BINDING.cage, BINDING.cage.vertices[None])
    return path


@pytest.fixture(params=["clip/f_####.obj", "clip/f_####.ply", "clip.usdc", "clip.abc", "clip.npz"])
def clip(request, tmp_path, coarse_panels):
    frames = np.concatenate([MESH.vertices[None], FRAMES[:, ORIGINS]])  # the first is at rest
    write(tmp_path / request.param, MESH, frames)
    path = tmp_path / request.param.partition("/")[0]
    return str(path)


def test_a_fitted_clip_has_no_crack_and_a_note_counts_its_copies(tmp_path, clip):
    cage = write_cage(tmp_path / "cage")
    settings = ExtractSettings(
        (clip,), cage, tmp_path / "r.h5", fit=FitSettings(), cache=tmp_path / "cache"
    )
    result = extract(settings)
    check_rows(read_binding(result).weights)
    (note,) = [note for note in texts(result.notes) if "never come apart" in note]
    assert note.startswith(f"{2 * len(SEAM)} vertices at {len(SEAM)} places never come apart")
    for k, influences in enumerate((None, 3)):
        output = Output(tmp_path / f"moved_{k}.npz")
        deform(DeformSettings(tmp_path / "r.h5", output, influences=influences))
        frames = frames_of(open_sequence([str(output.path)]))
        assert find_gap(frames) < 1e-12 * MESH.diagonal


def fit(frames=None, mesh=MESH, **options):
    weights = BINDING.weights[ORIGINS]
    frames = FRAMES[:, ORIGINS] if frames is None else frames
    binding = Binding(mesh, BINDING.cage, weights, BINDING.settings)
    return fit_weights(binding, [frames], **options)


@pytest.mark.parametrize(
    "settings", [FitSettings(), FitSettings(rank=3), FitSettings(influences=3)]
)
def test_the_weights_are_those_of_the_model_that_is_whole(settings):
    split = fit(settings=settings)
    whole = fit_weights(BINDING, [FRAMES], settings)
    check_rows(split.binding.weights)
    expected = whole.binding.weights[ORIGINS]
    np.testing.assert_allclose(split.binding.weights, expected, rtol=0, atol=2e-6)
    assert split.unfitted.weights.shape == split.binding.weights.shape
    assert split.binding.rest is MESH
    assert split.binding.has_offsets == whole.binding.has_offsets
    if split.low_rank is not None:
        changed = split.low_rank.add_to(split.unfitted.weights)
        np.testing.assert_allclose(changed, split.binding.weights, atol=1e-12)


def test_each_copy_counts_by_its_share_of_the_area():
    split, whole = fit(vertex_weights="area"), fit_weights(BINDING, [FRAMES], vertex_weights="area")
    np.testing.assert_allclose(
        split.binding.weights, whole.binding.weights[ORIGINS], rtol=0, atol=2e-6
    )


def test_copies_that_part_later_have_rows_of_their_own():
    frames = FRAMES[:, ORIGINS].copy()
    frames[5:, : len(frames[0]) // 2] += [0, 0, 0.01 * MESH.diagonal]
    weights = fit(frames).binding.weights
    rows = [weights[vertex == ORIGINS] for vertex in SEAM]
    assert any((pair[0] != pair[1]).any() for pair in rows)


def test_two_models_that_touch_only_at_rest_are_fitted_apart():
    """Their rest poses are one place by place, and one of them stays there."""
    rest = BINDING.rest
    both = merged(rest, rest)
    weights = np.vstack([BINDING.weights] * 2)
    frames = np.concatenate([FRAMES, np.repeat(rest.vertices[None], 8, axis=0)], axis=1)
    fitted = fit_weights(Binding(both, BINDING.cage, weights, BINDING.settings), [frames])
    m = len(rest.vertices)
    assert np.abs(fitted.binding.weights[:m] - fitted.binding.weights[m:]).max() > 1e-3


@pytest.mark.parametrize("moved", [range(33, 35), range(0)])
def test_a_skin_parts_where_the_reconstruction_does_in_a_few_frames(moved):
    """As lips that open for two frames of sixty."""
    weights, cage = BINDING.weights[ORIGINS], BINDING.cage.vertices
    # What is added to the rows of some copies moves nothing at rest.
    still = null_space(np.column_stack([cage, np.ones(len(cage))]).T)[:, 0]
    weights[: len(weights) // 2] += 0.1 * still
    cages = np.repeat(cage[None], 60, axis=0)
    cages[moved] += 0.3 * still[None, :, None]
    binding = Binding(MESH, BINDING.cage, weights, BINDING.settings)
    frames = CageFrames(60, np.arange(60), lambda k: cages[k], lambda size: iter([cages]))
    seams = rig._find_seams(Reconstruction(binding, frames))
    pairs = [np.flatnonzero(vertex == ORIGINS) for vertex in SEAM]
    welded = [len(np.unique(seams.places[pair])) == 1 for pair in pairs] if seams else [False]
    assert all(welded) == (len(moved) == 0)
