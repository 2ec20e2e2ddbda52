"""The kinds of coordinates, and the settings of weights. This module imports no numerics."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pkgutil import resolve_name
from typing import Any

from cageik_cli.util.settings import HelpGroup, check_settings, declare_setting


@dataclass(frozen=True, slots=True)
class Coordinates:
    """A kind of coordinates: what computes its weights, and what is known of them.

    Functions are named as `MODULE:NAME`, because their modules are slow to import.

    Attributes
    ----------
    version : int
        Raised when weights, notes or refusals change, so that caches are not used.
    function : str
        Computes `Weights` of a cage and of points in it, as `harmonic_weights` does.
    needs_accuracy : bool
        Whether functions take an accuracy; weights in closed form have none.
    field : str, optional
        Returns an object whose `gradient` returns those of the weights, as
        `HarmonicField.solve` does; without it, points have no normals that turn, and no splats.
    lowest_weight : float, optional
        Computed weights below it give a warning, where exact ones are never negative.
    lowest_meaning, lowest_expected : str
        What a report says of the smallest weight, and what is usual.
    """

    version: int
    function: str
    needs_accuracy: bool = False
    field: str | None = None
    lowest_weight: float | None = None
    lowest_meaning: str = ""
    lowest_expected: str = ""

    def load(self, function: str, accuracy: str) -> Callable[..., Any]:
        """Import one of its functions, and return it with the accuracy, if it takes one."""
        found: Callable[..., Any] = resolve_name(function)
        return partial(found, accuracy=accuracy) if self.needs_accuracy else found


COORDINATES = {
    "harmonic": Coordinates(
        version=10,
        function="cageik_cli.method.weights.harmonic:harmonic_weights",
        needs_accuracy=True,
        field="cageik_cli.method.points.field:HarmonicField.solve",
        lowest_weight=-0.05,  # those of sound cages stay above −0.02
        lowest_meaning="Exact harmonic weights are never negative; a negative one shows the size "
        "of the error.",
    ),
    "mean-value": Coordinates(
        version=4,
        function="cageik_cli.method.weights.mean_value:mean_value_weights",
        lowest_meaning="Mean value weights can be negative near concave parts of a cage. There "
        "the model moves against the cage.",
        lowest_expected="close to zero",
    ),
}
"""The kinds of coordinates, by their names."""

OUTSIDE_POLICIES = ("refuse", "project")
"""What may be done with vertices outside the cage."""


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


@dataclass(frozen=True, slots=True)
class BindSettings:
    """How weights are computed; coordinates in closed form ignore the accuracy."""

    coordinates: str = declare_setting(
        "harmonic",
        "Type of coordinates.",
        name="coordinates",
        meaning="type of coordinates",
        choices=COORDINATES,
        group=HelpGroup.SOLVE,
    )
    accuracy: str = declare_setting(
        "standard",
        "Tolerance of the weights, the mean L1 error of a row: "
        + ", ".join(f"{known.tolerance} {name}" for name, known in ACCURACIES.items())
        + ".",
        name="accuracy",
        meaning="accuracy of the harmonic weights",
        choices=tuple(ACCURACIES),
        group=HelpGroup.SOLVE,
    )
    outside: str = declare_setting(
        "refuse",
        "Vertices outside the cage: refuse them, or project them to the nearest point of the cage.",
        name="outside",
        meaning="treatment of vertices outside the cage",
        choices=OUTSIDE_POLICIES,
        group=HelpGroup.SOLVE,
    )

    def __post_init__(self) -> None:
        check_settings(self)
