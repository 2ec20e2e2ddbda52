"""The diagnosis of a cage, alone or with a rest pose in it: facts, findings and a verdict."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.cages.check.enclosure import (
    are_swapped,
    check_enclosure,
    describe_unused_vertices,
    find_missing_extent,
    locate_vertices,
    make_swap_finding,
)
from cageik_cli.cages.check.faults import SEVERITIES, Finding, find_cage_faults
from cageik_cli.cages.check.misfit import Misfit
from cageik_cli.cages.check.quality import (
    find_looseness_faults,
    find_low_clearance,
    find_needle_faces,
    find_surface_crossings,
    find_thin_parts,
    find_weak_vertices,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import find_mirror
from cageik_cli.geometry.parts import PartShare
from cageik_cli.geometry.shape import bounds_volume, corner_angles, degenerate_face_mask
from cageik_cli.method.weights.harmonic import MAX_HARMONIC_FACES, harmonic_weights
from cageik_cli.util.arrays import Floats
from cageik_cli.util.text import format_count, group_digits

UNREPAIRABLE = {"point", "too-many-faces", "swapped", "no-volume"}
"""Kinds of findings that no repair can mend."""


@dataclass(frozen=True, slots=True)
class CageFacts:
    """Facts about a cage; None if not defined.

    Attributes
    ----------
    genus : int, optional
        Number of handles over all components, for closed manifolds.
    volume : float, optional
        Cubic file units, negative if the faces turn inward; for closed cages.
    smallest_angle : float, optional
        Degrees, over all corners of faces that are not degenerate.
    symmetry : str, optional
        The plane across which the cage is its own mirror image.
    """

    vertices: int
    faces: int
    components: int
    genus: int | None
    volume: float | None
    smallest_angle: float | None
    smallest_angle_face: int | None
    symmetry: str | None


@dataclass(frozen=True, slots=True)
class RestFacts:
    """Facts about a rest pose in its cage; None if not known.

    Attributes
    ----------
    diagonal : float
        File units.
    outside : int, optional
        Number of vertices that are outside by more than rounding.
    outside_parts : tuple of PartShare
        How many of these each part has, the most first; empty for a model of one part.
    clearance : float, optional
        Smallest distance of the other vertices from the cage, percent of the diagonal.
    clearance_vertex, clearance_face : int, optional
        The vertex and the cage face of this distance.
    transform : str, optional
        How the cage differs if it holds the model without that: `in centimetres instead of metres`.
    inflation : float, optional
        By how much a cage is too small everywhere, percent of the diagonal.
    weakest_vertices : tuple of int
        The least influential cage vertices, three at most, if the cage binds.
    weakest_weights : tuple of float
        The largest weight that each of them has on the model.
    """

    vertices: int
    faces: int
    diagonal: float
    outside: int | None = None
    clearance: float | None = None
    clearance_vertex: int | None = None
    clearance_face: int | None = None
    transform: str | None = None
    inflation: float | None = None
    weakest_vertices: tuple[int, ...] = ()
    weakest_weights: tuple[float, ...] = ()
    outside_parts: tuple[PartShare, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """Facts and findings about a cage.

    Attributes
    ----------
    findings : tuple of Finding
        The worst first.
    misfit : Misfit, optional
        Why vertices of the rest pose are outside; None if none are, or it is not known.

    Examples
    --------
    >>> from cageik_cli import check_cage, load_mesh
    >>> diagnosis = check_cage(load_mesh("data_fixtures/walker/cage.obj"))
    >>> diagnosis
    <Diagnosis: fit, 0 findings>
    >>> diagnosis.cage.genus
    0
    """

    cage: CageFacts
    rest: RestFacts | None
    findings: tuple[Finding, ...]
    misfit: Misfit | None = None

    def __repr__(self) -> str:
        return f"<Diagnosis: {self.verdict}, {format_count(len(self.findings), 'finding')}>"

    @property
    def is_fit(self) -> bool:
        """Whether the cage can hold the model: no finding is `unfit`."""
        return self.verdict != "unfit"

    @property
    def verdict(self) -> str:
        """`unfit` (does not bind), `usable` (binds, with warnings) or `fit`."""
        severities = {finding.severity for finding in self.findings}
        if "unfit" in severities:
            return "unfit"
        return "usable" if "warning" in severities else "fit"

    @property
    def is_repairable(self) -> bool:
        """Whether the cage is unfit, but `cageik cage --repair` may make it fit."""
        if self.is_fit or any(finding.kind in UNREPAIRABLE for finding in self.findings):
            return False
        return self.misfit is None or self.misfit.is_repairable


def diagnose(cage: TriMesh, rest: TriMesh | None = None, jobs: int | None = None) -> Diagnosis:
    """Diagnose a cage, and a rest pose in it if there is one."""
    findings = [*find_cage_faults(cage), *_find_too_many_faces(cage), *find_needle_faces(cage)]
    sound = not _is_any_unfit(findings)
    if sound:
        findings += find_thin_parts(cage)
    kinds = {finding.kind for finding in findings}
    facts, rest_facts = _measure_cage(cage, is_manifold="pinched-vertex" not in kinds), None
    misfit = None
    if rest is not None:
        has_inside = bounds_volume(cage) and "no-volume" not in kinds
        rest_facts, misfit, more = _diagnose_rest(cage, rest, has_inside)
        findings += more
        if sound and not _is_any_unfit(more):
            rest_facts, more = _measure_influence(cage, rest, rest_facts, jobs)
            findings += more
        elif are_swapped(cage, rest):
            findings = [make_swap_finding(cage, rest)]
        elif len(cage.vertices) > len(rest.vertices):
            message = (
                f"the cage has {group_digits(len(cage.vertices))} vertices and the model "
                f"{group_digits(len(rest.vertices))}"
            )
            remedy, value = "are they swapped?", len(cage.vertices)
            findings.append(Finding("swapped", "note", message, remedy, value=value))
    is_of_another = misfit is not None and not misfit.is_repairable
    # To mend the other faults of such a cage would not help.
    findings.sort(
        key=lambda found: (
            SEVERITIES.index(found.severity),
            not (is_of_another and found.kind == "outside"),
        )
    )
    return Diagnosis(facts, rest_facts, tuple(findings), misfit)


def _is_any_unfit(findings: list[Finding]) -> bool:
    return any(finding.severity == "unfit" for finding in findings)


def _measure_cage(cage: TriMesh, is_manifold: bool) -> CageFacts:
    used, closed = np.unique(cage.faces), bounds_volume(cage)
    parts = len(np.unique(cage.components[used]))
    euler = len(used) - len(cage.edges.ends) + len(cage.faces)
    angles = np.where(degenerate_face_mask(cage), np.inf, corner_angles(cage).min(axis=1))
    face = int(angles.argmin())
    measured = bool(np.isfinite(angles[face]))
    is_small = len(cage.faces) <= MAX_HARMONIC_FACES  # else it cannot be bound
    mirror = find_mirror(cage.vertices) if is_small else None
    is_symmetric = mirror is not None and mirror.mirrors_polygons(cage)
    return CageFacts(
        vertices=len(cage.vertices),
        faces=len(cage.faces),
        components=parts,
        genus=parts - euler // 2 if closed and is_manifold else None,
        volume=cage.volume if closed else None,
        smallest_angle=float(angles[face]) if measured else None,
        smallest_angle_face=face if measured else None,
        symmetry=str(mirror) if is_symmetric else None,
    )


def _diagnose_rest(
    cage: TriMesh, rest: TriMesh, has_inside: bool
) -> tuple[RestFacts, Misfit | None, list[Finding]]:
    facts, misfit = RestFacts(len(rest.vertices), len(rest.faces), rest.diagonal), None
    if no_extent := find_missing_extent(rest):
        return facts, misfit, [no_extent]
    if not has_inside:
        return facts, misfit, []
    placement = locate_vertices(cage if cage.volume > 0 else cage.flip(), rest)
    unused, remedy = rest.unused_vertices, "delete them if they are left-overs"
    findings = [
        Finding(
            "unreferenced-vertex", "note", text, remedy, "vertices", unused, len(unused), "rest"
        )
        for text in map(str, describe_unused_vertices(rest))
    ]
    findings += find_surface_crossings(placement)
    if len(placement.outside_indices):
        misfit = placement.explain()
        name = None if misfit.transform is None else misfit.transform.name
        facts = replace(facts, transform=name, inflation=misfit.inflation)
        findings.append(placement.find_outside(misfit.remedy))
    else:
        findings += [*find_looseness_faults(placement.cage, rest), *find_low_clearance(placement)]
    outside, distance = placement.outside_indices, placement.clearance
    facts = replace(facts, outside=len(outside), outside_parts=tuple(placement.outside_parts))
    distance[outside] = np.inf
    vertex = int(distance.argmin())
    if np.isfinite(distance[vertex]):
        facts = replace(
            facts,
            clearance=float(100 * distance[vertex] / facts.diagonal),
            clearance_vertex=vertex,
            clearance_face=int(placement.closest.face[vertex]),
        )
    return facts, misfit, findings


def _measure_influence(
    cage: TriMesh, rest: TriMesh, facts: RestFacts, jobs: int | None
) -> tuple[RestFacts, list[Finding]]:
    """Measure the influence of each cage vertex from weights of preview accuracy."""
    placement = check_enclosure(cage, rest)
    weights: Floats = harmonic_weights(placement.cage, placement.points, "preview", jobs).values
    strongest = weights.max(axis=0)
    order = np.argsort(strongest, kind="stable")[:3]
    facts = replace(
        facts,
        weakest_vertices=tuple(order.tolist()),
        weakest_weights=tuple(strongest[order].tolist()),
    )
    return facts, [*find_weak_vertices(strongest)]


def _find_too_many_faces(cage: TriMesh) -> Iterator[Finding]:
    count = len(cage.faces)
    if count > MAX_HARMONIC_FACES:
        most = group_digits(MAX_HARMONIC_FACES)
        message = f"the cage has {group_digits(count)} faces, at most {most} fit in memory"
        remedy = "use a coarser cage"
        yield Finding("too-many-faces", "unfit", message, remedy, value=count)
