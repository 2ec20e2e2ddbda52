"""A cage that was built, repaired or checked, as text and as JSON."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cageik_cli.cages.check.diagnosis import CageFacts, Diagnosis, RestFacts
from cageik_cli.cages.check.quality import MIN_CLEARANCE, MIN_INFLUENCE
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import get_parts, name_vertex
from cageik_cli.report.figures import convert_to_integer
from cageik_cli.report.marks import FaultMark, list_marks
from cageik_cli.report.vocabulary import CAGE_VERDICT_WORDS
from cageik_cli.util.messages import Note, Row, Spelling, spell, spell_keyword
from cageik_cli.util.settings import show_settings
from cageik_cli.util.text import format_block, format_count, format_row
from cageik_cli.util.version import __version__

if TYPE_CHECKING:
    from cageik_cli.cages.builder.build import BuiltCage, Candidate
    from cageik_cli.cages.repair.repair import RepairedCage


@dataclass(frozen=True, slots=True, eq=False)
class CageResult:
    """A cage that was built and written.

    Attributes
    ----------
    path : Path
        The file of the cage.
    source : dict
        `name` and `sha256` of that file.
    rest_frame : float or None
        The number of the frame that the model is; None for a file.
    """

    path: Path
    source: dict[str, str]
    model: LoadedMesh
    settings: BuildSettings
    built: "BuiltCage"
    rest_frame: float | None

    @property
    def notes(self) -> tuple[str, ...]:
        """Return what was changed in reading, one sentence each."""
        return tuple(str(note.at(self.model.source["name"])) for note in self.model.notes)


def format_cage_record(record: dict[str, Any]) -> str:
    """Return a record of a cage as JSON, behind the version of its schema and the program."""
    head = {"schema": 1, "tool": {"name": "cageik", "version": __version__}}
    return json.dumps(head | record, indent=1, allow_nan=False) + "\n"


def list_cage_rows(result: CageResult, is_detailed: bool = False) -> list[Row]:
    """Return the facts of the cage and the warnings; the candidates, too, if asked."""
    built, verdict = result.built, result.built.chosen.verdict
    rows: list[Row] = [
        ("model", f"{result.model.source['name']}: {_count(result.model.mesh)}"),
        ("cage", f"{_count(built.cage)}, genus {verdict.genus}{_describe_symmetry(built)}"),
        ("clearance", _format_clearance(built.chosen)),
        ("shape", f"smallest angle {verdict.smallest_angle:.3g} degrees, largest valence "
         f"{verdict.largest_valence}"),
        ("recipe", f"{built.chosen.recipe}, best of {_count_valid(built)}"),
    ]  # fmt: skip
    if built.chosen.error is not None:
        rows.append(("error", f"{built.chosen.error:.4f} % of the diagonal, at preview accuracy"))
    rows += [("warning", warning) for warning in built.notes]
    rows += [("note", note) for note in result.notes]
    if is_detailed:
        rows.append(("chosen for", built.reason))
        rows += [("candidate", _describe_candidate(known)) for known in built.candidates]
    return rows


def format_cage_json(result: CageResult) -> str:
    """Return the whole record, with all candidates."""
    built = result.built
    rest_frame = None if result.rest_frame is None else convert_to_integer(result.rest_frame)
    return format_cage_record(
        {
            "settings": show_settings(result.settings) | {"rest_frame": rest_frame},
            "model": result.model.source,
            "cage": result.source
            | _candidate_record(built.chosen)
            | {"symmetry": None if built.mirror is None else str(built.mirror)},
            "warnings": built.notes,
            "notes": result.notes,
            "candidates": [_candidate_record(known) for known in built.candidates],
        }
    )


def describe_built_cage(built: "BuiltCage") -> str:
    """Return in one line what was built."""
    verdict = built.chosen.verdict
    return (
        f"built, {_count(built.cage)}, genus {verdict.genus}{_describe_symmetry(built)}, clearance "
        f"{_format_clearance(built.chosen)}, by {built.chosen.recipe}"
    )


def _describe_symmetry(built: "BuiltCage") -> str:
    return "" if built.mirror is None else f", symmetric about {built.mirror}"


def _candidate_record(candidate: "Candidate") -> dict[str, Any]:
    verdict = candidate.verdict
    clearance = 100 * verdict.clearance
    return {
        "recipe": candidate.recipe,
        "vertices": len(candidate.cage.vertices),
        "faces": len(candidate.cage.faces),
        "quads": _count_quads(candidate.cage),
        "loops": candidate.loops.count,
        "genus": verdict.genus,
        "clearance_percent": clearance if np.isfinite(clearance) else None,
        "smallest_angle": verdict.smallest_angle,
        "largest_valence": verdict.largest_valence,
        "looseness_percent": 100 * verdict.looseness,
        "error_percent": _finite_or_none(candidate.error),
        "is_valid": verdict.is_valid,
        "faults": verdict.faults,
    }


def _finite_or_none(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None


def _count(mesh: TriMesh) -> str:
    triangles, quads = len(mesh.faces), _count_quads(mesh)
    faces = (
        f"{quads} quads, {triangles - 2 * quads} triangles" if quads else f"{triangles} triangles"
    )
    return f"{len(mesh.vertices)} vertices, {faces}"


def _count_quads(mesh: TriMesh) -> int:
    return int(np.count_nonzero(mesh.polygons.corner_counts == 4))


def _count_valid(built: "BuiltCage") -> str:
    valid = sum(known.verdict.is_valid for known in built.candidates)
    return f"{valid} valid of {format_count(len(built.candidates), 'candidate')}"


def _format_clearance(candidate: "Candidate") -> str:
    verdict = candidate.verdict
    mean = f"mean distance {100 * verdict.looseness:.3g} %"
    if not np.isfinite(verdict.clearance):
        return f"more than twice what was asked for, {mean} of the diagonal"
    return f"{100 * verdict.clearance:.3g} % of the diagonal, {mean}"


def _describe_candidate(candidate: "Candidate") -> str:
    verdict = candidate.verdict
    facts = f"{candidate.recipe}: {len(candidate.cage.vertices)} vertices"
    if not verdict.is_valid:
        return f"{facts}; {verdict.faults[0]}"
    facts += (
        f", genus {verdict.genus}, mean distance {100 * verdict.looseness:.3g} %, smallest angle "
        f"{verdict.smallest_angle:.3g} degrees"
    )
    return facts if candidate.error is None else f"{facts}, error {candidate.error:.4f} %"


def list_repair_rows(repaired: "RepairedCage", diagonal: float) -> list[Row]:
    """Return what was done, step by step, and how far vertices moved.

    `diagonal` is that of the model, in file units.
    """
    count, corners = len(repaired.mesh.vertices), repaired.mesh.corner_counts
    rows: list[Row] = [("cage", f"fit, {count} vertices, {len(corners)} faces")]
    if repaired.transform is not None:
        rows.append(("transform", repaired.transform.name))
    rows += [("step", step.message) for step in repaired.steps]
    moved = len(repaired.moved_vertices)
    if moved:
        share = 100 * repaired.max_move / diagonal
        rows.append(
            ("moved", f"{moved} of {count} vertices, at most {share:.3g} % of the diagonal")
        )
    else:
        rows.append(("moved", "no vertex"))
    rows += [("warning", finding.sentence) for finding in repaired.warnings]
    return rows


def format_repair_json(repaired: "RepairedCage", diagonal: float) -> str:
    """Return the whole record of a repair, for a model of this diagonal."""
    return format_cage_record(
        {
            "is_fit": repaired.is_fit,
            "transform": repaired.transform.name if repaired.transform is not None else None,
            "max_move_percent": 100 * repaired.max_move / diagonal,
            "moved_vertices": repaired.moved_vertices.tolist(),
            "vertex_map": repaired.vertex_map.tolist(),
            "steps": [
                asdict(step) | {"vertices": step.vertices.tolist()} for step in repaired.steps
            ],
            "warnings": [spell(finding.sentence) for finding in repaired.warnings],
        }
    )


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
    def notes(self) -> list[Note]:
        """Return what was changed in reading, behind the name of the file."""
        loaded = [mesh for mesh in (self.cage, self.rest) if mesh is not None]
        return [note.at(mesh.source["name"]) for mesh in loaded for note in mesh.notes]


def format_check_text(result: CheckResult) -> str:
    """Return the verdict, the facts and the findings, the worst first."""
    return format_block(format_check_headline(result), list_check_rows(result))


def format_check_headline(result: CheckResult) -> str:
    """Return the name of a cage, and the verdict on it."""
    return f"{result.cage.source['name']}: {_format_verdict(result.diagnosis)}"


def list_brief_check_rows(result: CheckResult) -> list[Row]:
    """Return the worst fault and its repair, other faults, facts, and what else was found."""
    rows = list_check_rows(result)
    faults = [row for row in rows if row[0] == "unfit"]
    repair = [row for row in rows if row[0] == "to repair"]
    return [*faults[:1], *repair, *faults[1:], *(row for row in rows if row not in faults + repair)]


def list_check_rows(result: CheckResult) -> list[Row]:
    """Return the facts and the findings, the worst first."""
    diagnosis = result.diagnosis
    rows = _cage_rows(diagnosis.cage)
    if result.rest is not None and diagnosis.rest is not None:
        rows += _rest_rows(result.rest, diagnosis.rest)
    rows += [(finding.severity, finding.sentence) for finding in diagnosis.findings]
    rows += [note.row for note in result.notes]
    if result.repair_command is not None:
        rows.append(("to repair", result.repair_command))
    return rows


def format_marks_text(result: CheckResult) -> str:
    """Return the list of the faults that have a place, by their numbers in pictures."""
    rows = [(f"fault {mark.number}", mark.text) for mark in result.marks]
    return "\n".join(map(format_row, rows or [("faults", "none that has a place")]))


def _format_verdict(diagnosis: Diagnosis) -> str:
    """Return the verdict, with the number of warnings if those decide it."""
    word = CAGE_VERDICT_WORDS[diagnosis.verdict]
    if diagnosis.verdict != "usable":
        return word
    count = sum(finding.severity == "warning" for finding in diagnosis.findings)
    return f"{word}, {format_count(count, 'warning')}"


def format_check_json(result: CheckResult, spelling: Spelling = spell_keyword) -> str:
    """Return the whole record; a finding has all its numbers.

    Settings that remedies and notes name are written as `spelling` does.
    """
    diagnosis = result.diagnosis
    return format_cage_record(
        {
            "verdict": diagnosis.verdict,
            "cage": result.cage.source | asdict(diagnosis.cage),
            "rest": _rest_record(result),
            "notes": [str(note.spell(spelling)) for note in result.notes],
            "repair_command": result.repair_command,
            "findings": [
                asdict(finding)
                | {"remedy": spell(finding.remedy, spelling), "numbers": finding.numbers.tolist()}
                for finding in diagnosis.findings
            ],
        }
    )


def _rest_record(result: CheckResult) -> dict[str, Any] | None:
    if result.rest is None or result.diagnosis.rest is None:
        return None
    return result.rest.source | asdict(result.diagnosis.rest)


def _cage_rows(facts: CageFacts) -> list[Row]:
    surface = (
        f"{facts.vertices} vertices, {facts.faces} triangles, "
        f"{format_count(facts.components, 'component')}"
    )
    if facts.genus is not None:
        surface += f", genus {facts.genus}"
    if facts.symmetry is not None:
        surface += f", symmetric about {facts.symmetry}"
    rows: list[Row] = [
        ("cage", surface),
        ("volume", "not defined" if facts.volume is None else f"{facts.volume:.6g}"),
    ]
    if facts.smallest_angle is not None:
        angle = f"{facts.smallest_angle:.3g} degrees at face {facts.smallest_angle_face}"
        rows.append(("smallest angle", angle))
    return rows


def _rest_rows(rest: LoadedMesh, facts: RestFacts) -> list[Row]:
    counts = f"{facts.vertices} vertices, {facts.faces} triangles, diagonal {facts.diagonal:.6g}"
    parts = get_parts(rest.mesh)
    if parts is not None:
        counts += f", {len(parts.names)} parts"
    rows: list[Row] = [("rest pose", f"{rest.source['name']}: {counts}")]
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
