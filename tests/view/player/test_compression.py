"""Weights as integers, integers as differences, and arrays and a header in one text."""

import base64
import gzip
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.view.player import compression
from cageik_cli.view.player.compression import (
    MAX_LEVEL,
    PACKED_TYPES,
    Predictor,
    find_smooth_motions,
    pack_arrays,
)
from tests.shapes import ball
from tests.view.player.rebuild import add_predictions, unpack_arrays


def round_weights(weights, **options):
    """Round weights without motions in which they are kept more precisely."""
    return compression.round_weights(weights, np.empty((weights.shape[1], 0)), **options)


def _random_weights(seed, rows, columns, signed):
    weights = np.random.default_rng(seed).normal(size=(rows, columns))
    weights = weights if signed else np.abs(weights)
    return weights / weights.sum(axis=1, keepdims=True)


@given(st.integers(0, 1000), st.integers(1, 40), st.integers(1, 30), st.booleans())
def test_rows_keep_their_sum_and_entries_are_near(seed, rows, columns, signed):
    weights = _random_weights(seed, rows, columns, signed)
    rounded = round_weights(weights)
    sums = rounded.integers.astype(int).sum(axis=1)
    assert (sums == np.rint(rounded.levels)).all()
    assert np.abs(rounded.integers - rounded.levels * weights).max() <= 1


def test_a_cage_that_moves_as_one_moves_the_mesh_exactly():
    rounded = round_weights(_random_weights(3, 200, 50, True))
    moved = rounded.integers.astype(float) @ np.full(50, 1e6) / rounded.levels
    np.testing.assert_allclose(moved, 1e6, rtol=1e-12)


def test_more_rows_than_a_block_are_rounded_alike():
    weights = _random_weights(5, 30, 9, True)
    whole = round_weights(weights)
    in_blocks = round_weights(weights, rows_per_block=7)
    np.testing.assert_array_equal(in_blocks.integers, whole.integers)


@pytest.mark.parametrize("size", [0.0, 1e-300, 1.0, 1e5, 1e300])
def test_weights_of_any_size_are_rounded(size):
    rounded = round_weights(np.array([[size, -size, 0.0]]))
    assert np.abs(rounded.integers).max() <= MAX_LEVEL
    assert np.isfinite(rounded.levels)
    np.testing.assert_allclose(rounded.integers / rounded.levels, [[size, -size, 0]], rtol=1e-4)


def test_smooth_motions_are_kept_more_precisely():
    cage = ball(levels=2, size=1.0)
    motions = find_smooth_motions(cage)
    np.testing.assert_allclose(motions.T @ motions, np.eye(motions.shape[1]), atol=1e-12)
    weights = _random_weights(1, 300, len(cage.vertices), False)
    rounded = compression.round_weights(weights, motions)
    lost = rounded.restore() - weights
    plain = round_weights(weights).integers / rounded.levels - weights
    assert np.abs(lost @ motions).max() < 0.01 * np.abs(plain @ motions).max()
    # Smooth motions hold the affine ones of a ball nearly.
    assert np.abs(lost @ cage.vertices).max() < 0.1 * np.abs(plain @ cage.vertices).max()


def test_a_tetrahedron_has_fewer_smooth_motions(animation):
    assert find_smooth_motions(animation.cage).shape == (8, 7)


MESH = ball(levels=2, size=1.0)


@given(st.integers(0, 1000), st.booleans())
def test_any_integers_come_back(seed, is_loose):
    generator = np.random.default_rng(seed)
    faces = generator.permutation(len(MESH.vertices))[MESH.faces]
    faces = faces[:3] if is_loose else faces
    values = generator.integers(-32768, 32768, (2, 3, len(MESH.vertices)), np.int16)
    encoded = Predictor(faces, len(MESH.vertices)).encode(values)
    assert (encoded.dtype, encoded.shape) == (values.dtype, values.shape)
    np.testing.assert_array_equal(add_predictions(encoded, faces), values)


def test_what_is_smooth_gets_small():
    mesh = ball(levels=4, size=1.0)
    values = np.rint(10_000 * mesh.vertices.T).astype(np.int16)
    encoded = Predictor(mesh.faces, len(mesh.vertices)).encode(values).view(np.uint16)
    assert np.median(encoded) < 0.4 * np.median(np.abs(values))


def test_a_mesh_without_faces_is_a_list():
    values = np.array([[4, 9, 9, -1]], np.int16)
    encoded = Predictor(np.empty((0, 3), int), 4).encode(values)
    # Lacks are 4, 5, 0 and -10; each without half of the one before: 4, 3, -2 and -10.
    np.testing.assert_array_equal(encoded, [[8, 6, 3, 19]])


ARRAYS = {
    "small": np.array([[-3, 2], [32767, -32768]], "<i2"),
    "real": np.linspace(-1e9, 1e-9, 7, dtype="<f4"),
    "none": np.empty((0, 3), "<u4"),
    "levels": np.array([0, 65535], "<u2"),
}
HEADER = {"names": ["a", "</script>", "\u00e9\n"], "number": 0.1}


def test_what_is_packed_is_unpacked():
    header, arrays = unpack_arrays(pack_arrays(HEADER, ARRAYS))
    assert header == HEADER
    assert list(arrays) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(arrays[name], array)


def test_the_same_arguments_give_the_same_text():
    text = pack_arrays(HEADER, ARRAYS)
    assert pack_arrays(dict(HEADER), {k: v.copy() for k, v in ARRAYS.items()}) == text
    assert base64.b64decode(text)[4:10] == bytes([0, 0, 0, 0, 0, 0xFF])


def test_other_programs_unpack_it():
    content = gzip.decompress(base64.b64decode(pack_arrays(HEADER, ARRAYS)))
    length = int.from_bytes(content[:4], "little")
    listed = json.loads(content[4 : 4 + length])["arrays"]
    assert [one["name"] for one in listed] == list(ARRAYS)
    planes = content[4 + length : 4 + length + 8]
    low, high = np.frombuffer(planes, np.uint8).reshape(2, 4).astype(int)
    np.testing.assert_array_equal((low + 256 * high).astype("<u2"), [65533, 2, 32767, 32768])


def test_no_text_of_a_user_ends_the_element():
    assert not set(pack_arrays(HEADER, ARRAYS)) & set("<>&\"'")


def test_arrays_of_other_types_and_numbers_that_are_not_finite_are_refused():
    with pytest.raises(StopIteration):
        pack_arrays({}, {"x": np.zeros(2)})
    with pytest.raises(ValueError, match="JSON"):
        pack_arrays({"x": float("nan")}, {})
    assert "<f8" not in PACKED_TYPES.values()
