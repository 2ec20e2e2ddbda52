"""A user's cage made fit for a model: read both, repair, write the cage."""

from dataclasses import dataclass, field
from pathlib import Path

from cageik_cli.cages.repair import RepairedCage, repair_cage
from cageik_cli.cages.settings import RepairSettings
from cageik_cli.formats.obj import encode_exact_obj
from cageik_cli.formats.open import load_mesh
from cageik_cli.util.errors import CageError, error_context
from cageik_cli.util.outputs import write_bytes
from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows.run_cage import check_cage_output
from cageik_cli.workflows.settings import READ, WRITTEN, CommandSettings


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


def repair_cage_file(
    settings: RepairCageSettings, progress: ProgressListener | None = None
) -> tuple[RepairedCage, float]:
    """Repair a cage and write it, unless a fault is left.

    Returns
    -------
    repaired : RepairedCage
    diagonal : float
        Of the model, in file units.

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
    return repaired, model.mesh.diagonal
