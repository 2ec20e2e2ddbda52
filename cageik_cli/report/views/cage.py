"""A cage that was built or repaired, as text and as JSON."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cageik_cli import __version__
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.figures import make_whole
from cageik_cli.util.text import format_count

if TYPE_CHECKING:  # the builder is slow to import
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
        return tuple(f"{self.model.source['name']}: {note}" for note in self.model.notes)


def format_cage_record(record: dict[str, Any]) -> str:
    """Return a record of a cage as JSON, behind the version of its schema and the program."""
    head = {"schema": 1, "tool": {"name": "cageik", "version": __version__}}
    return json.dumps(head | record, indent=1, allow_nan=False) + "\n"


def list_cage_rows(result: CageResult, is_detailed: bool = False) -> list[tuple[str, str]]:
    """Return the facts of the cage and the warnings; the candidates, too, if asked."""
    built, verdict = result.built, result.built.chosen.verdict
    rows = [
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
    settings, built = result.settings, result.built
    return format_cage_record(
        {
            "settings": {
                "vertices": settings.vertices,
                "clearance_percent": 100 * settings.clearance,
                "symmetric": settings.symmetric,
                "quads": settings.quads,
                "loops": settings.loops,
                "rest_frame": None if result.rest_frame is None else make_whole(result.rest_frame),
            },
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


def list_repair_rows(repaired: "RepairedCage", diagonal: float) -> list[tuple[str, str]]:
    """Return what was done, step by step, and how far vertices moved.

    `diagonal` is that of the model, in file units.
    """
    count, corners = len(repaired.mesh.vertices), repaired.mesh.corner_counts
    rows = [("cage", f"fit, {count} vertices, {len(corners)} faces")]
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
            "warnings": [finding.sentence for finding in repaired.warnings],
        }
    )
