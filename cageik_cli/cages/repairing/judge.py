"""Whether a cage may be handed out as fit, by exact tests."""

from dataclasses import dataclass

from cageik_cli.cages.enclosure import locate_vertices
from cageik_cli.cages.findings import Finding
from cageik_cli.cages.quality import (
    find_low_clearance,
    find_needle_faces,
    find_surface_crossings,
    find_thin_parts,
)
from cageik_cli.cages.soundness import find_cage_faults
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import winding_numbers
from cageik_cli.util.arrays import Floats

OUTWARD = "move the cage outward there"
"""What to do."""


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """The faults of a cage.

    Attributes
    ----------
    faults : tuple of Finding
        Why it does not hold the model; none of a cage that is fit.
    warnings : tuple of Finding
        What is poor about it, all the same.
    """

    faults: tuple[Finding, ...]
    warnings: tuple[Finding, ...]

    @property
    def is_fit(self) -> bool:
        """Return whether the cage is sound and holds the whole surface of the model."""
        return not self.faults


def judge_cage(cage: TriMesh, model: TriMesh, samples: Floats) -> Judgement:
    """Test a cage alone, and around every vertex, face and sample of the model."""
    faults = find_cage_faults(cage)
    if faults:
        return Judgement(faults, ())
    placement = locate_vertices(cage, model)
    is_outside = len(placement.outside_indices) > 0
    holding = [placement.find_outside(OUTWARD)] if is_outside else []
    holding += find_surface_crossings(placement)
    if not holding:
        holding += _find_outside_samples(cage, samples)
    warnings = [*find_needle_faces(cage), *find_thin_parts(cage)]
    if not is_outside:
        warnings += find_low_clearance(placement)
    return Judgement(tuple(holding), tuple(warnings))


def _find_outside_samples(cage: TriMesh, samples: Floats) -> list[Finding]:
    """Say so if points on faces of the model are outside."""
    outside = samples[winding_numbers(cage, samples) < 0.5]
    if len(outside) == 0:
        return []
    x, y, z = outside[0]
    message = (
        f"{len(outside)} of {len(samples)} points of the model's surface are outside the cage, "
        f"the first at ({x:.4g}, {y:.4g}, {z:.4g})"
    )
    return [Finding("surface-outside", "unfit", message, OUTWARD, value=float(len(outside)))]
