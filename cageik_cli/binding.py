"""A rest model in its rest cage: the weights that tie them, with figures of their quality."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cageik_cli.coordinates.harmonic import harmonic_weights, no_progress
from cageik_cli.enclosure import check_enclosure
from cageik_cli.errors import InputError, NumericalError
from cageik_cli.mesh import Floats, TriMesh

WORST_PRECISION = 1e-6
"""Weights that miss the rest pose by more, in diagonals, are not weights of this cage."""


@dataclass(frozen=True, slots=True, eq=False)
class Binding:
    """A model written in the vertices of a cage: `weights @ cage.vertices` are `rest.vertices`.

    Attributes
    ----------
    rest : TriMesh
        m vertices.
    cage : TriMesh
        n vertices, outward.
    weights : (m, n) float64
        H; each row sums to one.
    notes : tuple of str
        What was changed in the cage, one sentence each.
    """

    rest: TriMesh
    cage: TriMesh
    weights: Floats
    notes: tuple[str, ...] = ()

    @property
    def partition_of_unity(self) -> float:
        """Largest distance of a row's sum from one."""
        return float(np.abs(self.weights.sum(axis=1) - 1).max())

    @property
    def linear_precision(self) -> float:
        """Largest distance of `weights @ cage` from the rest vertices, in diagonals."""
        origin = self.rest.vertices.mean(axis=0)
        rebuilt = self.weights @ (self.cage.vertices - origin)
        misses = np.linalg.norm(rebuilt - (self.rest.vertices - origin), axis=1)
        return float(misses.max() / self.rest.diagonal)

    @property
    def min_weight(self) -> float:
        """Smallest weight; harmonic weights are not negative, so this measures discretisation."""
        return float(self.weights.min())


def bind(
    rest: TriMesh,
    cage: TriMesh,
    jobs: int | None = None,
    progress: Callable[[int, int], None] = no_progress,
) -> Binding:
    """Write the rest model in harmonic coordinates of the cage.

    Raises
    ------
    InputError
        When the cage is not fit to hold the model.
    NumericalError
        When the weights do not reproduce the rest model.
    """
    if rest.diagonal == 0:
        raise InputError("the rest pose is one point, expected a surface; export it again")
    held = check_enclosure(cage, rest)
    weights = harmonic_weights(held.cage, held.points, jobs, progress)
    binding = Binding(rest, held.cage, weights, held.notes)
    if not binding.linear_precision <= WORST_PRECISION:
        raise NumericalError(
            f"the weights miss the rest pose by {binding.linear_precision:.1e} of the diagonal, "
            f"more than {WORST_PRECISION:.0e}; the cage may cross itself or have needle-like faces"
        )
    return binding
