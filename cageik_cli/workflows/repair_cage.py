"""A user's cage made fit for a model: read both, repair, write the cage."""

import json
from dataclasses import dataclass, field
from pathlib import Path

from cageik_cli import __version__
from cageik_cli.cages.findings import Finding
from cageik_cli.cages.repair import RepairedCage, RepairSettings, repair_cage
from cageik_cli.formats.obj import encode_exact_obj
from cageik_cli.formats.open import load_mesh
from cageik_cli.util.errors import CageError, error_context
from cageik_cli.util.outputs import write_bytes
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import format_block
from cageik_cli.workflows.cached_cage import check_cage_output
from cageik_cli.workflows.settings import READ, WRITTEN, CommandSettings

SCHEMA_VERSION = 1


@dataclass(frozen=True, slots=True)
class RepairCageSettings(CommandSettings):
    """Which cage to repair, for which model, and where to write it.

    Attributes
    ----------
    output : Path
        An OBJ file.
    """

    cage: Path = field(metadata=READ)
    model: Path = field(metadata=READ)
    output: Path = field(metadata=WRITTEN)
    repair: RepairSettings = field(default_factory=RepairSettings)
    overwrite: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RepairResult:
    """A cage that was repaired and written.

    Attributes
    ----------
    diagonal : float
        Of the model, in file units.
    """

    settings: RepairCageSettings
    repaired: RepairedCage
    diagonal: float


def repair_cage_file(
    settings: RepairCageSettings, progress: ProgressListener | None = None
) -> RepairResult:
    """Repair a cage and write it, unless a fault is left.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    CageError
        Naming the faults that are left; nothing is written then.
    """
    progress = progress or ProgressListener()
    check_cage_output(settings.output, settings.overwrite)
    with progress.stage("open"):
        cage, model = load_mesh(settings.cage), load_mesh(settings.model)
    with progress.stage("repair"), error_context(settings.cage):
        attributes = cage.mesh.attributes
        counts = None if attributes is None else attributes.corner_counts
        fans = cage.mesh.fan_triangulated
        repaired = repair_cage(fans, model.mesh, settings.repair, counts, progress.update)
        if not repaired.is_fit:
            left = "; ".join(finding.sentence for finding in repaired.faults)
            raise CageError(f"cannot be repaired, what is left: {left}")
    with progress.stage("write"):
        text = encode_exact_obj(repaired.mesh.vertices, repaired.mesh.rings)
        write_bytes(settings.output, text, settings.overwrite)
    return RepairResult(settings, repaired, model.mesh.diagonal)


def format_repair_text(result: RepairResult) -> str:
    """Return what was done, step by step, and how far vertices moved."""
    repaired = result.repaired
    count, corners = len(repaired.mesh.vertices), repaired.mesh.corner_counts
    rows = [("cage", f"fit, {count} vertices, {len(corners)} faces")]
    if repaired.transform is not None:
        rows.append(("transform", repaired.transform.name))
    rows += [("step", step.message) for step in repaired.steps]
    moved = len(repaired.moved_vertices)
    if moved:
        share = 100 * repaired.max_move / result.diagonal
        rows.append(
            ("moved", f"{moved} of {count} vertices, at most {share:.3g} % of the diagonal")
        )
    else:
        rows.append(("moved", "no vertex"))
    rows += [("warning", finding.sentence) for finding in repaired.warnings]
    return format_block(str(result.settings.output), rows)


def format_repair_json(result: RepairResult) -> str:
    """Return the whole record of a repair."""
    repaired = result.repaired
    record = {
        "schema": SCHEMA_VERSION,
        "tool": {"name": "cageik", "version": __version__},
        "is_fit": repaired.is_fit,
        "transform": repaired.transform.name if repaired.transform is not None else None,
        "max_move_percent": 100 * repaired.max_move / result.diagonal,
        "moved_vertices": repaired.moved_vertices.tolist(),
        "vertex_map": repaired.vertex_map.tolist(),
        "steps": [
            {
                "kind": step.kind,
                "message": step.message,
                "count": step.count,
                "vertices": step.vertices.tolist(),
                "max_move": step.max_move,
                "mean_move": step.mean_move,
            }
            for step in repaired.steps
        ],
        "warnings": [_describe(finding) for finding in repaired.warnings],
    }
    return json.dumps(record, indent=1, allow_nan=False) + "\n"


def _describe(finding: Finding) -> str:
    return finding.sentence
