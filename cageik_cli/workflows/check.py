"""The diagnosis of a cage and of the rest pose in it, as text and as JSON."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cageik_cli import __version__
from cageik_cli.cages.diagnosis import CageFacts, Diagnosis, RestFacts, diagnose
from cageik_cli.cages.findings import Finding
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.settings import ClipSettings, RestFrame
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.plots.cage_marks import FaultMark, list_marks
from cageik_cli.util.text import format_block, format_count, format_row
from cageik_cli.workflows.repair_hint import find_rest_file, format_repair_command
from cageik_cli.workflows.rest_frame import open_clip_and_choose_rest
from cageik_cli.workflows.settings import READ, READ_CLIP, CommandSettings

SCHEMA_VERSION = 1


@dataclass(frozen=True, slots=True)
class CheckSettings(CommandSettings):
    """What to check.

    Attributes
    ----------
    frames : tuple of str
        Files, folders and globs, or one file that holds a clip; may be none.
    rest : Path, optional
        The rest pose; a frame of the clip if absent, or none without a clip.
    rest_frame : int or "auto"
        Which frame then, from 0; or the one in which the least of the surface touches.
    jobs : int
        Threads.
    clip : ClipSettings
        Which of the frames to take, and how to read them.
    """

    cage: Path = field(metadata=READ)
    frames: tuple[str, ...] = field(default=(), metadata=READ_CLIP)
    rest: Path | None = field(default=None, metadata=READ)
    rest_frame: RestFrame = 0
    jobs: int = 1
    clip: ClipSettings = field(default_factory=lambda: ClipSettings(gaps="close"))


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


def check_cage(settings: CheckSettings) -> CheckResult:
    """Read the cage and the rest pose, if there is one, and diagnose them.

    Raises
    ------
    InputError
        Naming the file that cannot be read.
    """
    cage, rest, rest_file = load_mesh(settings.cage), None, settings.rest
    if settings.frames:
        clip, rest, index = open_clip_and_choose_rest(
            settings.frames, settings.clip, settings.rest, settings.rest_frame
        )
        if index is not None:
            rest_file = find_rest_file(clip, index)
    elif settings.rest is not None:
        rest = load_mesh(settings.rest)
    diagnosis = diagnose(cage.mesh, rest.mesh if rest is not None else None, settings.jobs)
    command = None
    if diagnosis.is_repairable:
        command = format_repair_command(settings.cage, rest_file)
    return CheckResult(cage, rest, diagnosis, command)


def format_check_text(result: CheckResult) -> str:
    """Return the verdict, the facts and the findings, the worst first."""
    diagnosis = result.diagnosis
    rows = _cage_rows(diagnosis.cage)
    if result.rest is not None and diagnosis.rest is not None:
        rows += _rest_rows(result.rest.source["name"], diagnosis.rest)
    rows += [(finding.severity, finding.sentence) for finding in diagnosis.findings]
    rows += [("note", note) for note in result.notes]
    if result.repair_command is not None:
        rows.append(("to repair", result.repair_command))
    return format_block(f"{result.cage.source['name']}: {_format_verdict(diagnosis)}", rows)


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
    record = {
        "schema": SCHEMA_VERSION,
        "tool": {"name": "cageik", "version": __version__},
        "verdict": diagnosis.verdict,
        "cage": result.cage.source | asdict(diagnosis.cage),
        "rest": _rest_record(result),
        "notes": result.notes,
        "repair_command": result.repair_command,
        "findings": [_finding_record(finding) for finding in diagnosis.findings],
    }
    return json.dumps(record, indent=1, allow_nan=False) + "\n"


def _rest_record(result: CheckResult) -> dict[str, Any] | None:
    if result.rest is None or result.diagnosis.rest is None:
        return None
    return result.rest.source | asdict(result.diagnosis.rest)


def _finding_record(finding: Finding) -> dict[str, Any]:
    return asdict(finding) | {"numbers": finding.numbers.tolist()}


def _cage_rows(facts: CageFacts) -> list[tuple[str, str]]:
    surface = (
        f"{facts.vertices} vertices, {facts.faces} triangles, "
        f"{format_count(facts.components, 'component')}"
    )
    if facts.genus is not None:
        surface += f", genus {facts.genus}"
    rows = [
        ("cage", surface),
        ("volume", "not defined" if facts.volume is None else f"{facts.volume:.6g}"),
    ]
    if facts.smallest_angle is not None:
        angle = f"{facts.smallest_angle:.3g} degrees at face {facts.smallest_angle_face}"
        rows.append(("smallest angle", angle))
    return rows


def _rest_rows(name: str, facts: RestFacts) -> list[tuple[str, str]]:
    counts = f"{facts.vertices} vertices, {facts.faces} triangles, diagonal {facts.diagonal:.6g}"
    rows = [("rest pose", f"{name}: {counts}")]
    if facts.outside is None:
        rows.append(("clearance", "not defined (the cage does not enclose a volume)"))
    elif facts.outside:
        rows.append(("clearance", f"none ({facts.outside} vertices are outside)"))
    else:
        rows.append(
            (
                "clearance",
                f"{facts.clearance:.3g} % of the diagonal, vertex {facts.clearance_vertex} from "
                f"face {facts.clearance_face}",
            )
        )
    if facts.weakest_vertices:
        pairs = zip(facts.weakest_vertices, facts.weakest_weights, strict=True)
        weakest = ", ".join(f"{vertex} (largest weight {weight:.3g})" for vertex, weight in pairs)
        rows.append(("influence", f"least influential cage vertices: {weakest}"))
    return rows
