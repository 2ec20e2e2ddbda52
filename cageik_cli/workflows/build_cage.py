"""A cage built around a model: read the model, build, write the cage."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli import __version__
from cageik_cli.cages.build import (
    BuildSettings,
    BuiltCage,
    Candidate,
    Clip,
    build_cage,
)
from cageik_cli.formats.base.files import file_suffix
from cageik_cli.formats.base.mesh_data import LoadedMesh, check_connectivity
from cageik_cli.formats.obj import encode_exact_obj
from cageik_cli.formats.open import load_mesh, mesh_suffixes, open_sequence
from cageik_cli.formats.settings import ClipSettings, RestFrame
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import error_context
from cageik_cli.util.outputs import write_bytes
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import format_block, format_count
from cageik_cli.workflows.cached_cage import check_cage_output, load_built_cage
from cageik_cli.workflows.measure_cage import make_measured_clip
from cageik_cli.workflows.rest_frame import open_clip_and_choose_rest
from cageik_cli.workflows.settings import READ, READ_CLIP, WRITTEN, CommandSettings

SCHEMA_VERSION = 1

MIN_GOOD_ANGLE = 5.0
"""Smaller angles, degrees, are a warning."""


@dataclass(frozen=True, slots=True)
class CageSettings(CommandSettings):
    """The model to build a cage around, and the file to write it to.

    Attributes
    ----------
    model : str
        A mesh, or a clip: a file, folder or glob.
    output : Path
        An OBJ file.
    rest : Path, optional
        The rest pose of a clip; a frame of it if absent.
    rest_frame : int or "auto", optional
        Which frame then, from 0, or the one in which the least of the surface touches; the first if
        absent.
    animation : tuple of str
        The clip the cage is for; none if empty.
    clip : ClipSettings
        Which of the frames to take, and how to read them.
    jobs : int
        Threads.
    """

    model: str = field(metadata=READ_CLIP)
    output: Path = field(metadata=WRITTEN)
    build: BuildSettings = field(default_factory=BuildSettings)
    rest: Path | None = field(default=None, metadata=READ)
    rest_frame: RestFrame | None = None
    animation: tuple[str, ...] = field(default=(), metadata=READ_CLIP)
    clip: ClipSettings = field(default_factory=lambda: ClipSettings(gaps="close"))
    overwrite: bool = False
    jobs: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class CageResult:
    """A cage that was built and written.

    Attributes
    ----------
    cage : LoadedMesh
        The cage as it is read from the file.
    rest_frame : int or None
        The number of the frame that the model is; None for a file.
    """

    settings: CageSettings
    model: LoadedMesh
    built: BuiltCage
    cage: LoadedMesh
    rest_frame: int | None

    @property
    def notes(self) -> tuple[str, ...]:
        """Return what was changed in reading, one sentence each."""
        return tuple(f"{self.model.source['name']}: {note}" for note in self.model.notes)

    @property
    def rest_options(self) -> str:
        """Return the options by which `cageik extract` takes the same rest pose."""
        if self.settings.rest is not None:
            return f" --rest {self.settings.rest}"
        return f" --rest-frame {self.rest_frame}" if self.rest_frame else ""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return what the user should know of the cage, one sentence each."""
        return list_warnings(self.built)


def build_cage_file(settings: CageSettings, progress: ProgressListener | None = None) -> CageResult:
    """Build a cage around a model and write it.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    NumericalError
        When no candidate passes the tests.
    """
    progress = progress or ProgressListener()
    check_cage_output(settings.output, settings.overwrite)
    with progress.stage("open"):
        model, rest_frame = _open_model(settings)
        clip = _read_animation(settings, model)
    with progress.stage("cage"), error_context(model.source["name"]):
        built = build_cage(model.mesh, settings.build, clip, progress.update)
    cage = load_built_cage(built.cage, list_warnings(built), settings.output.name)
    with progress.stage("write"):
        text = encode_exact_obj(built.cage.vertices, built.cage.faces)
        write_bytes(settings.output, text, settings.overwrite)
    return CageResult(settings, model, built, cage, rest_frame)


def list_warnings(built: BuiltCage) -> tuple[str, ...]:
    """Return what the user should know of a built cage, one sentence each."""
    angle = built.chosen.verdict.smallest_angle
    if angle >= MIN_GOOD_ANGLE:
        return built.notes
    return (
        *built.notes,
        f"the smallest angle is {angle:.2g} degrees, expected {MIN_GOOD_ANGLE:g} or more; weights "
        "nearby are less accurate",
    )


def describe_built_cage(built: BuiltCage) -> str:
    """Return in one line what was built."""
    verdict = built.chosen.verdict
    return (
        f"built, {_count(built.cage)}, genus {verdict.genus}, clearance "
        f"{_format_clearance(built.chosen)}, by {built.chosen.recipe}"
    )


def _open_model(settings: CageSettings) -> tuple[LoadedMesh, int | None]:
    """Read the model: a mesh, or the rest pose of a clip and its number."""
    path = Path(settings.model)
    is_one_mesh = settings.rest is None and settings.rest_frame is None and not path.is_dir()
    if is_one_mesh and file_suffix(path) in mesh_suffixes() and path.exists():
        return load_mesh(path), None
    _, rest, index = open_clip_and_choose_rest(
        (settings.model,), settings.clip, settings.rest, settings.rest_frame or 0
    )
    return rest, index


def _read_animation(settings: CageSettings, model: LoadedMesh) -> Clip | None:
    """Read some frames of the animation, if there is one."""
    if not settings.animation:
        return None
    sequence = open_sequence(list(settings.animation), settings.clip, model)
    with error_context(model.source["name"]):
        fans, expected = model.mesh.fan_triangulated, sequence.first.fan_triangulated
        check_connectivity(len(fans.vertices), fans.faces, expected, "the first frame")
    held = [k for k in range(len(sequence)) if k not in sequence.missing]
    return make_measured_clip(
        model.mesh, len(held), lambda k: sequence.read_frame(held[k]), settings.jobs
    )


def format_cage_text(result: CageResult, is_detailed: bool = False) -> str:
    """Return the facts of the cage and the warnings; the candidates, too, if asked."""
    built, verdict = result.built, result.built.chosen.verdict
    rows = [
        ("model", f"{result.model.source['name']}: {_count(result.model.mesh)}"),
        ("cage", f"{_count(built.cage)}, genus {verdict.genus}"),
        ("clearance", _format_clearance(built.chosen)),
        ("shape", f"smallest angle {verdict.smallest_angle:.3g} degrees, largest valence "
         f"{verdict.largest_valence}"),
        ("recipe", f"{built.chosen.recipe}, best of {_count_valid(built)}"),
    ]  # fmt: skip
    if built.chosen.error is not None:
        rows.append(("error", f"{built.chosen.error:.4f} % of the diagonal, at preview accuracy"))
    rows += [("warning", warning) for warning in result.warnings]
    rows += [("note", note) for note in result.notes]
    if is_detailed:
        rows += [("candidate", _describe_candidate(known)) for known in built.candidates]
    return format_block(str(result.settings.output), rows)


def format_cage_json(result: CageResult) -> str:
    """Return the whole record, with all candidates."""
    settings, built = result.settings, result.built
    record = {
        "schema": SCHEMA_VERSION,
        "tool": {"name": "cageik", "version": __version__},
        "settings": {
            "vertices": settings.build.vertices,
            "clearance_percent": 100 * settings.build.clearance,
            "rest_frame": result.rest_frame,
        },
        "model": result.model.source,
        "cage": result.cage.source | _candidate_record(built.chosen),
        "warnings": result.warnings,
        "notes": result.notes,
        "candidates": [_candidate_record(known) for known in built.candidates],
    }
    return json.dumps(record, indent=1, allow_nan=False) + "\n"


def _candidate_record(candidate: Candidate) -> dict[str, Any]:
    verdict = candidate.verdict
    clearance = 100 * verdict.clearance
    return {
        "recipe": candidate.recipe,
        "vertices": len(candidate.cage.vertices),
        "faces": len(candidate.cage.faces),
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
    return f"{len(mesh.vertices)} vertices, {len(mesh.faces)} triangles"


def _count_valid(built: BuiltCage) -> str:
    valid = sum(known.verdict.is_valid for known in built.candidates)
    return f"{valid} valid of {format_count(len(built.candidates), 'candidate')}"


def _format_clearance(candidate: Candidate) -> str:
    verdict = candidate.verdict
    mean = f"mean distance {100 * verdict.looseness:.3g} %"
    if not np.isfinite(verdict.clearance):
        return f"more than twice what was asked for, {mean} of the diagonal"
    return f"{100 * verdict.clearance:.3g} % of the diagonal, {mean}"


def _describe_candidate(candidate: Candidate) -> str:
    verdict = candidate.verdict
    facts = f"{candidate.recipe}: {len(candidate.cage.vertices)} vertices"
    if not verdict.is_valid:
        return f"{facts}; {verdict.faults[0]}"
    facts += (
        f", genus {verdict.genus}, mean distance {100 * verdict.looseness:.3g} %, smallest angle "
        f"{verdict.smallest_angle:.3g} degrees"
    )
    return facts if candidate.error is None else f"{facts}, error {candidate.error:.4f} %"
