"""Settings of the weights and their defaults. This module imports no numerics."""

from dataclasses import dataclass

from cageik_cli.util.settings import HelpGroup, check_settings, declare_setting

COORDINATES = ("harmonic", "mean-value")

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
