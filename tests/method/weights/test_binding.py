import numpy as np
import pytest

from cageik_cli.method.weights import binding
from cageik_cli.method.weights.binding import (
    BYTES_PER_PRODUCT,
    FRAMES_PER_PRODUCT,
    Binding,
    divide_rows,
    reconstruct,
)
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.errors import SettingError
from cageik_cli.util.threads import limit_blas_threads
from tests.shapes import box, octahedron


def test_unknown_coordinates_are_refused():
    with pytest.raises(SettingError, match="`coordinates=` is 'green'"):
        BindSettings(coordinates="green")


def test_quality_equals_its_definitions():
    weights = np.full((6, 8), 1 / 8)
    weights[2, 1] += 0.25
    weights[4, 0] = -0.5
    bound = Binding(octahedron(), box(), weights)
    rest = octahedron().vertices
    expected = np.linalg.norm(weights @ box().vertices - rest, axis=1).max() / octahedron().diagonal
    assert bound.quality.partition_of_unity == pytest.approx(0.625)
    assert bound.quality.min_weight == -0.5
    assert bound.quality.linear_precision == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("count", [0, 1, FRAMES_PER_PRODUCT, 2 * FRAMES_PER_PRODUCT + 3])
def test_reconstructions_of_blocks_equal_those_of_frames(count):
    random = np.random.default_rng(1)
    weights, cages = random.random((7, 4)), random.random((count, 4, 3))
    expected = np.array([weights @ cage for cage in cages]).reshape(count, 7, 3)
    np.testing.assert_allclose(reconstruct(weights, cages), expected, rtol=1e-14, atol=0)


def test_whole_groups_of_frames_give_the_same_bits():
    random = np.random.default_rng(2)
    weights, cages = random.random((7, 4)), random.random((3 * FRAMES_PER_PRODUCT, 4, 3))
    parts = [
        reconstruct(weights, cages[:FRAMES_PER_PRODUCT]),
        reconstruct(weights, cages[FRAMES_PER_PRODUCT:]),
    ]
    np.testing.assert_array_equal(np.concatenate(parts), reconstruct(weights, cages))


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_threads_and_a_given_array_give_the_same_bits(jobs, monkeypatch):
    monkeypatch.setattr(binding, "BYTES_PER_PRODUCT", 1 << 12)
    random = np.random.default_rng(3)
    weights, cages = random.random((1000, 5)), random.random((FRAMES_PER_PRODUCT + 1, 5, 3))
    out = np.full((len(cages), 1000, 3), np.nan)
    with limit_blas_threads(1):
        expected = reconstruct(weights, cages)
        found = reconstruct(weights, cages, out, jobs)
    assert found is out
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_allclose(found, weights @ cages, rtol=1e-14, atol=0)


@pytest.mark.parametrize("count", [0, 1, 4351, 4352, 8703, 8704, 50_000])
@pytest.mark.parametrize("columns", [0, 1, 120, 5000])
def test_parts_of_weights_are_large_and_cover_all_rows(count, columns):
    parts = divide_rows(count, columns)
    rows = np.concatenate([np.arange(count)[part] for part in parts])
    np.testing.assert_array_equal(rows, np.arange(count))
    sizes = [8 * columns * (part.stop - part.start) for part in parts]
    if len(parts) > 1:
        assert min(sizes) > BYTES_PER_PRODUCT / 2
        assert max(sizes) < 2.1 * BYTES_PER_PRODUCT


def test_products_of_parts_have_the_bits_of_a_whole_product():
    random = np.random.default_rng(4)
    weights, cages = random.random((3 * 4352 + 100, 120)), random.random((4, 120, 3))
    assert len(divide_rows(*weights.shape)) == 3
    with limit_blas_threads(1):
        whole = weights @ cages.transpose(1, 0, 2).reshape(120, 12)
        found = reconstruct(weights, cages)
    np.testing.assert_array_equal(found, whole.reshape(-1, 4, 3).transpose(1, 0, 2))
