"""Time of a move against the bars of posing, and against what a user would take instead.

One thread, medians of 1000 moves; `make bench`. Bindings are synthetic, see `drags`.
"""

import time

import igl
import numpy as np
import pytest

from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.method.pose.anchors import Anchor, anchor_matrix, point_at_vertex
from cageik_cli.method.pose.poser import Poser
from cageik_cli.util.threads import limit_blas_threads
from tests.benchmarks.drags import median_seconds, moves_of, spread_anchors, synthetic

pytestmark = pytest.mark.bench
MOVES = 1000


def microseconds(moves, work):
    with limit_blas_threads(1):
        return 1e6 * median_seconds(moves, work)


@pytest.fixture(scope="module")
def example():
    """A poser of the size that the paper's 78 microseconds are held against, and its moves."""
    binding = synthetic(100, 10_000, is_meshed=True)
    poser = Poser(binding, spread_anchors(binding, 8), hold=False)
    poser.solve_mesh(moves_of(1, 8)[0])  # its response is computed once, not at every move
    return poser, moves_of(MOVES, 8)


@pytest.mark.parametrize(("n", "m", "count"), [(100, 10_000, 8), (300, 40_000, 16)])
def test_a_move(n, m, count):
    binding = synthetic(n, m)
    start = time.perf_counter()
    poser = Poser(binding, spread_anchors(binding, count), hold=False)
    poser.solve_mesh(moves_of(1, count)[0])
    made, moves = time.perf_counter() - start, moves_of(MOVES, count)
    cage = microseconds(moves, poser.solve_cage)
    both = microseconds(moves, lambda move: (poser.solve_cage(move), poser.solve_mesh(move)))
    print(
        f"\nn = {n}, m = {m}, l = {count}: cage {cage:.1f} us, cage and mesh {both:.1f} us; "
        f"the poser was made in {1e3 * made:.0f} ms",
        end="",
    )
    if n == 100:
        assert cage <= 10
        assert both <= 78


@pytest.mark.parametrize("moving", [1, 2])
def test_a_move_that_holds_the_rest(moving):
    """Of 8 anchors, some move; the others are pins."""
    binding = synthetic(120, 10_000, is_meshed=True)
    poser = Poser(binding, spread_anchors(binding, 8))
    moves = moves_of(MOVES, 8)
    moves[:, moving:] = 0
    poser.solve_mesh(moves[0])
    mesh = microseconds(moves, poser.solve_mesh)
    print(f"\nheld, {moving} of 8 anchors move: mesh {mesh:.1f} us", end="")
    if moving == 1:
        assert mesh <= 100


def test_a_move_of_cells_that_turn(example):
    poser, moves = example
    cage = microseconds(moves, lambda move: poser.solve_cage(move, 10))
    both = microseconds(moves, lambda move: poser.solve_mesh(move, 10))
    print(f"\nrigidity 10: cage {cage:.0f} us, mesh too {both:.0f} us", end="")
    assert cage <= 2000


def test_an_anchor_more_and_one_less(example):
    poser, _ = example
    another = Anchor("another", point_at_vertex(poser.binding.rest, 1234))
    wider, rounds = poser.with_anchor(another), np.arange(100)
    new = microseconds(rounds[:20], lambda _: Poser(poser.binding, wider.anchors, hold=False))
    more = microseconds(rounds, lambda _: poser.with_anchor(another))
    less = microseconds(rounds, lambda _: wider.without_anchor("another"))
    whole = microseconds(rounds, lambda _: poser.with_anchor(another).solve_mesh(np.ones((9, 3))))
    print(
        f"\none anchor more {more:.0f} us, one less {less:.0f} us, made new {new:.0f} us; with the "
        f"response of the mesh {whole:.0f} us",
        end="",
    )
    assert max(more, less) < new


def test_against_lstsq_from_scratch(example):
    """Both terms' rows stacked, as in the paper, at every move; and the product with H."""
    poser, moves = example
    binding, alpha = poser.binding, poser.alpha
    smooth = uniform_laplacian(binding.cage) * np.sqrt(alpha / len(binding.cage.vertices))
    pull = anchor_matrix(poser.anchors, binding.weights) * np.sqrt(poser.beta / len(poser.anchors))
    matrix, rest, scale = np.vstack([smooth, pull]), binding.cage.vertices, pull[0].sum()

    def posed(move):
        right = np.vstack([smooth @ rest, pull @ rest + scale * move])
        return binding.weights @ np.linalg.lstsq(matrix, right, rcond=None)[0]

    np.testing.assert_allclose(posed(moves[0]), poser.solve_mesh(moves[0]), atol=1e-9)
    theirs = microseconds(moves[:100], posed)
    ours = microseconds(moves, lambda move: (poser.solve_cage(move), poser.solve_mesh(move)))
    print(
        f"\ncage and mesh {ours:.1f} us, by lstsq {theirs:.0f} us: {theirs / ours:.0f} times",
        end="",
    )
    assert theirs > 10 * ours


@pytest.mark.parametrize("rounds", [1, 10])
def test_against_libigl_on_the_mesh_itself(example, rounds):
    """Its as-rigid-as-possible solve, factored before, with the same handles."""
    poser, moves = example
    mesh = poser.binding.rest
    vertices = np.array([anchor.point.corners[0] for anchor in poser.anchors], np.int32)
    data = igl.ARAPData()
    data.max_iter = rounds
    rest = np.array(mesh.vertices)
    igl.arap_precomputation(rest, np.array(mesh.faces), 3, vertices, data)
    handles = rest[vertices]
    posed = igl.arap_solve(handles + moves[0], data, rest)
    np.testing.assert_allclose(posed[vertices], handles + moves[0], atol=1e-12)
    theirs = microseconds(moves[:20], lambda move: igl.arap_solve(handles + move, data, rest))
    ours = microseconds(moves, lambda move: (poser.solve_cage(move), poser.solve_mesh(move)))
    turning = microseconds(moves[:200], lambda move: poser.solve_mesh(move, rounds))
    print(
        f"\nigl.arap_solve, {rounds} rounds: {theirs:.0f} us; cage and mesh {ours:.1f} us, with "
        f"rigidity {rounds} {turning:.0f} us: {theirs / ours:.0f} and {theirs / turning:.1f} times",
        end="",
    )
    assert theirs > turning
