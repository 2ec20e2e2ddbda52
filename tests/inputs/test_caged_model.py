"""Frames that are computed while the last ones are used."""

import numpy as np
import pytest

from cageik_cli.inputs.reconstruction import CageFrames, Reconstruction
from cageik_cli.method.weights import binding as binding_module
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.threads import limit_blas_threads
from tests.shapes import ball, box

COUNT = 10


def make_target(has_offsets=False, rotations=None):
    """A ball with random weights, and random cages."""
    random = np.random.default_rng(1)
    weights = random.random((len(ball().vertices), 8))
    cages = random.random((COUNT, 8, 3))

    def blocks(size):
        return (cages[start : start + size] for start in range(0, COUNT, size))

    frames = CageFrames(COUNT, np.arange(COUNT), lambda k: cages[k], blocks, rotations)
    return Reconstruction(Binding(ball(), box(), weights, has_offsets=has_offsets), frames)


@pytest.mark.parametrize("size", [4, 8, 16])
@pytest.mark.parametrize("jobs", [1, 3])
def test_streamed_meshes_have_the_bits_of_blocks(size, jobs, monkeypatch):
    monkeypatch.setattr(binding_module, "BYTES_PER_PRODUCT", 1 << 12)
    target = make_target()
    with limit_blas_threads(1):
        expected = np.concatenate([block.meshes for block in target.blocks(4)])
        streamed = [meshes.copy() for meshes in target.stream_meshes(size, jobs)]
    assert [len(meshes) for meshes in streamed] == [
        min(size, COUNT - start) for start in range(0, COUNT, size)
    ]
    np.testing.assert_array_equal(np.concatenate(streamed), expected)


@pytest.mark.parametrize("is_given", [True, False])
def test_streamed_offsets_turn_with_their_frames(is_given):
    random = np.random.default_rng(2)
    rotations = np.linalg.qr(random.random((COUNT, 3, 3)))[0] if is_given else None
    target = make_target(True, rotations)
    expected = np.concatenate([block.meshes for block in target.blocks(4)])
    streamed = np.concatenate([meshes.copy() for meshes in target.stream_meshes(4, 2)])
    np.testing.assert_array_equal(streamed, expected)


def test_two_arrays_hold_all_streamed_meshes():
    held = {meshes.ctypes.data for meshes in make_target().stream_meshes(2, 1)}
    assert len(held) == 2


def test_an_error_of_the_cages_comes_out_of_the_stream():
    target = make_target()

    def blocks(size):
        yield np.zeros((size, 8, 3))
        raise ValueError("no more")

    cages = CageFrames(COUNT, np.arange(COUNT), target.cages.read, blocks)
    with pytest.raises(ValueError, match="no more"):
        list(Reconstruction(target.binding, cages).stream_meshes(4, 1))
