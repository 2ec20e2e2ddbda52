"""A cage that was built, repaired or checked: text, JSON, and marks of its faults on the meshes."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cageik_cli.cages.check.diagnosis import CageFacts, Diagnosis, RestFacts
from cageik_cli.cages.check.faults import Finding
from cageik_cli.cages.check.quality import MIN_CLEARANCE, MIN_INFLUENCE
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import get_parts, name_vertex
from cageik_cli.report.figures import convert_to_integer, format_length, format_percent
from cageik_cli.report.render.shading import parse_colour
from cageik_cli.report.vocabulary import CAGE_VERDICT_WORDS
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import join_truncated
from cageik_cli.util.messages import Note, Row, Spelling, spell, spell_keyword
from cageik_cli.util.settings import show_settings
from cageik_cli.util.text import format_count, format_row, group_digits, pluralize
from cageik_cli.util.version import __version__

if TYPE_CHECKING:
    from cageik_cli.cages.builder.build import BuiltCage, Candidate
    from cageik_cli.cages.repair.repair import RepairedCage

FAULT_COLOURS = ("#d62f27", "#e08214", "#7b3fa0", "#0f8b8d", "#c2185b", "#5d7a1f", "#8c510a")
"""Colours of faults, in their order; after the last the first comes again."""


@dataclass(frozen=True, slots=True, eq=False)
class FaultMark:
    """One fault that has a place.

    Attributes
    ----------
    number : int
        From 1.
    colour : str
        As #rrggbb.
    text : str
        What it is, with the first numbers.
    cage, rest : (k,) int64
        Vertices of the meshes that it concerns.
    cage_faces : (f,) int64
        Faces of the cage that it concerns; if it concerns vertices, those with no other corners.
    points : (p, 3) float64
        Where it is.
    """

    number: int
    colour: str
    text: str
    cage: Integers
    rest: Integers
    cage_faces: Integers
    points: Floats


def list_marks(
    findings: tuple[Finding, ...], cage: TriMesh, rest: TriMesh | None
) -> tuple[FaultMark, ...]:
    """List the findings that have a place, numbered in their order."""
    placed = [found for found in findings if len(found.numbers) or found.place is not None]
    return tuple(
        _make_mark(number, found, cage, rest) for number, found in enumerate(placed, start=1)
    )


def _make_mark(number: int, found: Finding, cage: TriMesh, rest: TriMesh | None) -> FaultMark:
    of_mesh = dict(_find_vertices(found, cage, rest))
    none: Integers = np.empty(0, np.int64)
    on_cage, on_rest = of_mesh.get("cage", none), of_mesh.get("rest", none)
    # Pairs of faces of both meshes are shown on the cage.
    points = cage.vertices[on_cage]
    if len(on_rest) and not len(on_cage) and rest is not None:
        points = rest.vertices[on_rest]
    if found.place is not None:
        points = np.array([found.place])
    if found.elements.startswith("face") and found.mesh != "rest":
        cage_faces = np.unique(found.numbers[:, 1] if found.mesh == "both" else found.numbers)
    else:
        cage_faces = np.flatnonzero(np.isin(cage.faces, on_cage).all(axis=1))
    return FaultMark(
        number=number,
        colour=FAULT_COLOURS[(number - 1) % len(FAULT_COLOURS)],
        text=_describe(found),
        cage=on_cage,
        rest=on_rest,
        cage_faces=cage_faces,
        points=points,
    )


def _find_vertices(
    found: Finding, cage: TriMesh, rest: TriMesh | None
) -> Iterator[tuple[str, Integers]]:
    """Yield the vertices of each mesh that a finding concerns."""
    if found.mesh == "both":
        if rest is not None and len(found.numbers):
            yield "rest", np.unique(rest.faces[found.numbers[:, 0]])
            yield "cage", np.unique(cage.faces[found.numbers[:, 1]])
        return
    mesh = cage if found.mesh == "cage" or rest is None else rest
    numbers = np.unique(found.numbers)
    is_of_faces = found.elements.startswith("face")
    yield found.mesh, np.unique(mesh.faces[numbers]) if is_of_faces else numbers


def _describe(found: Finding) -> str:
    kind = found.kind.replace("-", " ")
    if found.place is not None:
        x, y, z = found.place
        return f"{kind} at ({x:.3g}, {y:.3g}, {z:.3g})"
    names = ["-".join(map(str, np.ravel(number))) for number in found.numbers.tolist()]
    if len(names) == 1:
        nouns = ("vertex", "edge", "face", "face pair")
        singular = next(noun for noun in nouns if pluralize(noun) == found.elements)
        return f"{kind}: {singular} {names[0]}"
    return f"{kind}: {len(names)} {found.elements} ({join_truncated(names)})"


def encode_marked_ply(cage: TriMesh, rest: TriMesh | None, marks: tuple[FaultMark, ...]) -> bytes:
    """Encode the cage, then the rest pose if there is one, as binary PLY.

    A vertex has the colour of the first fault that concerns it.
    """
    meshes = {"cage": cage} if rest is None else {"cage": cage, "rest": rest}
    points = np.concatenate([mesh.vertices for mesh in meshes.values()])
    colours = [_colour_vertices(marks, name, len(mesh.vertices)) for name, mesh in meshes.items()]
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes.values())])
    faces = [mesh.faces + start for mesh, start in zip(meshes.values(), offsets, strict=False)]
    corners = np.concatenate(faces)
    rows = np.zeros(len(points), [("place", "<f8", 3), ("colour", "u1", 3)])
    rows["place"], rows["colour"] = points, np.rint(255 * np.concatenate(colours))
    triangles = np.zeros(len(corners), [("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, corners
    first = f"the first {len(cage.vertices)} vertices and {len(cage.faces)} faces"
    header = f"""ply
format binary_little_endian 1.0
comment cage: {first}; then the rest pose
element vertex {len(points)}
property double x
property double y
property double z
property uchar red
property uchar green
property uchar blue
element face {len(corners)}
property list uchar int vertex_indices
end_header
"""
    return header.encode() + rows.tobytes() + triangles.tobytes()


def _colour_vertices(marks: tuple[FaultMark, ...], mesh: str, count: int) -> Floats:
    """Colours of all vertices of the `cage` or the `rest`, (count, 3); the first fault counts."""
    plain = {"cage": "#9dbbe0", "rest": "#e2d6c8"}
    colours = np.tile(parse_colour(plain[mesh]), (count, 1))
    for mark in reversed(marks):
        colours[mark.cage if mesh == "cage" else mark.rest] = parse_colour(mark.colour)
    return colours


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
    valid = sum(known.verdict.is_valid for known in built.candidates)
    candidates = format_count(len(built.candidates), "candidate")
    rows: list[Row] = [
        ("model", f"{result.model.source['name']}: {_count(result.model.mesh)}"),
        ("cage", f"{_count(built.cage)}, genus {verdict.genus}{_describe_symmetry(built)}"),
        ("clearance", _format_clearance(built.chosen)),
        ("shape", f"smallest angle {verdict.smallest_angle:.3g} degrees, largest valence "
         f"{verdict.largest_valence}"),
        ("recipe", f"{built.chosen.recipe}, best of {valid} valid of {candidates}"),
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
    verdict, error = candidate.verdict, candidate.error
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
        "error_percent": error if error is not None and np.isfinite(error) else None,
        "is_valid": verdict.is_valid,
        "faults": verdict.faults,
    }


def _count(mesh: TriMesh) -> str:
    triangles, quads = len(mesh.faces), _count_quads(mesh)
    faces = (
        f"{group_digits(quads)} quads, {group_digits(triangles - 2 * quads)} triangles"
        if quads
        else f"{group_digits(triangles)} triangles"
    )
    return f"{group_digits(len(mesh.vertices))} vertices, {faces}"


def _count_quads(mesh: TriMesh) -> int:
    return int(np.count_nonzero(mesh.polygons.corner_counts == 4))


def _format_clearance(candidate: "Candidate") -> str:
    verdict = candidate.verdict
    mean = f"mean distance {100 * verdict.looseness:.3g} %"
    if not np.isfinite(verdict.clearance):
        return f"more than twice what was asked for, {mean} of the diagonal"
    return f"{100 * verdict.clearance:.3g} % of the diagonal, {mean}"


def _describe_candidate(candidate: "Candidate") -> str:
    verdict = candidate.verdict
    facts = f"{candidate.recipe}: {group_digits(len(candidate.cage.vertices))} vertices"
    if not verdict.is_valid:
        return f"{facts}; {verdict.faults[0]}"
    facts += (
        f", genus {verdict.genus}, mean distance {100 * verdict.looseness:.3g} %, smallest angle "
        f"{verdict.smallest_angle:.3g} degrees"
    )
    return (
        facts if candidate.error is None else f"{facts}, error {format_percent(candidate.error)} %"
    )


def list_repair_rows(repaired: "RepairedCage", diagonal: float) -> list[Row]:
    """Return what was done, step by step, and how far vertices moved.

    `diagonal` is that of the model, in file units.
    """
    count, corners = len(repaired.mesh.vertices), repaired.mesh.corner_counts
    rows: list[Row] = [
        ("cage", f"fit, {group_digits(count)} vertices, {group_digits(len(corners))} faces")
    ]
    if repaired.transform is not None:
        rows.append(("transform", repaired.transform.name))
    rows += [("step", step.message) for step in repaired.steps]
    moved = len(repaired.moved_vertices)
    if moved:
        share = 100 * repaired.max_move / diagonal
        rows.append(
            (
                "moved",
                f"{group_digits(moved)} of {group_digits(count)} vertices, at most {share:.3g} % "
                "of the diagonal",
            )
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


def format_check_headline(result: CheckResult) -> str:
    """Return the name of a cage, and the verdict, with the number of warnings that decide it."""
    diagnosis = result.diagnosis
    verdict = CAGE_VERDICT_WORDS[diagnosis.verdict]
    if diagnosis.verdict == "usable":
        count = sum(finding.severity == "warning" for finding in diagnosis.findings)
        verdict += f", {format_count(count, 'warning')}"
    return f"{result.cage.source['name']}: {verdict}"


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


def format_check_json(result: CheckResult, spelling: Spelling = spell_keyword) -> str:
    """Return the whole record; a finding has all its numbers.

    Settings that remedies and notes name are written as `spelling` does.
    """
    diagnosis, rest = result.diagnosis, None
    if result.rest is not None and diagnosis.rest is not None:
        rest = result.rest.source | asdict(diagnosis.rest)
    return format_cage_record(
        {
            "verdict": diagnosis.verdict,
            "cage": result.cage.source | asdict(diagnosis.cage),
            "rest": rest,
            "notes": [str(note.spell(spelling)) for note in result.notes],
            "repair_command": result.repair_command,
            "findings": [
                asdict(finding)
                | {"remedy": spell(finding.remedy, spelling), "numbers": finding.numbers.tolist()}
                for finding in diagnosis.findings
            ],
        }
    )


def _cage_rows(facts: CageFacts) -> list[Row]:
    surface = (
        f"{group_digits(facts.vertices)} vertices, {group_digits(facts.faces)} triangles, "
        f"{format_count(facts.components, 'component')}"
    )
    if facts.genus is not None:
        surface += f", genus {facts.genus}"
    if facts.symmetry is not None:
        surface += f", symmetric about {facts.symmetry}"
    rows: list[Row] = [
        ("cage", surface),
        ("volume", "not defined" if facts.volume is None else format_length(facts.volume)),
    ]
    if facts.smallest_angle is not None:
        angle = f"{facts.smallest_angle:.3g} degrees at face {facts.smallest_angle_face}"
        rows.append(("smallest angle", angle))
    return rows


def _rest_rows(rest: LoadedMesh, facts: RestFacts) -> list[Row]:
    counts = (
        f"{group_digits(facts.vertices)} vertices, {group_digits(facts.faces)} triangles, "
        f"diagonal {format_length(facts.diagonal)}"
    )
    parts = get_parts(rest.mesh)
    if parts is not None:
        counts += f", {len(parts.names)} parts"
    rows: list[Row] = [("rest pose", f"{rest.source['name']}: {counts}")]
    if facts.outside is None:
        rows.append(("clearance", "not defined (the cage does not enclose a volume)"))
    elif facts.outside:
        rows.append(("clearance", f"none ({group_digits(facts.outside)} vertices are outside)"))
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
