"""The error of weights against random walks: `python -m tests.benchmarks.walks [CAGE MODEL ...]`.

Walks on spheres (Muller 1956) share nothing with boundary elements. The mean of the hats where
walks from a point meet the cage is its row of harmonic weights, without bias but for the last hop,
a millionth of the diagonal. To have less noise, the walks average what a harmonic function leaves
of each hat: a sum of sources outside the cage, whose value at the point is known.
"""

import sys
from dataclasses import dataclass

import igl
import numpy as np

from cageik_cli.cages.bind import bind
from cageik_cli.formats.open import load_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import winding_numbers
from cageik_cli.method.weights.harmonic import harmonic_weights
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.threads import limit_blas_threads
from tests.benchmarks.walked_cages import make_cages
from tests.texts import texts

POINTS = 64
"""Vertices of a model whose rows are compared, evenly spread over their numbers."""

WALKS = 1000
"""From each of them."""

STOP_DISTANCE = 1e-6
"""Walks end this near to the cage, diagonals."""

SOURCES_PER_VERTEX = 8
"""Outside the cage, at most; not fewer than for a cage of 120."""


@dataclass(frozen=True, slots=True, eq=False)
class Sources:
    """Harmonic functions, each near to a hat of a cage.

    Attributes
    ----------
    places : (s, 3) float64
    strengths : (s, n) float64
    """

    places: np.ndarray
    strengths: np.ndarray

    def evaluate(self, points: np.ndarray) -> np.ndarray:
        """Return the functions at points, (q, n)."""
        squares = (points**2).sum(axis=1)[:, None] + (self.places**2).sum(axis=1)
        squares -= 2 * points @ self.places.T
        return (1 / np.sqrt(squares)) @ self.strengths


def fit_sources(cage: TriMesh, generator: np.random.Generator) -> Sources:
    """Fit sources outside the cage to its hats by least squares, with a small ridge."""
    count = SOURCES_PER_VERTEX * max(120, len(cage.vertices))
    places, face, _ = _sample_cage(cage, count, generator)
    corner = cage.vertices[cage.faces]
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    spacing = np.sqrt(cage.face_areas.sum() / count)
    places += 1.5 * spacing * normals[face]
    places = places[winding_numbers(cage, places) < 0.5]
    distance = np.sqrt(_find_closest(cage, places)[0])
    places = places[distance > 0.5 * spacing]
    on_cage, _, hats = _sample_cage(cage, 5 * count, generator)
    matrix = Sources(places, np.eye(len(places))).evaluate(on_cage)
    normal = matrix.T @ matrix
    normal += 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal))
    return Sources(places, np.linalg.solve(normal, matrix.T @ hats))


def _sample_cage(cage, count, generator):
    """Random points on a cage, (count, 3), their faces, and the hats there, (count, n)."""
    share = np.sqrt(cage.face_areas)  # small faces have more than their area's
    face = generator.choice(len(cage.faces), count, p=share / share.sum())
    barycentric = generator.dirichlet([1, 1, 1], count)
    hats = np.zeros((count, len(cage.vertices)))
    np.put_along_axis(hats, cage.faces[face], barycentric, axis=1)
    return hats @ cage.vertices, face, hats


def _find_closest(cage, points):
    squares, face, place = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points), cage.vertices, np.asarray(cage.faces, np.int64)
    )
    return squares, face, place


def walk(cage: TriMesh, starts: np.ndarray, generator: np.random.Generator):
    """Walk from each of `starts`, (q, 3), to the cage; return where walks end, faces and places."""
    points = starts.copy()
    face, place = np.zeros(len(points), np.int64), points.copy()
    walking = np.arange(len(points))
    while len(walking):
        squares, face[walking], place[walking] = _find_closest(cage, points[walking])
        radius = np.sqrt(squares)
        left = radius > STOP_DISTANCE * cage.diagonal
        walking, radius = walking[left], radius[left]
        steps = generator.normal(size=(len(walking), 3))
        points[walking] += steps * (radius / np.linalg.norm(steps, axis=1))[:, None]
    return points, face, place


def estimate_rows(
    cage: TriMesh, points: np.ndarray, walks: int = WALKS, seed: int = 0
) -> np.ndarray:
    """Estimate rows of harmonic weights at points inside, (q, 3), by each half of the walks.

    Returns
    -------
    (2, q, n)
    """
    generator = np.random.default_rng(0)
    sources = fit_sources(cage, generator)
    known, size = sources.evaluate(points), 50
    halves = np.zeros((2, *known.shape))
    for half in halves:
        for _ in range(walks // 2 // size):
            ends, face, place = walk(cage, np.repeat(points, size, axis=0), generator)
            left = -sources.evaluate(ends)
            corners = [cage.vertices[cage.faces[face, k]] for k in range(3)]
            hats = igl.barycentric_coordinates(place, *map(np.ascontiguousarray, corners))
            rows = np.arange(len(left))[:, None]
            left[rows, cage.faces[face]] += hats
            half += left.reshape(len(points), size, -1).sum(axis=1)
        half *= 1 / (walks // 2 // size * size)
        half += known
    return halves


def measure_error(
    halves: np.ndarray, weights: np.ndarray, finer: np.ndarray
) -> tuple[float, float]:
    """Return the mean L1 distance of rows of weights, (q, n), from walks, and its standard error.

    The sum of distances with the signs of a finer solution: noise, which would add to absolute
    values, cancels in it. Where signs are wrong, the distance is too small, and never too large.
    """
    one, other = (np.sign(finer - weights) * (halves - weights)).sum(axis=2)
    noise = np.sqrt(np.square(one - other).mean() / len(one)) / 2
    return float((one + other).mean()) / 2, float(noise)


def show(name: str, cage: TriMesh, model: TriMesh) -> None:
    """Print the stated and the true error of the weights of a model in a cage."""
    binding = bind(model, cage, BindSettings(outside="project"))
    chosen = np.linspace(0, len(model.vertices) - 1, POINTS).astype(int)
    points = model.vertices[chosen]
    finer = harmonic_weights(binding.cage, points, "fine").values
    true, noise = measure_error(estimate_rows(binding.cage, points), binding.weights[chosen], finer)
    stated = binding.estimated_error
    notes = [
        note.split(";")[0] for note in texts(binding.notes) if "error" in note or "sheets" in note
    ]
    print(
        f"| {name} | {len(cage.vertices)} | {stated:.4f} | {true:.4f} ± {noise:.4f} "
        f"| {true / stated:.2f} | {'; '.join(notes)} |",
        flush=True,
    )


def main(words: list[str]) -> None:
    """Compare given cages and models, by turns, or those of `walked_cages`."""
    print("| cage | vertices | stated | true | true over stated | note |")
    print("|---|--:|--:|--:|--:|---|")
    given = {
        cage: (load_mesh(cage).mesh, load_mesh(model).mesh)
        for cage, model in zip(words[::2], words[1::2], strict=True)
    }
    with limit_blas_threads(1):
        for name, (cage, model) in (given or make_cages()).items():
            show(name, cage, model)


if __name__ == "__main__":
    main(sys.argv[1:])
