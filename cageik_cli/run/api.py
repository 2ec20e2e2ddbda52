"""The functions of the Python API, which `cageik_cli` offers: load, check, bind, extract.

`extract` solves the cages of a clip into arrays, without files; `extract_to_file` writes a result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.cages import bind as cage_binding
from cageik_cli.cages.check.diagnosis import Diagnosis, diagnose
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.fit.settings import FitRecord, FitSettings
from cageik_cli.formats.base.sequence import MeshSequence, as_sequence
from cageik_cli.formats.open import open_clip_and_rest
from cageik_cli.formats.settings import ClipSettings, RestFrame, SceneHints
from cageik_cli.formats.timeline import parse_frames
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs.clip import VertexWeights
from cageik_cli.inputs.source import load_rest, load_source
from cageik_cli.method.solve.metrics import METRIC_TYPES, FrameMetrics
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.solve.vertex_weights import make_vertex_weights
from cageik_cli.method.weights.binding import Binding, Poses, reconstruct_frames
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.figures import format_percent
from cageik_cli.run import extraction as file_extraction
from cageik_cli.run.extraction import Extraction
from cageik_cli.run.fit import choose_fit, choose_norm, fit_weights
from cageik_cli.run.keywords import read_jobs
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.store import result as result_file
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.result import Edit, Result
from cageik_cli.util.arrays import Floats
from cageik_cli.util.calls import FilePath, ReportProgress, check_call
from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import Hint, Note
from cageik_cli.util.settings import DEFAULT_MEMORY
from cageik_cli.util.threads import limit_blas_threads


@check_call
def load_mesh(path: FilePath) -> TriMesh:
    """Read one mesh of any format that holds one; polygons become triangles.

    Of a clip it is the first frame, of a result or a binding the rest pose. `FILE::PATH` names one
    of several meshes in a file, and `FILE::cage` the cage of a result. `attributes` of the mesh
    keeps the polygons, texture coordinates, materials and parts.

    Raises
    ------
    CageikError
        When the file cannot be read, or is not such a mesh.

    Examples
    --------
    >>> from cageik_cli import load_mesh
    >>> load_mesh("data_fixtures/walker/cage.obj")
    <TriMesh: 80 vertices, 156 triangles>
    """
    return load_source(Path(path)).mesh


@check_call
def load_clip(
    frames: FilePath | Sequence[FilePath],
    *,
    rest: FilePath | None = None,
    selection: slice | str | None = None,
    close_gaps: bool = False,
    exclude: Sequence[str] = (),
    fps: float | None = None,
) -> MeshSequence:
    """Open an animation whose meshes share one connectivity.

    Frames are read when they are asked for: only the first one is held in memory.

    Parameters
    ----------
    frames : path, or sequence of paths
        A folder, a glob, files in any order, or one file that contains a clip; `FILE::CLIP` names
        one of several clips in a file.
    rest : path, optional
        A mesh with the faces, for files that have none (.mdd, .pc2).
    selection : slice or str, optional
        The frames to take: by number, `"1020-1060"` or `"1020-1060x2"`, as on the command line, or
        by index, `slice(0, 48, 2)`; all by default.
    close_gaps : bool
        Accept missing numbers in a series of files. The clip has the frames that exist, one after
        another; `clip.scene` has the number of the first.
    exclude : sequence of str
        Patterns of the parts that are left out: of their paths, or of names in these.
    fps : float, optional
        Frames per second at which glTF, and keys of Alembic, are sampled; 24 by default.

    Raises
    ------
    CageikError
        When there are no frames, the first cannot be read, or `rest` has other faces.

    Examples
    --------
    >>> from cageik_cli import load_clip
    >>> clip = load_clip("data_fixtures/walker/frames")
    >>> clip
    <MeshSequence: 48 frames of 1570 vertices, walker_1.obj to walker_48.obj>
    >>> clip.first
    <TriMesh: 1570 vertices, 3136 triangles>
    >>> clip.read_frame(47).shape
    (1570, 3)
    """
    wanted = slice(None) if selection is None else selection
    settings = ClipSettings(
        parse_frames(wanted) if isinstance(wanted, str) else wanted,
        gaps="close" if close_gaps else "refuse",
        exclude=tuple(exclude),
        fps=fps,
    )
    loaded = None if rest is None else load_rest(Path(rest), settings.exclude)
    clip, _ = open_clip_and_rest(_list_names(frames), settings, loaded, 0)
    return clip


@check_call
def check_cage(cage: TriMesh, model: TriMesh | None = None) -> Diagnosis:
    """Diagnose a cage, and a model in it if there is one.

    Examples
    --------
    >>> from cageik_cli import check_cage, load_mesh
    >>> cage = load_mesh("data_fixtures/walker/cage.obj")
    >>> diagnosis = check_cage(cage, load_mesh("data_fixtures/walker/frames/walker_1.obj"))
    >>> diagnosis.is_fit
    True
    >>> diagnosis.rest.outside
    0
    """
    return diagnose(cage, model)


@check_call
def bind(
    rest: TriMesh,
    cage: TriMesh,
    *,
    coordinates: str = "harmonic",
    accuracy: str = "standard",
    outside: str = "refuse",
    jobs: int | None = None,
) -> Binding:
    """Compute the weights that tie a model to its cage.

    The weights take 8 m n bytes, for m vertices in a cage of n.

    Parameters
    ----------
    rest : TriMesh
        The model at rest.
    cage : TriMesh
        A closed mesh around it.
    coordinates : str
        The kind of weights, one of `COORDINATES` in `method/weights/settings.py`.
    accuracy : {"preview", "standard", "fine"}
        Tolerance of harmonic weights: 0.03, 0.005 or 0.001 in the mean L1 error of a row.
    outside : {"refuse", "project"}
        Refuse vertices outside the cage, or give them the weights of the nearest point on it.
    jobs : int, optional
        Threads; as many as there are processors by default.

    Raises
    ------
    CageikError
        When the cage is not fit for the model, or the weights do not reproduce it.

    Examples
    --------
    >>> from cageik_cli import bind, load_mesh
    >>> rest = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> binding = bind(rest, load_mesh("data_fixtures/walker/cage.obj"), accuracy="preview")
    >>> binding
    <Binding: 1570 vertices in a cage of 80, harmonic, preview>
    >>> binding.weights.shape
    (1570, 80)
    >>> bool(abs(binding.weights @ binding.cage.vertices - rest.vertices).max() < 1e-9)
    True
    """
    threads = None if jobs is None else read_jobs(jobs)
    return cage_binding.bind(rest, cage, BindSettings(coordinates, accuracy, outside), threads)


@check_call
def extract_to_file(
    frames: FilePath | Sequence[FilePath],
    cage: FilePath | None,
    output: FilePath,
    *,
    cage_vertices: int | None = None,
    rest: FilePath | None = None,
    rest_frame: RestFrame = 0,
    coordinates: str = "harmonic",
    accuracy: str = "standard",
    outside: str = "refuse",
    alpha: float = SolveSettings().alpha,
    beta: float = SolveSettings().beta,
    align: bool = True,
    norm: float | None = None,
    fit: FitSettings | bool | None = None,
    given_in: str | None = None,
    exclude: Sequence[str] = (),
    overwrite: bool = False,
    jobs: int | None = None,
) -> Result:
    """Extract the cage of every frame into a result file, as `cageik extract` does.

    The file has the same bytes as that of the command. Frames and cages are read and written in
    blocks, so that memory does not grow with the length of the clip.

    Parameters
    ----------
    frames : path, or sequence of paths
        As of `load_clip`.
    cage : path or None
        The cage's mesh. If it is None, a cage is built around the rest pose; it is in the result.
    output : path
        The result file (.h5).
    cage_vertices : int, optional
        Vertices of the cage that is built, at most; 100 by default.
    rest : path, optional
        The rest pose; a frame of the clip by default.
    rest_frame : int or str
        Which frame then: its index from 0, or as text its number, `"1020"`; `"auto"` is the frame
        in which the fewest parts touch.
    coordinates, accuracy, outside : str
        As of `bind`.
    alpha, beta, align, norm, fit
        As of `extract`.
    given_in : str, optional
        Unit and up axis of `cage` and `rest`, such as `cm` or `m,z`, if not what their files say;
        of both, of the one whose file says nothing.
    exclude : sequence of str
        As of `load_clip`.
    overwrite : bool
        Replace an existing result.
    jobs : int, optional
        Threads; as many as there are processors by default.

    Raises
    ------
    CageikError
        When an input is refused, the solve fails, or the file cannot be written.

    Examples
    --------
    >>> from cageik_cli import extract_to_file
    >>> walker = "data_fixtures/walker"
    >>> extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    <Result: walker.h5, 48 frames of 1570 vertices in a cage of 80>
    """
    if cage is not None and cage_vertices is not None:
        raise SettingError(
            f"cage_vertices is {cage_vertices}, but a cage is given ({fspath(cage)}); leave out "
            "one of them"
        )
    settings = ExtractSettings(
        frames=_list_names(frames),
        cage=Path(cage) if cage is not None else None,
        build=BuildSettings() if cage_vertices is None else BuildSettings(cage_vertices),
        output=Path(output),
        rest=Path(rest) if rest is not None else None,
        rest_frame=rest_frame,
        bind=BindSettings(coordinates, accuracy, outside),
        solve=SolveSettings(alpha, beta, align, norm),
        fit=fit,
        given_in=SceneHints.parse(given_in) if given_in else SceneHints(),
        clip=ClipSettings(exclude=tuple(exclude)),
        overwrite=overwrite,
        jobs=read_jobs(jobs),
    )
    return file_extraction.extract(settings)


@check_call
def read_result(path: FilePath) -> Result | Edit:
    """Read a result of `extract`, or an edit by `cageik pose`: its meshes, figures and settings.

    The rest pose, its cage and the figures are held in memory; the cages are not, `read_cages`
    reads them.

    Raises
    ------
    CageikError
        When it is not a complete, sound result or edit.

    Examples
    --------
    >>> from cageik_cli import extract_to_file, read_result
    >>> walker = "data_fixtures/walker"
    >>> _ = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> result = read_result("walker.h5")
    >>> result.frames[0], result.metrics.rms.shape
    ('walker_1.obj', (48,))
    """
    return result_file.read_animation(Path(path))


@check_call
def read_cages(result: Result | Edit) -> Floats:
    """Read all cages of a result or an edit, (F, n, 3); those of skipped frames are interpolated.

    Examples
    --------
    >>> from cageik_cli import extract_to_file, read_cages
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> read_cages(result).shape
    (48, 80, 3)
    """
    return np.concatenate(list(result_file.read_cages(result, 64)))


@dataclass(frozen=True, slots=True, eq=False)
class CageAnimation:
    """The cages of a clip, and how well they reproduce it.

    Attributes
    ----------
    cages : (F, n, 3) float64
        The cage of each frame.
    metrics : FrameMetrics
        `rms`, `max_deviation`, `worst_vertex` and volumes of each frame, arrays (F,), in the units
        of the clip.
    rotations : (F, 3, 3) float64
        `points @ R` turns points of the rest pose to each frame.
    fit : FitRecord, optional
        How the weights were fitted to the clip, if that was done here.

    Examples
    --------
    >>> from cageik_cli import bind, extract, load_clip, load_mesh
    >>> clip = load_clip("data_fixtures/walker/frames", selection=slice(0, 4))
    >>> binding = bind(clip.first, load_mesh("data_fixtures/walker/cage.obj"), accuracy="preview")
    >>> animation = extract(clip, binding)
    >>> len(animation), animation.cages.shape
    (4, (4, 80, 3))
    >>> error = animation.reconstruct(3) - clip.read_frame(3)
    >>> bool(abs((error**2).sum(axis=1).mean() ** 0.5 - animation.rms[3]) < 1e-12)
    True
    """

    binding: Binding
    cages: Floats
    metrics: FrameMetrics
    rotations: Floats
    fit: FitRecord | None = None

    def __len__(self) -> int:
        return len(self.cages)

    def __repr__(self) -> str:
        return (
            f"<CageAnimation: {len(self)} cages of {self.cages.shape[1]} vertices, "
            f"rms {format_percent(self.rms_percent)} % of the diagonal>"
        )

    @property
    def rms(self) -> Floats:
        """RMS distance of the reconstruction from each frame, (F,), in the units of the clip."""
        return self.metrics.rms

    @property
    def rms_percent(self) -> float:
        """RMS distance over the clip, in percent of the diagonal of the rest pose."""
        return float(100 * np.sqrt(np.mean(self.rms**2)) / self.binding.rest.diagonal)

    @property
    def max_deviation(self) -> Floats:
        """Largest distance of a vertex in each frame, (F,), in the units of the clip."""
        return self.metrics.max_deviation

    def reconstruct(self, frame: int) -> Floats:
        """Return the mesh that the cage of a frame gives, (m, 3)."""
        chosen = [frame]
        poses = Poses(self.cages[chosen], self.rotations[chosen])
        return np.asarray(reconstruct_frames(self.binding, poses)[0])


@check_call
def extract(
    clip: MeshSequence | ArrayLike,
    binding: Binding | None = None,
    *,
    cage_vertices: int | None = None,
    alpha: float = SolveSettings().alpha,
    beta: float = SolveSettings().beta,
    align: bool = True,
    norm: float | None = None,
    vertex_weights: ArrayLike | Literal["area"] | None = None,
    fit: FitSettings | bool | None = None,
    memory: int = DEFAULT_MEMORY,
    jobs: int | None = None,
    progress: ReportProgress | None = None,
) -> CageAnimation:
    """Extract the cage of every frame into arrays.

    The weights, all cages (24 n bytes per frame) and the figures are held in memory. The frames of
    a clip are not: they are read in blocks. To write a result file, which `cageik report` and the
    other commands read, use `extract_to_file`.

    Parameters
    ----------
    clip : MeshSequence, or (F, m, 3) array
        Frames with the vertices of `binding.rest`, in the same order.
    binding : Binding, optional
        Without it, a cage is built around the first frame of the clip, and bound.
    cage_vertices : int, optional
        Vertices of the cage that is built, at most; 100 by default.
    alpha, beta : float
        Weights of the cage's Laplacian (higher is smoother) and of the vertices.
    align : bool
        Align each frame rigidly with the rest pose before the solve.
    norm : float, optional
        Power by which deviations far above the others of a frame count: 2 is least squares, a
        higher one, up to 8, lowers the largest deviation. It is 6 by default where weights are
        fitted to a clip without outliers, else 2.
    vertex_weights : (m,) or "area", optional
        Weights of the vertices; 0 marks missing data. Or each vertex counts by its area.
    fit : FitSettings or bool, optional
        Fit the weights to the clip first, or do not. By default they are fitted if a cage is built,
        and the clip has more than two frames; else the notes of the binding say why not.
        `fit_weights` also tells how well they follow frames that they were not fitted to.
    memory : int
        Limit in bytes for the weights and the frames in memory, not for the cages.
    jobs : int, optional
        Threads that read frames; as many as there are processors by default.
    progress : callable, optional
        Called with the number of frames done and the number of all frames.

    Raises
    ------
    CageikError
        When a frame cannot be read or does not fit the binding, or the solve fails.

    Examples
    --------
    >>> from cageik_cli import bind, extract, load_clip, load_mesh
    >>> clip = load_clip("data_fixtures/walker/frames")
    >>> cage = load_mesh("data_fixtures/walker/cage.obj")
    >>> animation = extract(clip, bind(clip.first, cage))
    >>> animation.cages.shape
    (48, 80, 3)
    >>> round(animation.rms_percent, 2)
    0.25

    Frames may be an array:

    >>> import numpy as np
    >>> frames = np.stack([clip.read_frame(0), clip.read_frame(1)])
    >>> extract(frames, animation.binding).cages.shape
    (2, 80, 3)
    """
    # No file is read or written.
    settings = ExtractSettings(
        frames=(),
        cage=None,
        output=Path(),
        solve=SolveSettings(alpha, beta, align, norm),
        build=_make_build_settings(binding, cage_vertices),
        fit=False if fit is None and binding is not None else fit,
        memory=memory,
        jobs=read_jobs(jobs),
    )
    if binding is None:
        binding = _bind_built_cage(clip, settings)
    sequence = as_sequence(clip, binding.rest)
    chosen, notes = choose_fit(settings, sequence)
    is_clean = True if settings.fit is None else None  # or it would not be fitted
    solve = choose_norm(settings.solve, chosen, [sequence], is_clean=is_clean)
    settings = replace(settings, fit=chosen or False, solve=solve)
    binding = replace(binding, notes=binding.notes + notes)
    stored = _fit(binding, sequence, settings, vertex_weights)
    extraction = Extraction(settings, stored=stored)
    extraction.sequence = sequence
    extraction.vertex_weights = VertexWeights(make_vertex_weights(vertex_weights, binding.rest))
    extraction.factor()
    return _solve(extraction, stored, progress)


def _fit(
    binding: Binding,
    clip: MeshSequence,
    settings: ExtractSettings,
    vertex_weights: ArrayLike | Literal["area"] | None,
) -> StoredBinding:
    """Return the weights to extract with: fitted to the clip, if the settings ask for that."""
    stored = StoredBinding(binding, {})
    if not isinstance(settings.fit, FitSettings):
        return stored
    fitted = fit_weights(
        binding,
        [clip],
        settings.fit,
        solve=settings.solve,
        vertex_weights=vertex_weights,
        memory=settings.memory,
        jobs=settings.jobs,
    )
    return stored.with_fit(fitted)


def _solve(
    extraction: Extraction, stored: StoredBinding, progress: ReportProgress | None
) -> CageAnimation:
    """Solve all frames, and keep what an animation holds of each block."""
    held: list[tuple[Floats, Floats, FrameMetrics]] = []
    with limit_blas_threads(1), extraction.open_blocks(0) as blocks:
        for block in blocks:
            held.append((block.cages, block.rotations, block.metrics))
            if progress is not None:
                progress(block.stop, len(extraction.sequence))
    cages, rotations, metrics = zip(*held, strict=True)
    return CageAnimation(
        stored.binding,
        np.concatenate(cages),
        _join_metrics(metrics),
        np.concatenate(rotations),
        stored.fit,
    )


def _make_build_settings(binding: Binding | None, cage_vertices: int | None) -> BuildSettings:
    """Return how a cage is built, if no binding brings one."""
    if binding is not None and cage_vertices is not None:
        raise SettingError(
            f"cage_vertices is {cage_vertices}, but a binding is given; leave out one of them"
        )
    return BuildSettings() if cage_vertices is None else BuildSettings(cage_vertices)


def _bind_built_cage(clip: MeshSequence | ArrayLike, settings: ExtractSettings) -> Binding:
    """Build a cage, and bind the first frame to it."""
    if not isinstance(clip, MeshSequence):
        raise SettingError("an array of frames has no faces to build a cage from; give a binding")
    from cageik_cli.run.cage import build_cage

    built = build_cage(clip.first, **asdict(settings.build))
    bound = cage_binding.bind(clip.first, built.cage, jobs=settings.jobs)
    return replace(bound, notes=(*map(Note, built.notes), *bound.notes))


def _join_metrics(parts: Sequence[FrameMetrics]) -> FrameMetrics:
    """Return the metrics of consecutive blocks as those of all their frames."""
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in METRIC_TYPES
    }
    return FrameMetrics(**columns)


def _list_names(frames: FilePath | Sequence[FilePath]) -> tuple[str, ...]:
    paths = [frames] if isinstance(frames, str | PathLike) else frames
    if not paths:
        raise SettingError(Hint("frames") + " is empty; name a folder, a glob or files")
    return tuple(fspath(path) for path in paths)
