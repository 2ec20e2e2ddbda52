"""What every kind of coordinates gives: weights, and how far from exact they may be."""

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
        What the cage was divided into; 0 for coordinates in closed form.
    error : float
        Estimate of the mean over points of a row's L1 distance from the exact coordinates; 0 in
        closed form.
    """

    values: Floats
    panels: int = 0
    error: float = 0.0


@dataclass(frozen=True, slots=True)
class Accuracy:
    """What weights are computed to.

    Attributes
    ----------
    tolerance : float
        Mean over points of a row's L1 distance from exact weights.
    order : int
        Degree of the densities on panels that points come near.
    reach : float
        Radii of a panel at which what is beyond linear has half faded out.
    max_unknowns : int
        Unknowns not to be passed for accuracy's sake; the matrix takes 4 bytes times their square.
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
    """Tell nobody."""
