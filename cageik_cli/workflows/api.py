"""The functions of the Python API: load, check, bind, extract. `cageik_cli` offers them."""

from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass, fields
from os import PathLike, fspath
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.cages import bind as cage_binding
from cageik_cli.cages.diagnosis import Diagnosis, diagnose
from cageik_cli.coordinates.binding import Binding, reconstruct
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.formats import mesh_file
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.base.settings import ClipSettings
from cageik_cli.formats.open import open_clip_and_rest
from cageik_cli.geometry.mesh import TriMesh, validate_positions
from cageik_cli.solver.blocks import MemoryPlan
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver, normalize_weights
from cageik_cli.solver.metrics import FrameMetrics, check_finite, measure
from cageik_cli.solver.settings import SolveSettings
from cageik_cli.store import result as result_file
from cageik_cli.store.result import Result
from cageik_cli.util.arrays import Floats, Workspace
from cageik_cli.util.errors import ConnectivityError
from cageik_cli.util.threads import count_processors, limit_blas_threads
from cageik_cli.workflows.extract import extract as run_extraction
from cageik_cli.workflows.plan import ExtractSettings

FilePath = str | PathLike[str]
Progress = Callable[[int, int], None]


def load_mesh(path: FilePath) -> TriMesh:
    """Read one mesh (.obj, .ply, .off, each also .gz); polygons become triangles.

    Parameters
    ----------
    path : str or path-like

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
    return mesh_file.load_mesh(Path(path)).mesh


def load_clip(
    frames: FilePath | list[FilePath],
    *,
    rest: FilePath | None = None,
    selection: slice | None = None,
    allow_gaps: bool = False,
) -> MeshSequence:
    """Open an animation whose meshes share one connectivity.

    Frames are read when they are asked for: only the first one is held in memory.

    Parameters
    ----------
    frames : path, or list of paths
        A folder, a glob, files in any order, or one file that contains a clip; `FILE::CLIP` names
        one of several clips in a file.
    rest : path, optional
        A mesh with the faces, for files that have none (.mdd, .pc2).
    selection : slice, optional
        The frames to take, `slice(0, 48, 2)`; all by default.
    allow_gaps : bool
        Accept missing numbers in a series of files.

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
    settings = ClipSettings(selection or slice(None), allow_gaps=allow_gaps)
    rest_path = Path(rest) if rest is not None else None
    clip, _ = open_clip_and_rest(_list_names(frames), settings, rest_path, 0)
    return clip


def _list_names(frames: FilePath | list[FilePath]) -> tuple[str, ...]:
    paths = frames if isinstance(frames, list) else [frames]
    return tuple(fspath(path) for path in paths)


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
    coordinates : {"harmonic", "mean-value"}
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
    return cage_binding.bind(rest, cage, BindSettings(coordinates, accuracy, outside), jobs)


@dataclass(frozen=True, slots=True, eq=False)
class CageAnimation:
    """The cages of a clip, and how well they reproduce it.

    Attributes
    ----------
    binding : Binding
    cages : (F, n, 3) float64
        The cage of each frame.
    metrics : FrameMetrics
        `rms`, `max_deviation`, `worst_vertex` and volumes of each frame, arrays (F,), in the units
        of the clip.

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

    def __len__(self) -> int:
        return len(self.cages)

    def __repr__(self) -> str:
        return (
            f"<CageAnimation: {len(self)} cages of {self.cages.shape[1]} vertices, "
            f"rms {self.rms_percent:.4f} % of the diagonal>"
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
        return np.asarray(reconstruct(self.binding.weights, self.cages[frame][None])[0])


def extract(
    clip: MeshSequence | ArrayLike,
    binding: Binding,
    *,
    alpha: float = SolveSettings().alpha,
    beta: float = SolveSettings().beta,
    align: bool = True,
    vertex_weights: ArrayLike | None = None,
    memory: int = 1 << 30,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> CageAnimation:
    """Extract the cage of every frame into arrays.

    The weights, all cages (24 n bytes per frame) and the figures are held in memory. The frames of
    a clip are not: they are read in blocks. To write a result file, which `cageik report` and the
    other commands read, use `extract_to_file`.

    Parameters
    ----------
    clip : MeshSequence, or (F, m, 3) array
        Frames with the vertices of `binding.rest`, in the same order.
    binding : Binding
    alpha, beta : float
        Weights of the cage's Laplacian (higher is smoother) and of the vertices.
    align : bool
        Align each frame rigidly with the rest pose before the solve.
    vertex_weights : (m,), optional
        Weights of the vertices; 0 marks missing data.
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
    jobs, count = jobs or count_processors(), len(binding.rest.vertices)
    weights = None
    if vertex_weights is not None:
        weights = normalize_weights(np.asarray(vertex_weights, np.float64), count)
    plan = MemoryPlan.fit(memory, binding, jobs)
    cages: list[Floats] = []
    metrics: list[FrameMetrics] = []
    done, workspace = 0, Workspace()
    frames = _Frames(clip, count)
    with limit_blas_threads(1), closing(frames.blocks(plan.block_size, jobs)) as blocks:
        solver = DualLaplacianSolver(binding, SolveSettings(alpha, beta, align), weights)
        for block in blocks:
            solution = solver.solve(block, workspace)
            rebuilt, counted = solution.reconstructions, solver.data_vertices
            measured = measure(binding.rest, block, rebuilt, counted, workspace).metrics
            check_finite(done, solution.cages, measured)
            cages.append(solution.cages)
            metrics.append(measured)
            done += len(block)
            if progress is not None:
                progress(done, len(frames))
    columns = {
        field.name: np.concatenate([getattr(part, field.name) for part in metrics])
        for field in fields(FrameMetrics)
    }
    return CageAnimation(binding, np.concatenate(cages), FrameMetrics(**columns))


class _Frames:
    """The frames of a clip or of an array, in blocks of positions (k, m, 3)."""

    def __init__(self, clip: MeshSequence | ArrayLike, count: int) -> None:
        if isinstance(clip, MeshSequence):
            self._clip: MeshSequence | Floats = clip
            found = clip.first.vertices.shape
        else:
            self._clip = np.asarray(clip, np.float64)
            found = self._clip.shape[1:]
        if found != (count, 3) or not len(self._clip):
            raise ConnectivityError(
                f"frames have shape {('F', *found)}, expected (F, {count}, 3) as the binding has "
                f"{count} vertices; bind the rest pose of this clip"
            )

    def __len__(self) -> int:
        return len(self._clip)

    def blocks(self, size: int, jobs: int) -> Generator[Floats]:
        """Return the positions of all frames, at most `size` in a block."""
        clip = self._clip
        if isinstance(clip, MeshSequence):
            with closing(clip.blocks(size, jobs)) as blocks:
                for block in blocks:
                    block.raise_read_errors()
                    yield block.positions
            return
        for start in range(0, len(clip), size):
            yield np.stack([validate_positions(frame) for frame in clip[start : start + size]])


def extract_to_file(
    frames: FilePath | list[FilePath],
    cage: FilePath,
    output: FilePath,
    *,
    rest: FilePath | None = None,
    coordinates: str = "harmonic",
    accuracy: str = "standard",
    outside: str = "refuse",
    alpha: float = SolveSettings().alpha,
    beta: float = SolveSettings().beta,
    align: bool = True,
    overwrite: bool = False,
    jobs: int | None = None,
) -> Result:
    """Extract the cage of every frame into a result file, as `cageik extract` does.

    The file has the same bytes as that of the command. Frames and cages are read and written in
    blocks, so that memory does not grow with the length of the clip.

    Parameters
    ----------
    frames : path, or list of paths
        As of `load_clip`.
    cage, output : path
        The cage's mesh, and the result file (.h5).
    rest : path, optional
        The rest pose; the first frame by default.
    coordinates, accuracy, outside : str
        As of `bind`.
    alpha, beta, align
        As of `extract`.
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
    settings = ExtractSettings(
        frames=_list_names(frames),
        cage=Path(cage),
        output=Path(output),
        rest=Path(rest) if rest is not None else None,
        bind=BindSettings(coordinates, accuracy, outside),
        solve=SolveSettings(alpha, beta, align),
        overwrite=overwrite,
        jobs=jobs or count_processors(),
    )
    return run_extraction(settings)


def read_result(path: FilePath) -> Result:
    """Read a result file: its meshes, figures and settings.

    The rest pose, its cage and the figures are held in memory; the cages are not, `read_cages`
    reads them.

    Raises
    ------
    CageikError
        When it is not a complete, sound result.

    Examples
    --------
    >>> from cageik_cli import extract_to_file, read_result
    >>> walker = "data_fixtures/walker"
    >>> _ = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> result = read_result("walker.h5")
    >>> result.frames[0], result.metrics.rms.shape
    ('walker_1.obj', (48,))
    """
    return result_file.read_result(Path(path))


def read_cages(result: Result) -> Floats:
    """Read all cages of a result, (F, n, 3); the cages of skipped frames are interpolated.

    Examples
    --------
    >>> from cageik_cli import extract_to_file, read_cages
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> read_cages(result).shape
    (48, 80, 3)
    """
    return np.concatenate(list(result_file.read_cages(result, 64)))
