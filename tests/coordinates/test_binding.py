import numpy as np
import pytest

from cageik_cli.coordinates.binding import FRAMES_PER_PRODUCT, Binding, reconstruct
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.util.errors import SettingError
from tests.shapes import box, octahedron


def test_unknown_coordinates_are_refused():
    with pytest.raises(SettingError, match="coordinates is 'green'"):
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
