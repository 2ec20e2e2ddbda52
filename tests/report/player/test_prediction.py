"""Numbers of vertices as differences from their neighbours."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.report.player.prediction import Predictor
from tests.report.player.rebuild import add_predictions
from tests.shapes import ball

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
