"""What an extraction is to do: its settings, and the plan that is made of them and their files."""

import hashlib
import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli import __version__
from cageik_cli.cages.build import BuildSettings, build_cage
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.formats.base.hdf5 import check_hdf5_suffix
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.base.settings import ClipSettings
from cageik_cli.formats.mesh_file import load_mesh
from cageik_cli.formats.open import list_input_files, open_clip_and_rest
from cageik_cli.formats.scene import Scene, SceneHints
from cageik_cli.formats.vertex_weights import load_vertex_weights
from cageik_cli.solver.dual_laplacian import normalize_weights
from cageik_cli.solver.settings import SolveSettings
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.checkpoint import checkpoint_progress
from cageik_cli.store.result import Result, checkpoint_path, has_weights, read_result
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import CheckpointError, InputError, SettingError, error_context
from cageik_cli.util.outputs import check_writable
from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows.bind import WeightSettings, bind_cached, load_matching_binding
from cageik_cli.workflows.build_cage import (
    check_cage_output,
    describe_built_cage,
    load_built_cage,
)
from cageik_cli.workflows.repair_hint import find_rest_file, suggest_repair

BUILT_CAGE_NAME = "built cage"
"""Name, in the sources of a result, of a cage that was built for it."""


@dataclass(frozen=True, slots=True)
class ExtractSettings:
    """What to extract, from what, to where.

    Attributes
    ----------
    frames : tuple of str
        Files, folders and globs, or one file that holds a clip.
    cage : Path, optional
        Without it, and without a binding, a cage is built around the rest pose.
    output : Path
    binding : Path, optional
        A binding file of this rest pose, and of `cage` if that is given; `bind` is then ignored.
    cache : Path, optional
        The folder of the weight cache; none is used if absent.
    rest : Path, optional
        The rest pose; a frame of the clip if absent.
    rest_frame : int
        Which frame then, from 0.
    vertex_weights : Path, optional
        A file with one number per vertex of the model.
    bind : BindSettings
    solve : SolveSettings
    clip : ClipSettings
        Which of the frames to take, and how to read them.
    overwrite, keep_weights : bool
    resume : bool
        Continue an interrupted run of the same plan; start if there is none.
    on_bad_frame : str
        "stop", or "skip": leave a gap for a frame that cannot be read, and report it.
    scene : SceneHints
        Time and space, where they differ from what the files of the clip say.
    memory : int
        Bytes for the weights and blocks of frames.
    jobs : int
        Threads.
    build : BuildSettings
        Of the cage, if one is built.
    cage_output : Path, optional
        An OBJ file to which the cage that is built is written.
    """

    frames: tuple[str, ...]
    cage: Path | None
    output: Path
    binding: Path | None = None
    cache: Path | None = None
    rest: Path | None = None
    rest_frame: int = 0
    vertex_weights: Path | None = None
    bind: BindSettings = field(default_factory=BindSettings)
    solve: SolveSettings = field(default_factory=SolveSettings)
    clip: ClipSettings = field(default_factory=ClipSettings)
    overwrite: bool = False
    resume: bool = False
    on_bad_frame: str = "stop"
    keep_weights: bool = True
    scene: SceneHints = field(default_factory=SceneHints)
    memory: int = 1 << 30
    jobs: int = 1
    build: BuildSettings = field(default_factory=BuildSettings)
    cage_output: Path | None = None

    def __post_init__(self) -> None:
        if self.cage_output is not None and not self.builds_cage:
            raise SettingError(
                f"{self.cage_output}: is for a cage that is built, but a cage is given; leave out "
                "one of them"
            )

    def inputs(self) -> list[Path]:
        """Return the files that are read."""
        named = (self.cage, self.binding, self.rest, self.vertex_weights)
        files = [path for path in named if path is not None]
        return files + list_input_files(list(self.frames))

    def outputs(self) -> list[Path]:
        """Return the files that are written."""
        return [self.output, *([] if self.cage_output is None else [self.cage_output])]

    @property
    def builds_cage(self) -> bool:
        """Whether a cage is built, as none is given."""
        return self.cage is None and self.binding is None

    @property
    def skips_bad_frames(self) -> bool:
        """Whether a frame that cannot be read becomes a gap."""
        return self.on_bad_frame == "skip"


@dataclass(frozen=True, slots=True, eq=False)
class ExtractionPlan:
    """All that is known of an extraction before its weights and its first frame are computed.

    Attributes
    ----------
    settings : ExtractSettings
    sequence : MeshSequence
        The clip.
    rest : LoadedMesh
    cage : LoadedMesh, optional
        None when it comes with a binding, or is not built yet.
    stored_binding : StoredBinding, optional
        The weights, if they are known already: those of the binding file, if one is named.
    vertex_weights : (m,) float64, optional
        Of mean one.
    sources : dict
        Name and digest of each file that was read, all but the frames; and of a cage that was
        built.
    existing : Result, optional
        A complete result of this very plan at the output, to be kept as it is.
    """

    settings: ExtractSettings
    sequence: MeshSequence
    rest: LoadedMesh
    cage: LoadedMesh | None
    stored_binding: StoredBinding | None
    vertex_weights: Floats | None
    sources: dict[str, Any]
    existing: Result | None = None

    @property
    def scene(self) -> Scene:
        """Return time and space: as set, else as the clip says, else the defaults."""
        return self.settings.scene.override(self.sequence.scene.override(Scene()))

    @property
    def rest_file(self) -> Path | None:
        """Return the mesh file of the rest pose; None if it is in a file of many frames."""
        return self.settings.rest or find_rest_file(self.sequence, self.settings.rest_frame)

    @property
    def bind_settings(self) -> BindSettings:
        """Return how the weights are computed, or were when they come from a binding file."""
        stored = self.stored_binding
        return self.settings.bind if stored is None else stored.binding.settings

    @property
    def recorded_settings(self) -> dict[str, Any]:
        """Return the settings on which the numbers depend, as a result file records them."""
        settings, solve = self.settings, self.settings.solve
        built = {}
        if settings.builds_cage:
            built = {
                "cage_vertices": settings.build.vertices,
                "cage_clearance": settings.build.clearance,
            }
        return {
            "alpha": solve.alpha,
            "beta": solve.beta,
            "align": solve.align,
            **asdict(self.bind_settings),
            "rest_frame": settings.rest_frame if settings.rest is None else None,
            "vertex_weights": settings.vertex_weights is not None,
            **built,
        }

    @property
    def weights_key(self) -> str:
        """Return a digest of what the weights depend on: plans of one key may share them.

        It does not cover the name of the file of the rest pose, since the frames of two clips have
        different names, nor the number of threads. A cage that is built depends on the rest pose
        and on how it is built alone.
        """
        shared: dict[str, Any] = {
            name: self.sources[name] for name in ("cage", "binding") if name in self.sources
        }
        if self.settings.builds_cage:
            shared = {"build": asdict(self.settings.build)}
        recorded = asdict(self.bind_settings) | shared
        digest = hashlib.sha256(json.dumps(recorded, sort_keys=True).encode())
        for array in (self.rest.mesh.vertices, self.rest.mesh.faces):
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()

    def collect_sources(self) -> dict[str, Any]:
        """Return name and digest of each file that was read, the frames included."""
        return self.sources | {"frames": self.sequence.describe_source()}


def check_output_path(settings: ExtractSettings) -> None:
    """Refuse, before any work, to write over a result or a checkpoint.

    Raises
    ------
    InputError
        Naming the file and what to do.
    """
    may_replace = settings.overwrite or settings.resume
    check_writable(settings.output, may_replace)
    check_hdf5_suffix(settings.output)
    if settings.cage_output is not None:
        check_cage_output(settings.cage_output, may_replace)
    checkpoint_file = checkpoint_path(settings.output)
    if checkpoint_file.exists() and not may_replace:
        done, count = checkpoint_progress(checkpoint_file)
        raise CheckpointError(
            f"{checkpoint_file}: checkpoint found ({done} of {count} frames): continue with "
            "--resume or start over with --overwrite"
        )


def plan_extraction(
    settings: ExtractSettings, stored_binding: StoredBinding | None = None
) -> ExtractionPlan:
    """Open the clip, read the files that are named beside it, and find a result that is kept.

    Nothing is written; who runs the plan calls `check_output_path` first.

    Parameters
    ----------
    settings : ExtractSettings
    stored_binding : StoredBinding, optional
        The weights, if they are known: of this rest pose, cage and settings.

    Raises
    ------
    InputError
        Naming the file at fault; or when there is another result that may not be overwritten.
    """
    sequence, rest = open_clip_and_rest(
        settings.frames, settings.clip, settings.rest, settings.rest_frame
    )
    cage = load_mesh(settings.cage) if settings.cage is not None else None
    sources = {"rest": rest.source}
    if settings.binding is not None:
        stored_binding = stored_binding or load_matching_binding(settings.binding, rest, cage)
        sources = stored_binding.sources | sources
    elif cage is not None:
        sources["cage"] = cage.source
    elif stored_binding is not None:
        sources["cage"] = stored_binding.sources["cage"]
    weights = None
    if settings.vertex_weights is not None:
        loaded, sources["vertex_weights"] = load_vertex_weights(settings.vertex_weights)
        with error_context(settings.vertex_weights):
            weights = normalize_weights(loaded, len(rest.mesh.vertices))
    plan = ExtractionPlan(settings, sequence, rest, cage, stored_binding, weights, sources)
    return replace(plan, existing=_find_existing_result(plan)) if settings.resume else plan


def build_missing_cage(plan: ExtractionPlan, progress: ProgressListener) -> ExtractionPlan:
    """Return the plan with a cage: one is built if none is given, and no weights are known.

    The same cage is built each time, so that a checkpoint of it can be continued.
    """
    if not plan.settings.builds_cage or plan.stored_binding is not None:
        return plan
    with progress.stage("cage"), error_context(plan.rest.source["name"]):
        built = build_cage(plan.rest.mesh, plan.settings.build, progress=progress.update)
    cage = load_built_cage(built, BUILT_CAGE_NAME)
    progress.note("cage", describe_built_cage(built))
    return replace(plan, cage=cage, sources=plan.sources | {"cage": cage.source})


def load_or_compute_binding(plan: ExtractionPlan, progress: ProgressListener) -> StoredBinding:
    """Return the weights: those that are known, else of the cache, else computed."""
    rest, settings = plan.rest, plan.settings
    if plan.stored_binding is not None:
        progress.update(len(rest.mesh.vertices), len(rest.mesh.vertices))
        return plan.stored_binding
    if plan.cage is None:
        raise SettingError("neither a cage nor a binding is given; give one of them")
    with (
        error_context(settings.cage or plan.cage.source["name"]),
        suggest_repair(settings.cage, plan.rest_file),
    ):
        weight_settings = WeightSettings(settings.bind, settings.cache, settings.jobs)
        return bind_cached(rest, plan.cage, weight_settings, progress)


def _find_existing_result(plan: ExtractionPlan) -> Result | None:
    """Return the result that is at the output if the plan would make the same; else None.

    Raises
    ------
    InputError
        When there is another result, or something else, or a result with gaps where the plan
        allows none; unless it may be overwritten.
    """
    settings = plan.settings
    if not settings.output.exists():
        return None
    try:
        result = read_result(settings.output)
        _check_same_run(result, plan)
    except InputError:
        if settings.overwrite:
            return None
        raise
    return result


def _check_same_run(result: Result, plan: ExtractionPlan) -> None:
    differences = (
        ("another version of cageik", result.version != __version__),
        ("other settings", result.settings != plan.recorded_settings),
        ("other settings", has_weights(result) != plan.settings.keep_weights),
        ("other frames", result.frames != plan.sequence.names),
        ("another scene", result.scene != plan.scene),
        ("other files", not _has_same_sources(result, plan)),
    )
    for what, differs in differences:
        if differs:
            raise CheckpointError(
                f"{result.path}: is the result of {what}; choose another name, or replace it with "
                "--overwrite"
            )
    if result.skipped and not plan.settings.skips_bad_frames:
        raise CheckpointError(
            f"{result.path}: {len(result.skipped)} frames are skipped in it, the first: "
            f"{next(iter(result.skipped.values()))}; repair them and use --overwrite, or accept "
            "the gaps with --on-bad-frame skip"
        )


def _has_same_sources(result: Result, plan: ExtractionPlan) -> bool:
    """Return whether a result is of the plan's files; a cage that is built follows from them."""
    expected = plan.collect_sources()
    if plan.settings.builds_cage and "cage" in result.sources:
        expected |= {"cage": result.sources["cage"]}
    return result.sources == expected
