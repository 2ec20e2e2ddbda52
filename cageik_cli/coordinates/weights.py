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


@dataclass(frozen=True, slots=True)
class Accuracy:
    """The accuracy of harmonic weights, and the limits of their discretisation.

    Attributes
    ----------
    tolerance : float
        Largest mean over points of a row's L1 distance from exact weights.
    order : int
        Degree of the densities on panels close to points.
    reach : float
        Distance, in panel radii, at which terms beyond linear have half their strength.
    max_unknowns : int
        Largest number of unknowns; the matrix takes 4 bytes times its square.
    """

    tolerance: float
    order: int
    reach: float
    max_unknowns: int


ACCURACIES = {
    "preview": Accuracy(0.03, 1, 0.0, 9000),
    "standard": Accuracy(0.005, 3, 1.5, 15000),
    "fine": Accuracy(0.001, 5, 4.0, 15000),
}


def ignore_progress(done: int, total: int) -> None:
    """Ignore the progress."""
