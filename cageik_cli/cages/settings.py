"""Settings of cages that are built. This module imports no numerics."""

from dataclasses import dataclass
from typing import Literal, get_args

from cageik_cli.util.settings import check_settings, declare_setting

BUILDER_VERSION = 5
"""Raised when the same model and settings give another cage, so that kept ones are not used."""

MIN_VERTICES = 8
"""Fewer vertices make no useful cage."""

MAX_VERTICES = 2000
"""More vertices would make more faces than a cage may have."""

MAX_CLEARANCE = 0.2
"""The largest clearance, in diagonals."""

SymmetryChoice = Literal["auto", "x", "y", "z", "off"]
"""About which plane a cage is to be symmetric."""

DEFAULT_SYMMETRY: SymmetryChoice = "off"


@dataclass(frozen=True, slots=True)
class BuildSettings:
    """The size, the clearance and the symmetry of a cage that is built.

    Quads hold the model by either diagonal. The plane of a symmetric cage is across an axis; or
    that of a model that is its own mirror image.
    """

    vertices: int = declare_setting(
        100,
        "Vertices of the cage, at most; it has at least 0.9 times as many.",
        name="cage_vertices",
        meaning="vertices of the cage that was built, at most",
        option="--vertices",
        metavar="N",
        minimum=MIN_VERTICES,
        maximum=MAX_VERTICES,
        refusal=f"a cage of {{value}} vertices is asked for, expected {MIN_VERTICES} to "
        f"{MAX_VERTICES}",
    )
    clearance: float = declare_setting(
        0.004,
        "Smallest distance between cage and model, in percent of the diagonal.",
        name="cage_clearance",
        meaning="smallest distance of the cage that was built from the model, in diagonals",
        option="--clearance",
        is_share=True,
        above=0,
        maximum=MAX_CLEARANCE,
        refusal="the clearance is {percent:g} % of the diagonal, expected more than 0 and at most "
        f"{100 * MAX_CLEARANCE:g} %",
    )
    symmetric: SymmetryChoice = declare_setting(
        DEFAULT_SYMMETRY,
        "Build a cage that is its own mirror image: about the plane of a model that is one "
        "(auto), or across an axis.",
        name="cage_symmetric",
        meaning="plane that the cage that was built is symmetric about, if any",
        is_recorded_unset=False,  # so that earlier results are those of the default
        option="--symmetric",
        choices=get_args(SymmetryChoice),
        refusal="`symmetric=` is {value!r}, expected one of "
        f"{', '.join(map(repr, get_args(SymmetryChoice)))}",
    )
    quads: bool = declare_setting(
        False,
        "Make quads of most triangles; the model is inside by either diagonal.",
        name="cage_quads",
        meaning="most triangles of the cage that was built are quads",
        is_recorded_unset=False,
        option="--quads",
    )
    loops: bool = declare_setting(
        False,
        "Lay loops of 4 to 6 vertices around limbs, more where they bend.",
        name="cage_loops",
        meaning="loops of vertices go around limbs of the cage that was built",
        is_recorded_unset=False,
        option="--loops",
        excludes=(
            (
                "symmetric",
                "`loops=True` and `symmetric=` do not go together: loops are not laid by pairs; "
                "leave out one",
            ),
        ),
    )

    def __post_init__(self) -> None:
        check_settings(self)
