"""Cages of a result, or of a clip, applied to a model at rest or to another mesh in the cage."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from cageik_cli.fit.transferred import TransferredChange
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.write import ExportSummary, Output, split_output, write_animation
from cageik_cli.inputs.caged_model import CagedModel, report_skipped_frames, transfer_fit
from cageik_cli.inputs.clip import open_clip_of
from cageik_cli.inputs.reconstruction import CageFrames, PointReconstruction, Reconstruction
from cageik_cli.inputs.scene import CommonScene, MovedMeshes
from cageik_cli.inputs.settings import WeightSettings
from cageik_cli.inputs.source import LoadedModel
from cageik_cli.inputs.weights import bind_cached
from cageik_cli.method.weights.binding import FRAMES_PER_PRODUCT, Binding
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.run.export import write_converted
from cageik_cli.run.rig import check_rig, make_rig
from cageik_cli.run.settings import DeformSettings
from cageik_cli.store.result import read_low_rank, read_rotations
from cageik_cli.util.arrays import Floats, count_frames
from cageik_cli.util.errors import SettingError, error_context, join_truncated
from cageik_cli.util.messages import Hint, say
from cageik_cli.util.outputs import check_no_overlap
from cageik_cli.util.progress import ProgressListener, note_all
from cageik_cli.util.threads import limit_blas_threads

NO_CAGES = say("which has no cages; give them by `cages=`, or give a result")
NO_SOLVE = say("but `influences=` needs the settings of a result; give one")


def deform(settings: DeformSettings, progress: ProgressListener | None = None) -> ExportSummary:
    """Write the animation of the mesh that the cages move."""
    return _Deformation(settings, progress or ProgressListener()).run()


class _Deformation:
    """A model that cages move, from the files to the animation."""

    def __init__(self, settings: DeformSettings, progress: ProgressListener) -> None:
        self._settings, self._progress = settings, progress

    def run(self) -> ExportSummary:
        """Open the model, the cages and the weights, and write the frames."""
        settings = self._settings
        if not settings.mesh:  # points have formats of their own
            settings.output.find_writer()  # refuses other formats before anything is read
        self._source = CagedModel.read(settings.source)
        self._common = CommonScene(
            settings.scene.over(self._source.hints),
            settings.given_in,
            is_shared=len(settings.mesh) + (settings.cages is not None) > 1,
            can_restate=True,
        )
        self._meshes = MovedMeshes(self._common, settings.clip.exclude)
        given = self._load_models() if settings.mesh else None
        output = settings.output if given is None else given.choose_output(settings.output)
        name, model = _make_object_name(settings.mesh), given or self._source.model
        outputs = split_output(output, model.mesh.mesh, name)
        check_no_overlap([path for one in outputs for path in one.list_paths()], settings.inputs())
        for one in outputs:
            one.check_writable()
        if settings.influences is not None:
            result = self._source.require_result(NO_SOLVE)
            check_rig(result, settings.influences, settings.joints)
        clip = self._open_clip()
        self._model = model
        self._binding, self._transferred = self._load_or_compute_binding()
        if clip is None:
            result = self._source.require_result(NO_CAGES)
            report_skipped_frames(result, self._progress)
            self._cages, scene = CageFrames.from_result(result, self._binding), result.scene
        else:
            rotations = self._read_rotations(len(clip)) if self._binding.has_offsets else None
            self._cages = replace(CageFrames.from_clip(clip, settings.jobs), rotations=rotations)
            scene = self._common.hints.override(clip.scene.override(self._source.scene))
        animation = Animation(
            rest=self._binding.rest,
            frame_count=self._cages.count,
            scene=settings.scene.override(scene),
            name=name,
            morphs=settings.morphs,
            texture=settings.texture,
        )
        return replace(self._write(output, animation), unit=self._model.unit)

    def _write(self, output: Output, animation: Animation) -> ExportSummary:
        """Write the frames, in the unit and with the up axis that are asked for."""
        factory, progress = self._model.choose_writer(output), self._progress
        conversion = SceneConversion.of_output(animation.scene, self._settings.to)
        # One thread per product: the last digits depend on how many.
        with limit_blas_threads(1):
            if factory is None:
                to, frames = self._settings.to, self._move_mesh()
                return write_converted(output, to, animation, frames, progress)
            if conversion and self._binding.has_offsets:
                raise SettingError(
                    f"{self._model.name}: is {self._model.kind} with weights of few "
                    "influences, which cannot be converted; " + say("leave out `to=`")
                )
            # Cages that are converted turn and scale what moves with the points, too.
            self._cages = self._cages.convert(conversion)
            if conversion:
                progress.note("note", f"{output.path.name}: {conversion.note}")
            animation = conversion.convert_animation(animation)
            frames = self._move_points(conversion)
            return write_animation(output, animation, frames, progress, factory)

    def _load_models(self) -> LoadedModel:
        """Read the model, or the meshes, that are moved instead of the model at rest."""
        settings = self._settings
        model, unmatched = self._meshes.load(settings.mesh), self._meshes.unmatched
        if unmatched and settings.cages is None:
            raise SettingError(
                f"{join_truncated(map(str, settings.mesh))}: "
                + Hint("exclude", unmatched[0])
                + " matches no part; give the path of a part, or a name in it"
            )
        if model.points is not None and settings.influences is not None:
            raise SettingError(
                f"{settings.mesh[0]}: is {model.kind}, and weights of few influences are "
                "fitted to a surface; " + say("leave out `influences=`")
            )
        return model

    @property
    def _place(self) -> object:
        """What messages on the model begin with."""
        settings = self._settings
        if len(settings.mesh) > 1:
            return self._model.name
        return settings.mesh[0] if settings.mesh else settings.source

    def _open_clip(self) -> MeshSequence | None:
        """Open the clip of cages, if one is given, which has the connectivity of the source's."""
        settings, source, progress = self._settings, self._source, self._progress
        if settings.cages is None:
            source.require_result(NO_CAGES)
            return None
        assert source.cage is not None
        result = source.result
        exclude = tuple(self._meshes.unmatched)  # what a mesh has is not meant for the cages
        sampled = replace(settings.clip, fps=settings.scene.fps, exclude=exclude)
        clip, _ = open_clip_of(
            source.cage,
            [settings.cages],
            sampled,
            self._common,
            progress,
            called=source.cage_name,
            beside="the rest cage",
            other="the binding" if result is None else "the result",
            edited=None if result is None else CageFrames.from_result(result),
        )
        if clip.missing:
            names = join_truncated(clip.names[k] for k in sorted(clip.missing))
            missing = f"{len(clip.missing)} cages are missing ({names}) and interpolated"
            progress.note("note", missing)
        return clip

    def _load_or_compute_binding(self) -> tuple[Binding, TransferredChange | None]:
        """Return the weights of the source if they fit the settings; else bind the mesh.

        With them comes what was added to weights of the mesh from the fit of the source.
        """
        settings, source, mesh = self._settings, self._source, self._model.mesh
        held = source.read_bind_settings()
        bind = BindSettings(
            settings.coordinates or held.coordinates,
            settings.accuracy or held.accuracy,
            settings.outside or held.outside,
        )
        is_own = not settings.mesh and bind == held
        found = source.find_binding() if is_own else None
        if found is not None:
            return found, None
        assert source.cage is not None
        weights = WeightSettings(bind, settings.cache, settings.jobs)
        with (
            self._progress.stage("bind"),
            error_context(self._place),
            self._meshes.explain_outside(source.cage.mesh, bind.outside),
        ):
            stored = bind_cached(
                mesh, source.cage, weights, self._progress, is_own_cage=not settings.mesh
            )
            binding = stored.binding
            if settings.mesh and not binding.projected:
                self._meshes.check_small(source.cage.mesh, source.model.mesh.mesh)
        note_all(self._progress, (*mesh.notes, *binding.notes), self._model.name)
        if source.fit is None:
            return binding, None
        if settings.mesh:
            stored = transfer_fit(source, stored, weights, self._progress, SceneConversion())
            return stored.binding, stored.transferred
        return self._apply_fit(binding, is_own), None

    def _apply_fit(self, binding: Binding, is_own: bool) -> Binding:
        """Return computed weights of the rest model with what a fit has changed, if known."""
        path = self._source.path
        if is_own:
            change = read_low_rank(self._source.require_result("which holds its weights"))
            if change is not None:
                return replace(binding, weights=change.add_to(binding.weights))
            raise SettingError(
                f"{path}: its weights are fitted to a clip and not in it, so they cannot be "
                "computed again; "
                + say("extract it again with them (`keep_weights=True`), or with `fit_rank=`")
            )
        self._progress.note(
            "note",
            f"the cages of {path.name} are for weights that were fitted to its model; it is asked "
            f"for {binding.settings.coordinates} weights, which follow them less closely",
        )
        return binding

    def _move_points(self, conversion: SceneConversion) -> Iterator[Any]:
        """Return rows of the points of the model, in blocks of frames."""
        settings, model = self._settings, self._model
        note = model.note(self._progress)
        oriented = model.find_oriented(self._binding, note)
        if oriented is None:
            if conversion.turns and model.points is not None and model.points.normals is not None:
                raise SettingError(
                    f"{model.name}: has normals, which these weights cannot turn to another "
                    "up axis; " + say("use `coordinates=harmonic`, or leave out `to=`")
                )
            return self._move_mesh()
        with error_context(self._place):
            points = PointReconstruction.prepare(
                self._binding,
                oriented,
                memory=settings.memory,
                jobs=settings.jobs,
                progress=self._progress,
                transferred=self._transferred,
            )
        return points.stream_rows(model.make_rest_rows(), self._cages, note)

    def _move_mesh(self) -> Iterator[Floats]:
        """Return the vertices of the model, in blocks of frames."""
        settings, binding = self._settings, self._binding
        target = Reconstruction(binding, self._cages)
        if settings.influences is None:
            memory = settings.memory - binding.weights.nbytes
            size = choose_block_size(memory, len(binding.rest.vertices))
            return target.stream_meshes(size, settings.jobs)
        result = self._source.require_result(NO_SOLVE)
        rig = make_rig(
            result,
            target,
            self._progress,
            influences=settings.influences,
            name=settings.output.path.name,
            joints=settings.joints,
            compares=settings.compares,
            memory=settings.memory,
            jobs=settings.jobs,
            cache=settings.cache,
        )
        return (block.meshes for block in rig.blocks())

    def _read_rotations(self, count: int) -> Floats:
        """Read the rotations of the rest pose to each frame of a clip of so many cages."""
        result = self._source.require_result(
            "with weights of few influences, which turn with the frames of a clip; give a result "
            "of that clip"
        )
        if count != len(result.frames):
            raise SettingError(
                f"{self._settings.cages}: has {count} cages, expected {len(result.frames)} as the "
                "result, whose weights have few influences: they turn with its frames; give as "
                "many cages"
            )
        return read_rotations(result)


def choose_block_size(memory: int, vertices: int) -> int:
    """Return how many frames, in whole groups, fit into `memory` bytes; one group at least."""
    # Four arrays (m, 3) per frame at once: in the two blocks, moved to the origin, in the writer.
    groups = count_frames(memory, vertices * FRAMES_PER_PRODUCT, 4)
    return FRAMES_PER_PRODUCT * min(groups, 16 // FRAMES_PER_PRODUCT)  # more is not faster


def _make_object_name(meshes: tuple[Path, ...]) -> str:
    """Return the name of the only mesh in letters that all formats accept."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", meshes[0].stem) if len(meshes) == 1 else "mesh"
    return f"_{name}" if name[0].isdigit() else name
