"""The plan of an extraction: what its settings and their files give before any work."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cageik_cli import __version__
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.formats.base.hdf5 import check_hdf5_suffix
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.vertex_weights import FrameWeightsFile
from cageik_cli.solver.fitting.record import FitSettings
from cageik_cli.solver.settings import AREA, CaptureSettings
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.cache import compute_key
from cageik_cli.store.checkpoint import check_checkpoint_path, checkpoint_progress
from cageik_cli.store.result import Result, checkpoint_path, has_weights, read_result
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import CheckpointError, InputError, SettingError, error_context
from cageik_cli.util.outputs import check_writable
from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows.bind import WeightSettings, bind_cached, load_matching_binding
from cageik_cli.workflows.cached_cage import build_cached, check_cage_output
from cageik_cli.workflows.fit import fit_to_clips
from cageik_cli.workflows.repair_hint import find_rest_file, suggest_repair
from cageik_cli.workflows.rest_frame import open_clip_and_choose_rest
from cageik_cli.workflows.settings import ExtractSettings
from cageik_cli.workflows.vertex_weights import load_vertex_weights


@dataclass(frozen=True, slots=True, eq=False)
class ExtractionPlan:
    """All that is known of an extraction before its weights and its first frame are computed.

    Attributes
    ----------
    settings : ExtractSettings
        With the number of the rest frame, if it was chosen.
    sequence : MeshSequence
        The clip.
    cage : LoadedMesh, optional
        None when it comes with a binding, or is not built yet.
    stored_binding : StoredBinding, optional
        The weights, if they are known already: those of the binding file, if one is named.
    vertex_weights : (m,) float64, optional
        Of mean one. All are equal if each frame has its own.
    sources : dict
        Name and digest of each file that was read, all but the frames; and of a cage that was
        built.
    existing : Result, optional
        A complete result of this very plan at the output, to be kept as it is.
    frame_weights : FrameWeightsFile, optional
        The weights of the vertices of each frame.
    """

    settings: ExtractSettings
    sequence: MeshSequence
    rest: LoadedMesh
    cage: LoadedMesh | None
    stored_binding: StoredBinding | None
    vertex_weights: Floats | None
    sources: dict[str, Any]
    existing: Result | None = None
    frame_weights: FrameWeightsFile | None = None

    @property
    def weighs_frames(self) -> bool:
        """Whether vertices of one frame may count differently than in another."""
        settings = self.settings
        is_asked = settings.capture != CaptureSettings() or settings.clip.missing
        return is_asked or self.frame_weights is not None

    @property
    def scene(self) -> Scene:
        """Return time and space: as set, else as the clip says, else the defaults."""
        return self.settings.scene.override(self.sequence.scene.override(Scene()))

    @property
    def rest_index(self) -> int | None:
        """Return the number of the rest pose in the clip; None if it is a file of its own."""
        return int(self.settings.rest_frame) if self.settings.rest is None else None

    @property
    def rest_file(self) -> Path | None:
        """Return the mesh file of the rest pose; None if it is in a file of many frames."""
        if self.rest_index is None:
            return self.settings.rest
        return find_rest_file(self.sequence, self.rest_index)

    @property
    def bind_settings(self) -> BindSettings:
        """Return how the weights are computed, or were when they come from a binding file."""
        stored = self.stored_binding
        return self.settings.bind if stored is None else stored.binding.settings

    @property
    def fit_settings(self) -> FitSettings | None:
        """Return how the weights are fitted, or were when they come from a binding file."""
        stored = self.stored_binding
        if stored is None or self.settings.fit is not None:
            return self.settings.fit
        return None if stored.binding.fit is None else stored.binding.fit.settings

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
            "rest_frame": self.rest_index,
            "vertex_weights": _describe_vertex_weights(settings.vertex_weights),
            **built,
            **({} if self.fit_settings is None else self.fit_settings.describe()),
            **settings.describe_capture(),
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
        if self.settings.fit is not None:
            shared |= self._describe_fitted_clip()
        rest = self.rest.mesh
        return compute_key(asdict(self.bind_settings) | shared, rest.vertices, rest.faces)

    def _describe_fitted_clip(self) -> dict[str, Any]:
        """Return what fitted weights depend on beside the rest pose and the cage."""
        settings = self.settings
        return {
            "fit": asdict(settings.fit) if settings.fit is not None else None,
            "solve": asdict(settings.solve),
            "weighted": self.sources.get("vertex_weights", settings.vertex_weights == AREA),
            "memory": settings.memory,
            "skips": settings.skips_bad_frames,
            "clip": (settings.frames, repr(settings.clip), self.sequence.names),
        }

    def collect_sources(self) -> dict[str, Any]:
        """Return name and digest of each file that was read, the frames included."""
        return self.sources | {"frames": self.sequence.describe_source()}


def _describe_vertex_weights(given: Path | str | None) -> bool | str:
    """Return whether vertices have weights from a file, or the word for those of no file."""
    return given if isinstance(given, str) else given is not None


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
    checkpoint_file = checkpoint_path(settings.output)
    check_checkpoint_path(checkpoint_file)
    if checkpoint_file.exists() and not may_replace:
        done, count = checkpoint_progress(checkpoint_file)
        raise CheckpointError(
            f"{checkpoint_file}: checkpoint found ({done} of {count} frames): continue with "
            "--resume or start over with --overwrite"
        )
    if settings.cage_output is not None:
        check_cage_output(settings.cage_output, may_replace)


def plan_extraction(
    settings: ExtractSettings, stored_binding: StoredBinding | None = None
) -> ExtractionPlan:
    """Open the clip, read the files that are named beside it, and find a result that is kept.

    Nothing is written; who runs the plan calls `check_output_path` first.

    Parameters
    ----------
    stored_binding : StoredBinding, optional
        The weights, if they are known: of this rest pose, cage and settings.

    Raises
    ------
    InputError
        Naming the file at fault; or when there is another result that may not be overwritten.
    """
    sequence, rest, rest_index = open_clip_and_choose_rest(
        settings.frames, settings.clip, settings.rest, settings.rest_frame
    )
    settings = replace(settings, rest_frame=rest_index or 0)
    cage = load_mesh(settings.cage) if settings.cage is not None else None
    sources = {"rest": rest.source}
    if settings.binding is not None:
        stored_binding = stored_binding or load_matching_binding(settings.binding, rest, cage)
        sources = stored_binding.sources | sources
    elif cage is not None:
        sources["cage"] = cage.source
    elif stored_binding is not None:
        sources["cage"] = stored_binding.sources["cage"]
    weights = load_vertex_weights(settings.vertex_weights, rest, len(sequence))
    sources |= weights.sources
    plan = ExtractionPlan(
        settings=settings,
        sequence=sequence,
        rest=rest,
        cage=cage,
        stored_binding=stored_binding,
        vertex_weights=weights.vertices,
        sources=sources,
        frame_weights=weights.frames,
    )
    settings.capture.check_period(plan.scene.fps)
    return replace(plan, existing=_find_existing_result(plan)) if settings.resume else plan


def build_missing_cage(plan: ExtractionPlan, progress: ProgressListener) -> ExtractionPlan:
    """Return the plan with a cage: one is built if none is given, and no weights are known.

    The same model gives the same cage each time, so that a checkpoint of it can be continued.
    """
    if not plan.settings.builds_cage or plan.stored_binding is not None:
        return plan
    with progress.stage("cage"), error_context(plan.rest.source["name"]):
        settings = plan.settings
        cage = build_cached(plan.rest.mesh, settings.build, settings.cache, progress)
    return replace(plan, cage=cage, sources=plan.sources | {"cage": cage.source})


def load_or_compute_binding(plan: ExtractionPlan, progress: ProgressListener) -> StoredBinding:
    """Return the weights: those that are known, else of the cache, else computed; then fitted.

    Fitted ones come with those before the fit, if the result is to compare them.
    """
    rest, settings = plan.rest, plan.settings
    if plan.stored_binding is not None:
        with progress.stage("bind"):
            progress.update(len(rest.mesh.vertices), len(rest.mesh.vertices))
            return _restore_unfitted(plan, plan.stored_binding, progress)
    if plan.cage is None:
        raise SettingError("neither a cage nor a binding is given; give one of them")
    with (
        progress.stage("bind"),
        error_context(settings.cage or plan.cage.source["name"]),
        suggest_repair(settings.cage, plan.rest_file),
    ):
        weight_settings = WeightSettings(settings.bind, settings.cache, settings.jobs)
        stored = bind_cached(rest, plan.cage, weight_settings, progress)
    if settings.fit is None:
        return stored
    with progress.stage("fit"):
        fitted = fit_to_clips(
            stored.binding,
            [plan.sequence],
            settings.fit,
            progress,
            solve=settings.solve,
            vertex_weights=plan.vertex_weights,
            memory=settings.memory,
            jobs=settings.jobs,
            skips_bad_frames=settings.skips_bad_frames,
            cache=settings.cache,
        )
    return replace(stored, binding=fitted)


def _restore_unfitted(
    plan: ExtractionPlan, stored: StoredBinding, progress: ProgressListener
) -> StoredBinding:
    """Return a stored binding with its weights before a fit, which binding files do not hold."""
    settings, binding = plan.settings, stored.binding
    if binding.fit is None or binding.unfitted is not None or not settings.keep_weights:
        return stored
    cage = LoadedMesh(binding.cage, stored.sources["cage"])
    weight_settings = WeightSettings(binding.settings, settings.cache, settings.jobs)
    with error_context(settings.binding):
        unfitted = bind_cached(plan.rest, cage, weight_settings, progress).binding
    return replace(stored, binding=replace(binding, unfitted=unfitted))


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
    skipped = [why for k, why in result.skipped.items() if k not in plan.sequence.missing]
    if skipped and not plan.settings.accepts_gaps:
        raise CheckpointError(
            f"{result.path}: {len(skipped)} frames are skipped in it, the first: "
            f"{skipped[0]}; repair them and use --overwrite, or accept "
            "the gaps with --on-bad-frame skip"
        )


def _has_same_sources(result: Result, plan: ExtractionPlan) -> bool:
    """Return whether a result is of the plan's files; a cage that is built follows from them."""
    expected = plan.collect_sources()
    if plan.settings.builds_cage and "cage" in result.sources:
        expected |= {"cage": result.sources["cage"]}
    return result.sources == expected
