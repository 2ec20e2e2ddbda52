"""The cages of a result as the joints of a skeleton: with its own weights, or with fewer."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.coordinates.binding import FRAMES_PER_PRODUCT, Binding, reconstruct_frames
from cageik_cli.formats.usd.skeleton import Skin, SkinWeights, compute_skin_weights
from cageik_cli.solver.alignment import best_rotations
from cageik_cli.solver.settings import FitSettings, SolveSettings
from cageik_cli.store.result import Result, read_cages
from cageik_cli.store.result_frames import read_binding, read_rotations
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, SettingError, error_context
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import limit_blas_threads

COMPARED_INFLUENCES = (4, 8, 16, 32)
"""Numbers of influences whose errors are listed."""

BLOCK_FRAMES = 4 * FRAMES_PER_PRODUCT
"""Frames that are reconstructed together; constant, because the last digits depend on it."""

EXACT_PERCENT = 1e-6
"""Errors below this are rounding, in percent of the diagonal: single precision is coarser."""


@dataclass(frozen=True, slots=True)
class RigRequest:
    """Which weights a skeleton has, and what their fit may take.

    Attributes
    ----------
    influences : int, optional
        Joints per vertex, at most; the weights of the result if absent.
    jobs : int
        Threads.
    memory : int
        Bytes for the weights and the frames that they are fitted to.
    """

    influences: int | None = None
    jobs: int = 1
    memory: int = 1 << 30


@dataclass(frozen=True, slots=True)
class SkinError:
    """Distances of a skinned mesh from the reconstruction, over all vertices and frames.

    Attributes
    ----------
    rms, largest : float
        In percent of the diagonal of the rest pose.
    """

    rms: float
    largest: float


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Consecutive frames: their cages (k, n, 3), rotations (k, 3, 3), and meshes (k, m, 3)."""

    cages: Floats
    rotations: Floats
    meshes: Floats


class Reconstruction:
    """The frames that a result gives; a source of frames for a fit, without those skipped.

    Parameters
    ----------
    result : Result
    binding : Binding
    """

    def __init__(self, result: Result, binding: Binding) -> None:
        self.result, self.binding = result, binding
        self._known = np.setdiff1d(np.arange(len(result.frames)), list(result.skipped))
        self._rotations = read_rotations(result) if binding.has_offsets else None

    def __len__(self) -> int:
        return len(self._known)

    def read_frame(self, index: int) -> Floats:
        """Return the mesh (m, 3) of a frame that was not skipped."""
        frame = int(self._known[index])
        cages = next(read_cages(self.result, 1, frame))
        return np.asarray(self._rebuild(frame, cages).meshes[0])

    def blocks(self) -> Iterator[Block]:
        """Yield all frames in order, those skipped with the cages that fill their gaps."""
        start = 0
        for cages in read_cages(self.result, BLOCK_FRAMES):
            yield self._rebuild(start, cages)
            start += len(cages)

    def _rebuild(self, start: int, cages: Floats) -> Block:
        """Return the meshes of the cages of frames from `start` on."""
        if self._rotations is None:
            rotations = _turn_with_cages(cages, self.binding.cage.vertices)
        else:
            rotations = self._rotations[start : start + len(cages)]
        return Block(cages, rotations, reconstruct_frames(self.binding, cages, rotations))


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """A skin, the motion of its joints, and how far it is from the reconstruction.

    Attributes
    ----------
    skin : Skin
    error : SkinError
    read_cages : callable
        Yields the places of the joints in blocks of frames, (k, n, 3).
    """

    skin: Skin
    error: SkinError
    read_cages: Callable[[], Iterator[Floats]]

    @property
    def message(self) -> str:
        """A sentence for the user."""
        text = f"up to {self.skin.weights.joints.shape[1]} influences per vertex"
        if self.error.largest < EXACT_PERCENT:
            return f"{text}, with the weights of the result"
        return (
            f"{text}; error against the full weights: rms {self.error.rms:.2g}, largest "
            f"{self.error.largest:.2g} % of the diagonal"
        )


def make_rig(result: Result, request: RigRequest, progress: ProgressListener) -> Rig:
    """Return the skeleton of a result, with weights that are fitted again if that is asked for.

    Raises
    ------
    InputError
        When the result has no weights, when they cannot be skin weights, or when the cage has
        fewer vertices than a vertex is to have influences.
    """
    target = _read_target(result, request)
    with progress.stage("fit"), error_context(result.path), limit_blas_threads(1):
        if request.influences is None or _has_few(target.binding, request.influences):
            return _keep_weights(target)
        return _refit_weights(target, request.influences, request)


def compare_influences(result: Result, request: RigRequest, progress: ProgressListener) -> None:
    """Note the error of several numbers of influences, as far as the cage has so many vertices."""
    texts = []
    for count in COMPARED_INFLUENCES:
        if count <= len(result.cage.vertices):
            error = make_rig(result, replace(request, influences=count), progress).error
            texts.append(f"{count}: {error.rms:.2g}, {error.largest:.2g} %")
    progress.note("influences", f"rms and largest error: {'; '.join(texts)}")


def _read_target(result: Result, request: RigRequest) -> Reconstruction:
    """Read what a skin is to follow; refuse what cannot be skinned."""
    count, n = request.influences, len(result.cage.vertices)
    if count is not None and count > n:
        raise SettingError(
            f"{result.path}: --influences is {count}, but the cage has {n} vertices; give {n} or "
            "less"
        )
    binding = read_binding(result)
    if binding is None:
        raise SettingError(
            f"{result.path}: has no weights, which a skeleton needs; extract it again without "
            "--no-weights"
        )
    if count is None and result.fit is not None and not binding.has_offsets:
        raise SettingError(
            f"{result.path}: its weights are fitted, and negative in places (down to "
            f"{binding.weights.min():.2g}), which skin weights cannot be; give --influences 8"
        )
    return Reconstruction(result, binding)


def _has_few(binding: Binding, count: int) -> bool:
    """Return whether weights have at most `count` influences, and are made for that."""
    return binding.has_offsets and int((binding.weights > 0).sum(axis=1).max()) <= count


def _keep_weights(target: Reconstruction) -> Rig:
    """Return the skeleton with the weights and the cages of the result."""
    weights = compute_skin_weights(target.binding.weights)
    skinned = _bind_skin(target.binding, weights)

    def pose(block: Block) -> Block:
        meshes = reconstruct_frames(skinned, block.cages, block.rotations)
        return replace(block, meshes=meshes)

    return _measure_rig(target, weights, pose)


def _refit_weights(target: Reconstruction, count: int, request: RigRequest) -> Rig:
    """Return the skeleton with weights of `count` influences, and the cages of these weights."""
    from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
    from cageik_cli.solver.fitting.fit import FitConditions, Fitter
    from cageik_cli.solver.fitting.sample import SampleSettings
    from cageik_cli.solver.settings import DEFAULT_REGULARIZATION

    solve = _read_solve_settings(target.result)
    conditions = FitConditions(solve, sampling=SampleSettings(request.memory, request.jobs))
    fitter = Fitter(target.binding, FitSettings(influences=count), conditions)
    model = fitter.limit_influences(fitter.sample([target]), DEFAULT_REGULARIZATION, count)
    weights = compute_skin_weights(model.weights)
    solver = DualLaplacianSolver(_bind_skin(target.binding, weights), solve)

    def pose(block: Block) -> Block:
        solution = solver.solve(block.meshes)
        return Block(solution.cages, solution.rotations, solution.reconstructions)

    return _measure_rig(target, weights, pose)


def _read_solve_settings(result: Result) -> SolveSettings:
    """Return how the cages of a result were solved; an edited one does not say it."""
    names = ("alpha", "beta")
    held = {name: result.settings[name] for name in names if name in result.settings}
    if not all(isinstance(value, int | float) for value in held.values()):
        raise FormatError(
            "attribute `settings` does not hold numbers alpha and beta; extract it again"
        )
    return SolveSettings(**held)


def _bind_skin(binding: Binding, weights: SkinWeights) -> Binding:
    """Return a binding of skin weights, which need not reproduce the rest pose."""
    dense = weights.to_dense(len(binding.cage.vertices))
    return replace(binding, weights=dense, has_offsets=True)


def _measure_rig(
    target: Reconstruction, weights: SkinWeights, pose: Callable[[Block], Block]
) -> Rig:
    """Pose all frames, and measure how far they are from the target."""
    rotations, squares, largest = [], 0.0, 0.0
    for block in target.blocks():
        posed = pose(block)
        rotations.append(posed.rotations)
        distances = np.square(posed.meshes - block.meshes).sum(axis=2)
        squares += float(distances.sum())
        largest = max(largest, float(distances.max()))
    rest = target.binding.rest
    count = len(target.result.frames) * len(rest.vertices)
    percent = 100 / rest.diagonal
    error = SkinError(percent * float(np.sqrt(squares / count)), percent * float(np.sqrt(largest)))
    skin = Skin(rest, weights, np.concatenate(rotations))
    return Rig(skin, error, lambda: (pose(block).cages for block in target.blocks()))


def _turn_with_cages(cages: Floats, rest: Floats) -> Floats:
    """Return the rotations (k, 3, 3) of a rest cage (n, 3) to cages (k, n, 3)."""
    centred = cages - cages.mean(axis=1, keepdims=True)
    return best_rotations(centred, rest - rest.mean(axis=0), np.ones(len(rest)))
