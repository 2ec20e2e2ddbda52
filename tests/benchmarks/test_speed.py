"""Speed as ratios against yardsticks in the same run: `make bench`. Not part of the tests."""

import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cageik_cli.cages.bind import bind
from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import Binding
from cageik_cli.method.weights.harmonic import harmonic_weights
from cageik_cli.run.executor import MAX_BLOCK_FRAMES
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.util import compiled
from cageik_cli.util.threads import count_processors, limit_blas_threads
from tests.shapes import ball, inside

pytestmark = pytest.mark.bench
WALKER = Path(__file__).parents[2] / "data_fixtures/walker"


def best_of(runs, work):
    """Shortest of several runs, seconds."""
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def show(what, ours, yardstick, name):
    print(f"\n{what}: {ours:.4f} s, {yardstick / ours:.2f} times as fast as {name}", end="")
    return yardstick / ours


def test_reading_against_trimesh():
    paths = sorted((WALKER / "frames").iterdir())
    sequence = open_sequence([str(WALKER / "frames")])
    ours = best_of(3, lambda: list(sequence.blocks(MAX_BLOCK_FRAMES, count_processors())))
    theirs = best_of(2, lambda: [trimesh.load(p, process=False) for p in paths])
    assert show("reading 48 OBJ frames", ours, theirs, "a trimesh.load loop") > 1


def test_reading_obj_of_ten_thousand_vertices(tmp_path):
    """As many as samba has, in two threads: the bar is 40 times the speed of trimesh."""
    points, faces = _torus(100)
    rows = "\n".join("f {} {} {}".format(*face) for face in (faces + 1).tolist())
    for k in range(24):
        moved = (points * (1 + 0.01 * k)).tolist()
        lines = "\n".join("v {:.9g} {:.9g} {:.9g}".format(*point) for point in moved)
        (tmp_path / f"frame_{k}.obj").write_text(f"{lines}\n{rows}\n")
    sequence = open_sequence([str(tmp_path)])
    ours = best_of(5, lambda: list(sequence.blocks(MAX_BLOCK_FRAMES, 2))) / len(sequence)
    paths = sorted(tmp_path.iterdir())[:8]
    theirs = best_of(3, lambda: [_by_trimesh(path) for path in paths]) / len(paths)
    assert show(f"an OBJ frame of {len(points)} vertices", ours, theirs, "trimesh.load") >= 40


def _torus(count):
    """Vertices and triangles of a torus of `count` times `count` squares."""
    u, v = np.indices((count, count)).reshape(2, -1) * 2 * np.pi / count
    ring = 1 + 0.3 * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), 0.3 * np.sin(v)], axis=1)
    a = np.arange(count * count).reshape(count, count)
    b, d = np.roll(a, -1, axis=0), np.roll(a, -1, axis=1)
    c = np.roll(b, -1, axis=1)
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    return points, faces.reshape(-1, 3)


def _by_trimesh(path):
    return trimesh.load(path, process=False, maintain_order=True)


def test_solving_against_a_plain_product_and_lstsq():
    """The products of the solve stage, and the whole of it, for samba's shape."""
    m, n, k = 9971, 120, MAX_BLOCK_FRAMES
    generator = np.random.default_rng(0)
    weights = generator.dirichlet(np.ones(n), m)
    cage = TriMesh(generator.normal(size=(n, 3)), [[i, (i + 1) % n, (i + 7) % n] for i in range(n)])
    rest = TriMesh(weights @ cage.vertices, [[0, 1, 2]])
    solver = DualLaplacianSolver(Binding(rest, cage, weights), SolveSettings())
    frames = rest.vertices + 0.01 * generator.normal(size=(k, m, 3))
    columns = np.ascontiguousarray(frames.transpose(1, 0, 2).reshape(m, 3 * k))
    rows = np.ascontiguousarray(weights.T)
    with limit_blas_threads(1):
        plain = best_of(9, lambda: weights @ (rows @ columns))
        products = best_of(9, lambda: solver._weights @ solver.solve_displacements(columns))
        whole = best_of(9, lambda: solver.solve(frames))
    flops = 4 * m * n * 3 * k
    print(
        f"\nsolving {k} frames: products {flops / products / 1e9:.1f} GFLOP/s, plain numpy "
        f"{flops / plain / 1e9:.1f}; with alignment and copies {flops / whole / 1e9:.1f}",
        end="",
    )
    theirs = best_of(1, lambda: [np.linalg.lstsq(weights, f, rcond=None) for f in frames[:2]])
    assert show(f"solving {k} frames", whole, theirs * k / 2, "lstsq frame by frame") > 10


@pytest.mark.parametrize("accuracy", ["preview", "standard"])
def test_binding_compiled_against_python(accuracy, monkeypatch):
    """Nanoseconds per point and panel, products with the densities and all."""
    cage = ball(2, 1.0)
    points = inside(cage, 4000)
    panels = harmonic_weights(cage, points, accuracy, jobs=1).panels

    def work():
        return best_of(3, lambda: harmonic_weights(cage, points, accuracy, jobs=1))

    ours = work()
    monkeypatch.setattr(compiled, "kernel", None)
    theirs = work()
    each = 1e9 / (len(points) * panels)
    print(f"\nper point and panel: {ours * each:.0f} ns, in Python {theirs * each:.0f} ns", end="")
    assert show(f"binding 4000 points, {accuracy}", ours, theirs, "Python") > 1


def test_extracting_against_the_obvious_script(tmp_path):
    """trimesh.load and lstsq for every frame, with our own weights given for nothing."""
    paths = sorted((WALKER / "frames").iterdir())
    cage = load_mesh(WALKER / "cage.obj").mesh
    weights = bind(open_sequence([str(WALKER / "frames")]).first, cage).weights
    settings = ExtractSettings(
        frames=(str(WALKER / "frames"),),
        cage=WALKER / "cage.obj",
        output=tmp_path / "cages.h5",
        overwrite=True,
        jobs=count_processors(),
    )

    def obvious():
        for path in paths:
            frame = np.asarray(trimesh.load(path, process=False).vertices)
            np.linalg.lstsq(weights, frame, rcond=None)

    ours, theirs = best_of(3, lambda: extract(settings)), best_of(2, obvious)
    assert show("extracting the walker, bind and all", ours, theirs, "reading and lstsq alone") > 0
