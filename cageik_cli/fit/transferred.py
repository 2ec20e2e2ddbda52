"""What a fit has changed of the weights of a model, transferred to other points in the same cage.

With ΔW = W − H at the vertices of the model, the weights of a point x are

    W(x) = H(x) + f(d) Σ_j b_j ΔW_j,

where d is its distance from the model at rest and b are the barycentric coordinates of the closest
point on it. f falls from 1 on the surface to 0 at `MAX_TRANSFER_DISTANCE`, with a slope of 0 at
both ends, so that gradients do not jump there. The rows of ΔW are orthogonal to 1 and to the cage's
coordinates: the rows of W(x) still sum to one and give x.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import ClosestPoints, closest_points
from cageik_cli.method.weights.binding import Binding, divide_rows
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.threads import run_blocks

MAX_TRANSFER_DISTANCE = 0.1
"""Distance from the model, in its diagonals, from which on nothing of a fit is transferred."""


def compute_fade(distances: Floats) -> tuple[Floats, Floats]:
    """Return f and its derivative at distances (m,), in parts of where it has become 0."""
    t = np.minimum(distances, 1)
    return 1 - t * t * (3 - 2 * t), 6 * t * (t - 1)


@dataclass(frozen=True, slots=True, eq=False)
class TransferPlaces:
    """The closest points on a model of m others.

    Attributes
    ----------
    corners : (m, 3) int64
        Vertices of the model.
    shares : (m, 3) float64
        b of these.
    """

    nearest: ClosestPoints
    corners: Integers
    shares: Floats

    @property
    def distances(self) -> Floats:
        """Return the distances from the model, (m,), in its diagonals."""
        return np.asarray(self.nearest.distance / self.nearest.mesh.diagonal)

    def find_vertices(self, points: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return which of the points are vertices of the model, (k,), and which vertices."""
        likely = np.take_along_axis(self.corners, self.shares.argmax(axis=1)[:, None], axis=1)[:, 0]
        apart = np.linalg.norm(points - self.nearest.mesh.vertices[likely], axis=1)
        found = np.flatnonzero(apart <= self.nearest.tolerance)
        return found, likely[found]


class TransferredChange:
    """The change that a fit has made to the weights of a model, as a function of a point.

    Parameters
    ----------
    fitted : Binding
        The model, of m vertices and with faces, and its weights W.
    computed : (m, n) float64
        H, as the weights of others in the cage are computed.
    """

    def __init__(self, fitted: Binding, computed: Floats) -> None:
        self._fitted = fitted
        self._change = fitted.weights - computed
        if not fitted.has_offsets:
            # What it does to 1 and to the cage's coordinates is rounding, and more for a vertex
            # outside the cage, which was at another point before.
            places = fitted.cage.vertices
            affine = np.column_stack([np.ones(len(places)), places - places.mean(axis=0)])
            basis = np.linalg.qr(affine)[0]
            self._change -= (self._change @ basis) @ basis.T

    @property
    def model(self) -> TriMesh:
        """The model at rest, whose weights were fitted."""
        return self._fitted.rest

    def locate(self, points: Floats) -> TransferPlaces:
        """Find the closest points on the model of points, (m, 3)."""
        nearest = closest_points(self.model, points)
        shares = nearest.barycentric_coordinates(np.ones(len(points), bool))
        return TransferPlaces(nearest, self.model.faces[nearest.face], shares)

    def add_to(self, binding: Binding, places: TransferPlaces) -> Binding:
        """Return computed weights of points in the cage with the change.

        Points at vertices of the model have its fitted weights, to the bit. The weights of
        `binding` are changed in place, because they may take most of the memory.

        Parameters
        ----------
        places : TransferPlaces
            Of its points.
        """
        weights, points = binding.weights, binding.rest.vertices
        fade, _ = compute_fade(places.distances / MAX_TRANSFER_DISTANCE)
        spread = _make_rows(places.corners, fade[:, None] * places.shares, len(self._change))
        parts = divide_rows(*weights.shape)

        def fill(chosen: slice) -> None:
            for rows in parts[chosen]:
                weights[rows] += spread[rows] @ self._change

        run_blocks(fill, len(parts), 1)
        own, vertices = places.find_vertices(points)
        weights[own] = self._fitted.weights[vertices]
        has_offsets = self._fitted.has_offsets
        return replace(binding, weights=weights, has_offsets=has_offsets)

    def add_gradients_to(self, gradients: Floats, points: Floats) -> None:
        """Add the gradients of the change at points, (m, 3), to those of their weights, (m, n, 3).

        They are exact derivatives: those of f Σ_j b_j ΔW_j are f ∇b_j + b_j ∇f, times ΔW_j. On the
        surface, they are those along the closest face.
        """

        def fill(rows: slice) -> None:
            places = self.locate(points[rows])
            fade, slope = compute_fade(places.distances / MAX_TRANSFER_DISTANCE)
            away, distance = points[rows] - places.nearest.position, places.nearest.distance
            slope = slope / np.where(distance > 0, distance, 1)  # is 0 where the distance is
            by_fade = (slope / (MAX_TRANSFER_DISTANCE * self.model.diagonal))[:, None] * away
            factors = fade[:, None, None] * places.nearest.differentiate_coordinates(places.shares)
            factors += places.shares[:, :, None] * by_fade[:, None]
            gradients[rows] += np.matmul(self._change[places.corners].swapaxes(1, 2), factors)

        run_blocks(fill, len(points), 1024)  # points at once

    def predict_left_out(self, motions: Floats) -> Floats:
        """Return what is transferred to each vertex of the model if its own faces are not there.

        It then comes from the closest point on the sides across from it.

        Parameters
        ----------
        motions : (m, c)
            What is transferred, at the vertices. It is 0 at vertices that are in no face.
        """
        turns = np.concatenate([np.roll(self.model.faces, -k, axis=1) for k in range(3)])
        corner, start, end = self.model.vertices[turns].swapaxes(0, 1)
        side = end - start
        squares = np.einsum("ix,ix->i", side, side)
        along = np.einsum("ix,ix->i", corner - start, side)
        share = np.divide(along, squares, out=np.zeros_like(along), where=squares > 0).clip(0, 1)
        distances = np.linalg.norm(start + share[:, None] * side - corner, axis=1)
        # Of the sides across from each vertex, the closest.
        order = np.lexsort((distances, turns[:, 0]))
        rows, first = np.unique(turns[order, 0], return_index=True)
        chosen = order[first]
        shares = np.stack([1 - share[chosen], share[chosen]], axis=1)
        fade, _ = compute_fade(distances[chosen] / (MAX_TRANSFER_DISTANCE * self.model.diagonal))
        found = np.zeros_like(motions)
        found[rows] = _make_rows(turns[chosen, 1:], fade[:, None] * shares, len(motions)) @ motions
        return found


def _make_rows(places: Integers, shares: Floats, count: int) -> csr_array:
    """Return a matrix (m, count) with the shares (m, k) at the places (m, k) of each row."""
    starts = np.arange(0, places.size + 1, places.shape[1])
    return csr_array((shares.ravel(), places.ravel(), starts), shape=(len(places), count))
