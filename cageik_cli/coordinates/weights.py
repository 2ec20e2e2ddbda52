"""Weights, their estimated error, and the accuracies to choose from."""

from dataclasses import dataclass

from cageik_cli.util.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Coordinates of m points in a cage of n vertices.

    Attributes
    ----------
    values : (m, n) float64
        Rows sum to one, and `values @ cage.vertices` are the points.
    panels : int
        Number of panels the cage was divided into; 0 for coordinates in closed form.
    error : float
        Estimate of the mean over points of a row's L1 distance from the exact coordinates; 0 in
        closed form.
    """

    values: Floats
    panels: int = 0
    error: float = 0.0


def ignore_progress(done: int, total: int) -> None:
    """Ignore the progress."""
