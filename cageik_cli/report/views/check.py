"""A cage that was checked, and with a rest pose in it, as text and as JSON."""

from dataclasses import asdict, dataclass
from typing import Any

from cageik_cli.cages.check.diagnosis import CageFacts, Diagnosis, RestFacts
from cageik_cli.cages.check.quality import MIN_CLEARANCE, MIN_INFLUENCE
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import get_parts, name_vertex
from cageik_cli.report.marks import FaultMark, list_marks
from cageik_cli.report.views.cage import format_cage_record
from cageik_cli.util.text import format_block, format_count, format_row


@dataclass(frozen=True, slots=True, eq=False)
class CheckResult:
    """The meshes that were checked, and their diagnosis.

    Attributes
    ----------
    repair_command : str, optional
        To be typed; None if the cage is fit, or no repair can help.
    """

    cage: LoadedMesh
    rest: LoadedMesh | None
    diagnosis: Diagnosis
    repair_command: str | None = None

    @property
    def rest_mesh(self) -> TriMesh | None:
        """Return the mesh of the rest pose, if there is one."""
        return None if self.rest is None else self.rest.mesh

    @property
    def marks(self) -> tuple[FaultMark, ...]:
        """Return the faults that have a place, numbered as in pictures."""
        return list_marks(self.diagnosis.findings, self.cage.mesh, self.rest_mesh)

    @property
    def notes(self) -> tuple[str, ...]:
        """Return what was changed in reading, one sentence each."""
        loaded = [mesh for mesh in (self.cage, self.rest) if mesh is not None]
        return tuple(f"{mesh.source['name']}: {note}" for mesh in loaded for note in mesh.notes)


def format_check_text(result: CheckResult) -> str:
    """Return the verdict, the facts and the findings, the worst first."""
    return format_block(format_check_headline(result), list_check_rows(result))


def format_check_headline(result: CheckResult) -> str:
    """Return the name of a cage, and the verdict on it."""
    return f"{result.cage.source['name']}: {_format_verdict(result.diagnosis)}"


def list_brief_check_rows(result: CheckResult) -> list[tuple[str, str]]:
    """Return the worst fault and its repair, other faults, facts, and what else was found."""
    rows = list_check_rows(result)
    faults = [row for row in rows if row[0] == "unfit"]
    repair = [row for row in rows if row[0] == "to repair"]
    return [*faults[:1], *repair, *faults[1:], *(row for row in rows if row not in faults + repair)]


def list_check_rows(result: CheckResult) -> list[tuple[str, str]]:
    """Return the facts and the findings, the worst first."""
    diagnosis = result.diagnosis
    rows = _cage_rows(diagnosis.cage)
    if result.rest is not None and diagnosis.rest is not None:
        rows += _rest_rows(result.rest, diagnosis.rest)
    rows += [(finding.severity, finding.sentence) for finding in diagnosis.findings]
    rows += [("note", note) for note in result.notes]
    if result.repair_command is not None:
        rows.append(("to repair", result.repair_command))
    return rows


def format_marks_text(result: CheckResult) -> str:
    """Return the list of the faults that have a place, by their numbers in pictures."""
    rows = [(f"fault {mark.number}", mark.text) for mark in result.marks]
    return "\n".join(map(format_row, rows or [("faults", "none that has a place")]))


def _format_verdict(diagnosis: Diagnosis) -> str:
    """Return the verdict, with the number of warnings if those decide it."""
    if diagnosis.verdict != "usable":
        return diagnosis.verdict
    count = sum(finding.severity == "warning" for finding in diagnosis.findings)
    return f"usable, {format_count(count, 'warning')}"


def format_check_json(result: CheckResult) -> str:
    """Return the whole record; a finding has all its numbers."""
    diagnosis = result.diagnosis
    return format_cage_record(
        {
            "verdict": diagnosis.verdict,
            "cage": result.cage.source | asdict(diagnosis.cage),
            "rest": _rest_record(result),
            "notes": result.notes,
            "repair_command": result.repair_command,
            "findings": [
                asdict(finding) | {"numbers": finding.numbers.tolist()}
                for finding in diagnosis.findings
            ],
        }
    )


def _rest_record(result: CheckResult) -> dict[str, Any] | None:
    if result.rest is None or result.diagnosis.rest is None:
        return None
    return result.rest.source | asdict(result.diagnosis.rest)


def _cage_rows(facts: CageFacts) -> list[tuple[str, str]]:
    surface = (
        f"{facts.vertices} vertices, {facts.faces} triangles, "
        f"{format_count(facts.components, 'component')}"
    )
    if facts.genus is not None:
        surface += f", genus {facts.genus}"
    if facts.symmetry is not None:
        surface += f", symmetric about {facts.symmetry}"
    rows = [
        ("cage", surface),
        ("volume", "not defined" if facts.volume is None else f"{facts.volume:.6g}"),
    ]
    if facts.smallest_angle is not None:
        angle = f"{facts.smallest_angle:.3g} degrees at face {facts.smallest_angle_face}"
        rows.append(("smallest angle", angle))
    return rows


def _rest_rows(rest: LoadedMesh, facts: RestFacts) -> list[tuple[str, str]]:
    counts = f"{facts.vertices} vertices, {facts.faces} triangles, diagonal {facts.diagonal:.6g}"
    parts = get_parts(rest.mesh)
    if parts is not None:
        counts += f", {len(parts.names)} parts"
    rows = [("rest pose", f"{rest.source['name']}: {counts}")]
    if facts.outside is None:
        rows.append(("clearance", "not defined (the cage does not enclose a volume)"))
    elif facts.outside:
        rows.append(("clearance", f"none ({facts.outside} vertices are outside)"))
    elif facts.clearance_vertex is not None:
        vertex = name_vertex(rest.mesh, facts.clearance_vertex)
        distance = f"{facts.clearance:.3g} % of the diagonal, vertex {vertex} from face"
        is_enough = facts.clearance is not None and facts.clearance >= 100 * MIN_CLEARANCE
        judged = f"{facts.clearance_face}: {'enough' if is_enough else 'too little'}"
        rows.append(("clearance", f"{distance} {judged}"))
    if facts.weakest_vertices:
        pairs = zip(facts.weakest_vertices, facts.weakest_weights, strict=True)
        weakest = ", ".join(f"{vertex}: {weight:.3g}" for vertex, weight in pairs)
        is_enough = min(facts.weakest_weights) >= MIN_INFLUENCE
        judged = "all are used" if is_enough else "the weakest move hardly anything"
        text = f"largest weight of the weakest cage vertices (of 1): {weakest}; {judged}"
        rows.append(("influence", text))
    return rows
