"""A cage around a model: built or repaired from file to file, or built around a mesh in memory."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.cages.bind import bind
from cageik_cli.cages.builder import build as cage_builder
from cageik_cli.cages.builder.build import BuiltCage, Clip
from cageik_cli.cages.repair.repair import RepairedCage, repair_cage
from cageik_cli.cages.settings import (
    DEFAULT_SYMMETRY,
    BuildSettings,
    SymmetryChoice,
)
from cageik_cli.formats.base.files import describe_source
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.sequence import MeshSequence, as_sequence
from cageik_cli.formats.find_files import Source
from cageik_cli.formats.obj.frames import encode_exact_obj
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs.clip import open_clip_and_choose_rest, open_clip_of
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.inputs.source import holds_caged_model, load_source
from cageik_cli.inputs.weights import check_cage_output
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import reconstruct
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.views.cage import CageResult
from cageik_cli.run.settings import CageSettings, RepairCageSettings
from cageik_cli.util.arrays import Floats, spread_evenly
from cageik_cli.util.calls import check_call
from cageik_cli.util.errors import (
    CageError,
    CageikError,
    ConnectivityError,
    InputError,
    error_context,
)
from cageik_cli.util.messages import join_texts
from cageik_cli.util.outputs import write_bytes
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import count_processors, limit_blas_threads


def build_cage_file(settings: CageSettings, progress: ProgressListener | None = None) -> CageResult:
    """Build a cage around a model and write it."""
    return _CageBuild(settings, progress or ProgressListener()).run()


class _CageBuild:
    """A cage around a model, from the files to the file."""

    def __init__(self, settings: CageSettings, progress: ProgressListener) -> None:
        self._settings, self._progress = settings, progress
        is_shared = bool(settings.animation) and settings.rest is not None
        self._scene = CommonScene(given_in=settings.given_in, is_shared=is_shared)

    def run(self) -> CageResult:
        """Open the model and its animation, build the cage, and write it."""
        settings, progress = self._settings, self._progress
        check_cage_output(settings.output, settings.overwrite)
        with progress.stage("open"):
            self._model, rest_frame = self._open_model()
            clip = self._read_animation()
        with progress.stage("cage"), error_context(self._model.source["name"]):
            built = cage_builder.build_cage(
                self._model.mesh,
                settings.build,
                clip,
                progress.update,
                settings.jobs,
                note=partial(progress.note, "note"),
            )
        with progress.stage("write"):
            polygons = built.cage.polygons
            rings = np.split(polygons.corners, polygons.starts[1:])
            data = encode_exact_obj(built.cage.vertices, rings)
            write_bytes(settings.output, data, settings.overwrite)
        source = describe_source(Path(settings.output.name), data)
        return CageResult(settings.output, source, self._model, settings.build, built, rest_frame)

    def _open_model(self) -> tuple[LoadedMesh, float | None]:
        """Read the model: a mesh, or the rest pose of a clip and its number."""
        settings, source = self._settings, Source.parse(self._settings.model)
        is_whole = settings.rest is None and settings.rest_frame is None and source.file.is_file()
        if is_whole and (source.is_mesh_file or holds_caged_model(source.file)):
            exclude = settings.clip.exclude
            model = load_source(Path(settings.model), exclude=exclude)
            self._scene.state(model.scene)
            return model, None
        clip, rest, index = open_clip_and_choose_rest(
            (settings.model,), settings.clip, settings.rest, settings.rest_frame or 0, self._scene
        )
        if index is None:
            return rest, None
        _check_is_clip(clip, index)
        return rest, clip.scene.override(Scene()).frame_number(index)

    def _read_animation(self) -> Clip | None:
        """Read some frames of the animation, if there is one, whose order the model follows."""
        settings = self._settings
        if not settings.animation:
            return None
        clip, self._model = open_clip_of(
            self._model,
            settings.animation,
            settings.clip,
            self._scene,
            self._progress,
            called="the model",
            follows=False,
        )
        held = [k for k in range(len(clip)) if k not in clip.missing]
        return make_measured_clip(
            self._model.mesh, len(held), lambda k: clip.read_frame(held[k]), settings.jobs
        )


def _check_is_clip(clip: MeshSequence, index: int) -> None:
    """Refuse files whose last has other faces: which of the models is meant is not known."""
    try:
        clip.read_positions(len(clip) - 1)
    except ConnectivityError as error:
        raise ConnectivityError(
            error.text + f"; name the one mesh that the cage is for, such as {clip.location(index)}"
        ) from error
    except InputError:
        pass  # a damaged frame, which the cage does not need


@check_call
def build_cage(
    mesh: TriMesh,
    *,
    vertices: int = BuildSettings().vertices,
    clearance: float = BuildSettings().clearance,
    symmetric: SymmetryChoice = DEFAULT_SYMMETRY,
    quads: bool = BuildSettings().quads,
    loops: bool = BuildSettings().loops,
    frames: MeshSequence | ArrayLike | None = None,
    jobs: int | None = None,
) -> BuiltCage:
    """Build a cage around a mesh, as `cageik cage` does.

    The same input gives the same cage. It takes some 5 seconds, and with `frames` half a minute.

    Parameters
    ----------
    mesh : TriMesh
        The model at rest. It may be open, have several parts or cross itself.
    vertices : int
        Vertices of the cage, at most; it has at least 0.9 times as many.
    clearance : float
        Smallest distance between the cage and the surface, in diagonals of the mesh.
    symmetric : {"auto", "x", "y", "z", "off"}
        Build a cage that is its own mirror image: about the plane of a mesh that is one within
        0.5 % of its diagonal (`auto`), or about the plane across an axis; or any cage.
    quads : bool
        Whether most triangles become quads, as the attributes of the cage tell.
    loops : bool
        Whether loops of four to six vertices go around limbs, more where they bend.
    frames : MeshSequence, or (F, m, 3) array, optional
        An animation of the mesh, in its units: the cage with the smallest error on it is chosen.
    jobs : int, optional
        Threads; as many as there are processors by default.

    Raises
    ------
    CageikError
        When the mesh is one point, a setting is impossible, or the frames have other vertices.

    Examples
    --------
    >>> from cageik_cli import bind, build_cage, load_mesh
    >>> rest = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> built = build_cage(rest, vertices=40)
    >>> built.cage
    <TriMesh: 40 vertices, 76 triangles>
    >>> built.notes
    ()
    >>> bind(rest, built.cage, accuracy="preview")
    <Binding: 1570 vertices in a cage of 40, harmonic, preview>
    """
    clip, jobs = None, jobs or count_processors()
    if frames is not None:
        sequence = as_sequence(frames, mesh)
        clip = make_measured_clip(mesh, len(sequence), sequence.read_frame, jobs)
    settings = BuildSettings(
        vertices=vertices, clearance=clearance, symmetric=symmetric, quads=quads, loops=loops
    )
    return cage_builder.build_cage(mesh, settings, clip)


def make_measured_clip(
    rest: TriMesh, frame_count: int, read_frame: Callable[[int], Floats], jobs: int
) -> Clip:
    """Read evenly spaced frames of an animation, for which a cage is to be built.

    Parameters
    ----------
    read_frame : callable
        Returns the positions (m, 3) of a frame, by its number.
    """
    chosen = spread_evenly(frame_count, 32)
    poses = np.stack([read_frame(int(k)) for k in chosen])

    def measure(cage: TriMesh) -> float:
        """Return the rms distance, in percent of the diagonal; infinite for a poor cage."""
        try:
            binding = bind(rest, cage, BindSettings(accuracy="preview"), jobs)
        except CageikError:
            return float("inf")
        with limit_blas_threads(1):
            cages = DualLaplacianSolver(binding, SolveSettings()).solve(poses).cages
        squares = ((reconstruct(binding.weights, cages) - poses) ** 2).sum(axis=2)
        return float(100 * np.sqrt(squares.mean()) / rest.diagonal)

    return Clip(poses, measure)


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
    return _CageRepair(settings, progress or ProgressListener()).run()


class _CageRepair:
    """A cage that is made fit for a model, from file to file."""

    def __init__(self, settings: RepairCageSettings, progress: ProgressListener) -> None:
        self._settings, self._progress = settings, progress

    def run(self) -> tuple[RepairedCage, float]:
        """Open the model and its cage, repair that, and write it."""
        settings, progress = self._settings, self._progress
        check_cage_output(settings.output, settings.overwrite)
        with progress.stage("open"):
            scene = CommonScene(given_in=settings.given_in)
            model, cage = scene.open_rest(settings.model), scene.open_cage(settings.cage)
        with progress.stage("repair"), error_context(settings.cage):
            repaired = self._repair(cage.mesh, model.mesh)
        with progress.stage("write"):
            text = encode_exact_obj(repaired.mesh.vertices, repaired.mesh.rings)
            write_bytes(settings.output, text, settings.overwrite)
        return repaired, model.mesh.diagonal

    def _repair(self, cage: TriMesh, model: TriMesh) -> RepairedCage:
        """Repair the cage; refuse one that is still not fit."""
        counts = None if cage.attributes is None else cage.attributes.corner_counts
        repaired = repair_cage(cage.fan_triangulated, model, counts, self._progress.update)
        if not repaired.is_fit:
            left = join_texts("; ", (finding.sentence for finding in repaired.faults))
            raise CageError("cannot be repaired, what is left: " + left)
        return repaired
