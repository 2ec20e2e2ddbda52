"""Everything worth knowing of a cage, alone or with a rest pose in it, and a verdict."""

from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.cages.enclosure import (
    Placement,
    check_enclosure,
    outside_finding,
    place,
    point_finding,
)
from cageik_cli.cages.findings import SEVERITIES, Finding
from cageik_cli.cages.quality import (
    clearance_findings,
    crossing_findings,
    influence_findings,
    needle_findings,
    size_findings,
    thin_findings,
)
from cageik_cli.cages.soundness import cage_findings
from cageik_cli.coordinates.harmonic import PANEL_LIMIT, harmonic_weights
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import bounds_volume, corner_angles, is_flat
from cageik_cli.util.arrays import Floats, Integers

LISTED = 3
"""How many of the weakest cage vertices are facts."""

NOTHING: Integers = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True)
class CageFacts:
    """A cage in figures; None what it has not got.

    Attributes
    ----------
    vertices, faces, components : int
    genus : int, optional
        Handles, over all components; of closed manifolds.
    volume : float, optional
        Cubed file units, negative if the faces turn inward; of closed cages.
    smallest_angle : float, optional
        Degrees, of all corners of faces that have a plane.
    smallest_angle_face : int, optional
    """

    vertices: int
    faces: int
    components: int
    genus: int | None
    volume: float | None
    smallest_angle: float | None
    smallest_angle_face: int | None


@dataclass(frozen=True, slots=True)
class RestFacts:
    """A rest pose in its cage, in figures; None what was not to be had.

    Attributes
    ----------
    vertices, faces : int
    diagonal : float
        File units.
    outside : int, optional
        How many vertices are outside by more than rounding.
    clearance : float, optional
        Smallest distance from the cage of a vertex that is not, percent of the diagonal.
    clearance_vertex, clearance_face : int, optional
        Which vertex, from which cage face.
    weakest_vertices : tuple of int
        The cage vertices of least influence,
    weakest_weights : tuple of float
        and the largest weight each has anywhere on the model; of cages that bind.
    """

    vertices: int
    faces: int
    diagonal: float
    outside: int | None = None
    clearance: float | None = None
    clearance_vertex: int | None = None
    clearance_face: int | None = None
    weakest_vertices: tuple[int, ...] = ()
    weakest_weights: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """What was looked at and found.

    Attributes
    ----------
    cage : CageFacts
    rest : RestFacts, optional
    findings : tuple of Finding
        The worst first.
    """

    cage: CageFacts
    rest: RestFacts | None
    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> str:
        """`unfit`: does not bind; `usable`: binds, with something poor; `fit`."""
        severities = {finding.severity for finding in self.findings}
        return next((known for known in ("unfit", "usable") if known in severities), "fit")


def diagnose(cage: TriMesh, rest: TriMesh | None = None, jobs: int | None = None) -> Diagnosis:
    """Look at everything of a cage, and of a rest pose in it if there is one."""
    findings = [*cage_findings(cage), *_too_many_faces(cage), *needle_findings(cage)]
    sound = not _unfit(findings)
    if sound:
        findings += thin_findings(cage)
    kinds = {finding.kind for finding in findings}
    facts, rest_facts = _cage_facts(cage, is_manifold="pinched-vertex" not in kinds), None
    if rest is not None:
        has_inside = bounds_volume(cage) and "no-volume" not in kinds
        rest_facts, found = _rest_diagnosis(cage, rest, has_inside)
        findings += found
        if sound and not _unfit(found):
            rest_facts, found = _influence(cage, rest, rest_facts, jobs)
            findings += found
        elif len(cage.vertices) > len(rest.vertices):
            findings.append(_swapped(cage, rest))
    return Diagnosis(
        facts, rest_facts, tuple(sorted(findings, key=lambda f: SEVERITIES.index(f.severity)))
    )


def _unfit(findings: list[Finding]) -> bool:
    return any(finding.severity == "unfit" for finding in findings)


def _outward(cage: TriMesh) -> TriMesh:
    return cage if cage.volume > 0 else cage.flipped()


def _cage_facts(cage: TriMesh, is_manifold: bool) -> CageFacts:
    used, closed = np.unique(cage.faces), bounds_volume(cage)
    parts = len(np.unique(cage.components[used]))
    euler = len(used) - len(cage.edges.ends) + len(cage.faces)
    angles = np.where(is_flat(cage), np.inf, corner_angles(cage).min(axis=1))
    face = int(angles.argmin())
    measured = bool(np.isfinite(angles[face]))
    return CageFacts(
        vertices=len(cage.vertices),
        faces=len(cage.faces),
        components=parts,
        genus=parts - euler // 2 if closed and is_manifold else None,
        volume=cage.volume if closed else None,
        smallest_angle=float(angles[face]) if measured else None,
        smallest_angle_face=face if measured else None,
    )


def _rest_diagnosis(
    cage: TriMesh, rest: TriMesh, has_inside: bool
) -> tuple[RestFacts, list[Finding]]:
    facts = RestFacts(len(rest.vertices), len(rest.faces), rest.diagonal)
    if point := point_finding(rest):
        return facts, [point]
    if not has_inside:
        return facts, []
    placement = place(_outward(cage), rest)
    findings = [*crossing_findings(placement, rest)]
    if outside := outside_finding(placement, rest):
        findings.append(outside)
    else:
        findings += [*size_findings(cage, rest), *clearance_findings(placement, rest)]
    return _with_clearance(facts, placement), findings


def _with_clearance(facts: RestFacts, placement: Placement) -> RestFacts:
    far = placement.far
    if len(far) == facts.vertices:
        return replace(facts, outside=len(far))
    distance = placement.nearest.distance.copy()
    distance[far] = np.inf
    vertex = int(distance.argmin())
    return replace(
        facts,
        outside=len(far),
        clearance=float(100 * distance[vertex] / facts.diagonal),
        clearance_vertex=vertex,
        clearance_face=int(placement.nearest.face[vertex]),
    )


def _influence(
    cage: TriMesh, rest: TriMesh, facts: RestFacts, jobs: int | None
) -> tuple[RestFacts, list[Finding]]:
    """What the weights tell of each cage vertex: computed, at the accuracy of a preview."""
    held = check_enclosure(cage, rest)
    weights: Floats = harmonic_weights(held.cage, held.points, "preview", jobs).values
    strongest = weights.max(axis=0)
    order = np.argsort(strongest, kind="stable")[:LISTED]
    facts = replace(
        facts,
        weakest_vertices=tuple(order.tolist()),
        weakest_weights=tuple(strongest[order].tolist()),
    )
    return facts, [*influence_findings(strongest)]


def _too_many_faces(cage: TriMesh) -> list[Finding]:
    count = len(cage.faces)
    if count <= PANEL_LIMIT:
        return []
    message = f"the cage has {count} faces, at most {PANEL_LIMIT} fit in memory"
    remedy = "use a coarser cage"
    return [Finding("too-many-faces", "unfit", message, remedy, "", NOTHING, float(count))]


def _swapped(cage: TriMesh, rest: TriMesh) -> Finding:
    message = f"the cage has {len(cage.vertices)} vertices and the model {len(rest.vertices)}"
    value = float(len(cage.vertices))
    return Finding("swapped", "note", message, "are they swapped?", "", NOTHING, value)
