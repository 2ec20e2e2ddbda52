"""Points all over a surface."""

import numpy as np
import pytest

from cageik_cli.cages import surface_points as module
from cageik_cli.cages.builder.judge import CELL_SHIFT, Demand
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.cages.surface_points import sample_in_blocks, sample_surface
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points
from tests.shapes import ball, box, finer


def needles(count):
    """Triangles with long sides and hardly any area."""
    corners = np.random.default_rng(0).uniform(0, 1, (count, 1, 3)) + np.array(
        [[0, 0, 0], [0.5, 0, 0], [0.5, 1e-3, 0]]
    )
    return TriMesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def test_points_are_on_the_surface_and_no_further_apart_than_the_spacing():
    points = sample_surface(box(), 0.1 / box().diagonal, 10_000)
    np.testing.assert_array_equal(points[:8], box().vertices)
    assert closest_points(box(), points).distance.max() < 1e-12
    gaps = [np.linalg.norm(points - p, axis=1).min() for p in finer(box(), 4).vertices]
    assert max(gaps) < 0.1


def test_a_large_area_gets_about_as_many_points_as_are_allowed():
    assert 500 < len(sample_surface(box(), 1e-4, 1000)) < 2500


@pytest.mark.parametrize("limit", [1, 300, 10**6])
def test_blocks_do_not_change_the_points(monkeypatch, limit):
    mesh = finer(ball(1), 1)
    expected = sample_surface(mesh, 0.05 / mesh.diagonal, 10_000)
    monkeypatch.setattr(module, "MAX_BLOCK_POINTS", limit)
    found = np.concatenate(list(sample_in_blocks(mesh, 0.05, 10_000)))
    assert len(found) == len(expected)
    np.testing.assert_array_equal(np.unique(found, axis=0), np.unique(expected, axis=0))


def test_needles_are_never_sampled_all_at_once(monkeypatch):
    monkeypatch.setattr(module, "MAX_BLOCK_POINTS", 5000)
    model = needles(200)
    sizes = [len(block) for block in sample_in_blocks(model, 0.005, 150_000)]
    assert sum(sizes) > 20 * 5000
    # A block is full at so many, and the part that fills it has as many at most.
    assert max(sizes) <= 2 * 5000


def test_the_points_of_a_model_are_those_of_one_block(monkeypatch):
    expected = Demand(needles(50), BuildSettings()).samples
    monkeypatch.setattr(module, "MAX_BLOCK_POINTS", 1000)
    found = Demand(needles(50), BuildSettings()).samples
    np.testing.assert_array_equal(found, expected)
    assert len(np.unique(np.floor(found / 0.01 + CELL_SHIFT), axis=0)) == len(found)
