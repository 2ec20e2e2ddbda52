"""Extract the cages of a clip into arrays, without files."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.cages.bind import bind
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.base.sequence import MeshSequence, as_sequence
from cageik_cli.inputs.rest_pose import VertexWeights
from cageik_cli.method.solve.metrics import METRIC_TYPES, FrameMetrics
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.solve.vertex_weights import make_vertex_weights
from cageik_cli.method.weights.binding import Binding, reconstruct_frames
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.util.arrays import DEFAULT_MEMORY, Floats
from cageik_cli.util.errors import SettingError
from cageik_cli.util.threads import count_processors, limit_blas_threads
from cageik_cli.workflows.extract import Extraction
from cageik_cli.workflows.fit import choose_fit, fit_weights
from cageik_cli.workflows.settings import ExtractSettings

ReportProgress = Callable[[int, int], None]


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
        cages, rotations = self.cages[[frame]], self.rotations[[frame]]
        return np.asarray(reconstruct_frames(self.binding, cages, rotations)[0])


def extract(
    clip: MeshSequence | ArrayLike,
    binding: Binding | None = None,
    *,
    cage_vertices: int | None = None,
    alpha: float = SolveSettings().alpha,
    beta: float = SolveSettings().beta,
    align: bool = True,
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
        (),
        None,
        Path(),
        solve=SolveSettings(alpha, beta, align),
        build=_make_build_settings(binding, cage_vertices),
        fit=False if fit is None and binding is not None else fit,
        memory=memory,
        jobs=jobs or count_processors(),
    )
    if binding is None:
        binding = _bind_built_cage(clip, settings)
    sequence = as_sequence(clip, binding.rest)
    chosen, notes = choose_fit(settings, sequence)
    binding = replace(binding, notes=binding.notes + notes)
    if chosen is not None:
        binding = fit_weights(
            binding,
            [sequence],
            chosen,
            solve=settings.solve,
            vertex_weights=vertex_weights,
            memory=memory,
            jobs=settings.jobs,
        ).binding
    extraction = Extraction(settings, stored=StoredBinding(binding, {}))
    extraction.sequence = sequence
    extraction.vertex_weights = VertexWeights(make_vertex_weights(vertex_weights, binding.rest))
    extraction.factor()
    cages: list[Floats] = []
    rotations: list[Floats] = []
    metrics: list[FrameMetrics] = []
    with limit_blas_threads(1), extraction.open_blocks(0) as blocks:
        for block in blocks:
            cages.append(block.cages)
            rotations.append(block.rotations)
            metrics.append(block.metrics)
            if progress is not None:
                progress(block.stop, len(sequence))
    return CageAnimation(
        binding, np.concatenate(cages), _join_metrics(metrics), np.concatenate(rotations)
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
    from cageik_cli.workflows.cage import build_cage

    built = build_cage(clip.first, **asdict(settings.build))
    bound = bind(clip.first, built.cage, jobs=settings.jobs)
    return replace(bound, notes=built.notes + bound.notes)


def _join_metrics(parts: Sequence[FrameMetrics]) -> FrameMetrics:
    """Return the metrics of consecutive blocks as those of all their frames."""
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in METRIC_TYPES
    }
    return FrameMetrics(**columns)
