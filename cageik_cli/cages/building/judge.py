"""Whether a cage may be handed out, by exact tests, and how good it is."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.building.clearance import find_near_points
from cageik_cli.cages.building.decimate import euler_characteristic
from cageik_cli.cages.quality import MIN_ANGLE, find_thin_parts
from cageik_cli.cages.soundness import find_cage_faults
from cageik_cli.geometry.intersections import crossing_face_pairs
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import corner_angles
from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.util.arrays import Floats

LOOK = 2.0
"""How far the clearance is looked for, in those asked for."""


@dataclass(frozen=True, slots=True, eq=False)
class Demand:
    """The requirements on a cage.

    Attributes
    ----------
    surface : TriMesh
        What it must hold: every face, and every vertex.
    samples : (s, 3) float64
        Points of the surface.
    clearance : float
        How far it must keep off; units of the surface.
    fewest, most : int
        Cage vertices.
    """

    surface: TriMesh
    samples: Floats
    clearance: float
    fewest: int
    most: int


@dataclass(frozen=True, slots=True)
class Verdict:
    """The figures and the faults of a cage.

    Attributes
    ----------
    faults : tuple of str
        Empty for a cage that may be handed out.
    clearance : float
        Smallest distance of the surface from the cage, units of the surface; infinite beyond twice
        what was asked for, 0 if the cage itself is faulty.
    smallest_angle : float
        Degrees.
    looseness : float
        Mean distance of the samples from the cage, units of the surface.
    """

    faults: tuple[str, ...]
    genus: int
    clearance: float
    smallest_angle: float
    largest_valence: int
    looseness: float

    @property
    def is_valid(self) -> bool:
        """Return whether the cage has no fault."""
        return not self.faults


def judge(cage: TriMesh, demand: Demand) -> Verdict:
    """Test a cage against what it must do."""
    faults = list(_own_faults(cage, demand))
    clearance = 0.0
    if not faults:
        clearance = find_near_points(demand.surface, cage, LOOK * demand.clearance).clearance
        faults += _holding_faults(cage, demand, clearance)
    return Verdict(
        faults=tuple(faults),
        genus=1 - euler_characteristic(cage) // 2,
        clearance=clearance,
        smallest_angle=float(corner_angles(cage).min()),
        largest_valence=int(np.bincount(cage.edges.ends.ravel()).max()),
        looseness=float(closest_points(cage, demand.samples).distance.mean()),
    )


def _own_faults(cage: TriMesh, demand: Demand) -> tuple[str, ...]:
    """Return the faults of the cage itself."""
    count = len(cage.vertices)
    if not demand.fewest <= count <= demand.most:
        return (f"has {count} vertices, expected {demand.fewest} to {demand.most}",)
    findings = find_cage_faults(cage)
    if findings:
        return tuple(finding.message.removeprefix("the cage ") for finding in findings)
    angle = corner_angles(cage).min()
    if angle < MIN_ANGLE:
        return (f"has an angle of {angle:.2g} degrees, expected {MIN_ANGLE:g} or more",)
    return tuple(finding.message.removeprefix("the cage ") for finding in find_thin_parts(cage))


def _holding_faults(cage: TriMesh, demand: Demand, clearance: float) -> tuple[str, ...]:
    """Return the faults of the cage around the model."""
    outside = np.count_nonzero(winding_numbers(cage, demand.samples) < 0.5)
    if outside:
        return (f"leaves {outside} of {len(demand.samples)} surface points outside",)
    if len(pairs := crossing_face_pairs(demand.surface, cage, 0.0)):
        return (f"is crossed by {len(np.unique(pairs[:, 0]))} faces of the model",)
    if clearance < demand.clearance:
        share = clearance / demand.clearance
        return (f"is nearer to the model than asked for, {share:.2g} of the clearance",)
    return ()
