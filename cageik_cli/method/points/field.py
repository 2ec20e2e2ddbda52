"""The harmonic coordinates of a cage as functions of a point: their values and gradients."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cageik_cli.geometry.mesh import TriMesh, validate_positions
from cageik_cli.geometry.surface import ClosestPoints, closest_points, winding_numbers
from cageik_cli.method.points.gradients import WeightGradients
from cageik_cli.method.weights.bem.boundary_equation import BoundarySolution, interior_weights
from cageik_cli.method.weights.harmonic import HarmonicSolution, check_request
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import CageError
from cageik_cli.util.progress import ignore_progress


@dataclass(frozen=True, eq=False)
class HarmonicField:
    """The harmonic weights of a cage, as functions of a point inside or on it.

    Make one with `HarmonicField.solve`.

    Attributes
    ----------
    cage : TriMesh
        n vertices.
    solution : HarmonicSolution
        At the points that it was solved for.
    boundary : BoundarySolution
        Of the cage in its own units: centred, with a diagonal of one.
    error : float
        Estimate of the mean row L1 error at those points.

    Examples
    --------
    >>> from cageik_cli import HarmonicField, load_mesh
    >>> cage = load_mesh("data_fixtures/walker/cage.obj")
    >>> model = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> field = HarmonicField.solve(cage, model.vertices, accuracy="preview")
    >>> field
    <HarmonicField: a cage of 80>
    >>> gradient = field.gradient(model.vertices[:10])
    >>> gradient.shape
    (10, 80, 3)
    >>> stretch = gradient.swapaxes(1, 2) @ cage.vertices
    >>> bool(abs(stretch - [[1, 0, 0], [0, 1, 0], [0, 0, 1]]).max() < 1e-12)
    True
    """

    cage: TriMesh
    solution: HarmonicSolution

    def __repr__(self) -> str:
        return f"<HarmonicField: a cage of {len(self.cage.vertices)}>"

    @staticmethod
    def solve(
        cage: TriMesh, points: Floats, accuracy: str = "standard", jobs: int | None = None
    ) -> "HarmonicField":
        """Solve for the weights of a cage, to a tolerance at given points.

        Parameters
        ----------
        cage : TriMesh
            As of `bind`, turned outward.
        points : (m, 3)
            Where the weights are wanted, file units. For the points of a `Binding`, the field
            is the one that its weights came from; those are rounded in the seventh digit.
        accuracy : str
            One of `ACCURACIES`.
        jobs : int, optional
            Threads; the number of processors by default. They do not change the result.

        Raises
        ------
        CageikError
            When the accuracy is unknown, or the cage has too many faces.
        """
        check_request(cage, accuracy)
        points = validate_positions(points)
        within = ~closest_points(cage, points).is_touching
        inside = points[within] if within.any() else points
        return HarmonicField(cage, HarmonicSolution(cage, inside, accuracy, jobs))

    @property
    def boundary(self) -> BoundarySolution:
        """Return the densities of the weights."""
        return self.solution.boundary

    @property
    def error(self) -> float:
        """Return the estimated error of the weights."""
        return self.solution.error

    def evaluate(
        self,
        points: Floats,
        jobs: int | None = None,
        progress: Callable[[int, int], None] = ignore_progress,
    ) -> Floats:
        """Return the weights of points inside or on the cage, (m, 3), as (m, n).

        A point on it has barycentric weights. `progress` is called with (points done, points).

        Raises
        ------
        CageError
            When a point is outside.
        """
        points = validate_positions(points)
        nearest = self._locate(points)
        weights = np.empty((len(points), len(self.cage.vertices)))
        weights[nearest.is_touching] = nearest.barycentric_weights(nearest.is_touching)

        def fill(chosen: Integers, places: Floats) -> None:
            weights[chosen] = interior_weights(self.boundary, places)

        within = np.flatnonzero(~nearest.is_touching)
        self.solution.visit_blocks(points, within, fill, jobs, progress)
        return weights

    def gradient(
        self,
        points: Floats,
        jobs: int | None = None,
        progress: Callable[[int, int], None] = ignore_progress,
    ) -> Floats:
        """Return the gradients of the weights at points inside or on the cage, as (m, n, 3).

        They are exact derivatives of what `evaluate` computes, per file unit. On the cage they are
        the limit from inside. Sums are exact to rounding: the gradients of a point sum to zero, and
        Σ_k c_k ⊗ ∇w_k is the identity. Memory is 24 m n bytes for the result.

        Raises
        ------
        CageError
            When a point is outside.
        """
        points = validate_positions(points)
        nearest = self._locate(points)
        gradients = np.empty((len(points), len(self.cage.vertices), 3))
        on_cage = np.flatnonzero(nearest.is_touching)
        size = 4096  # points on the cage whose gradients are computed together
        for start in range(0, len(on_cage), size):
            chosen = on_cage[start : start + size]
            gradients[chosen] = self._gradient_on_cage(nearest, chosen).transpose(2, 1, 0)

        def fill(chosen: Integers, places: Floats) -> None:
            gradients[chosen] = self._gradients.evaluate(places).transpose(2, 1, 0)

        within = np.flatnonzero(~nearest.is_touching)
        self.solution.visit_blocks(points, within, fill, jobs, progress)
        gradients /= self.solution.scale
        return gradients

    def _locate(self, points: Floats) -> ClosestPoints:
        """Return the closest points of the cage; refuse points outside it."""
        nearest = closest_points(self.cage, points)
        within = np.flatnonzero(~nearest.is_touching)
        outside = within[winding_numbers(self.cage, points[within]) < 0.5]
        if len(outside):
            raise CageError(
                f"{len(outside)} of {len(points)} points are outside the cage, the first is number "
                f"{outside[0]} (from 0); take their closest points on it"
            )
        return nearest

    def _gradient_on_cage(self, nearest: ClosestPoints, chosen: Integers) -> Floats:
        """Return the limits of the gradients from inside, (3, n, q), in the unit frame."""
        places = self.solution.to_units(nearest.position[chosen])
        panels = closest_points(self._surface, places).face
        return self._gradients.evaluate_on_panels(places, panels)

    @cached_property
    def _gradients(self) -> WeightGradients:
        return WeightGradients(self.boundary)

    @cached_property
    def _surface(self) -> TriMesh:
        """The panels as a mesh."""
        panels = self.boundary.mesh.panels
        return TriMesh(panels.vertices, panels.corners)
