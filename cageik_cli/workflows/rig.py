"""A mesh that follows an animation by skin weights: its own, or few that are fitted again."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from cageik_cli.coordinates.binding import (
    FRAMES_PER_PRODUCT,
    Binding,
    reconstruct,
    reconstruct_frames,
)
from cageik_cli.formats.base.skin import Skin, SkinWeights, compute_skin_weights
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.solver.fitting.fit import FitConditions, Fitter
from cageik_cli.solver.fitting.sample import SampleSettings
from cageik_cli.solver.settings import DEFAULT_REGULARIZATION, FitSettings, SolveSettings
from cageik_cli.store.result import Result
from cageik_cli.util.errors import FormatError, SettingError, error_context
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import limit_blas_threads
from cageik_cli.workflows.reconstruction import Block, Reconstruction

COMPARED_INFLUENCES = (4, 8, 16, 32)
"""Numbers of influences whose errors are listed."""

BLOCK_FRAMES = 4 * FRAMES_PER_PRODUCT
"""Frames that are posed together; constant, because the last digits depend on it."""

EXACT_PERCENT = 1e-6
"""Errors below this are rounding, in percent of the diagonal: single precision is coarser."""


@dataclass(frozen=True, slots=True)
class RigRequest:
    """Which weights a rig has, and what their fit may take.

    Attributes
    ----------
    influences : int or None
        Joints per vertex, at most, with weights that are fitted again; None keeps the weights of
        the reconstruction, which must not be negative.
    name : str
        What the note on the error is about.
    compares : bool
        Note the error of other numbers of influences, too.
    """

    influences: int | None
    name: str
    compares: bool = False
    sampling: SampleSettings = field(default_factory=SampleSettings)


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
class Rig:
    """A skin, the motion of its joints, and how far it is from the reconstruction.

    Attributes
    ----------
    blocks : callable
        Yields all frames in order: the places of the joints as cages, and the skinned meshes.
    """

    skin: Skin
    error: SkinError
    blocks: Callable[[], Iterator[Block]]

    @property
    def message(self) -> str:
        """A sentence for the user."""
        text = f"up to {self.skin.weights.joints.shape[1]} influences per vertex"
        if self.error.largest < EXACT_PERCENT:
            return f"{text}; the mesh moves as with the full weights"
        return (
            f"{text}; error against the full weights: rms {self.error.rms:.2g}, largest "
            f"{self.error.largest:.2g} % of the diagonal"
        )


def make_rig(
    result: Result, target: Reconstruction, request: RigRequest, progress: ProgressListener
) -> Rig:
    """Return a mesh that follows a reconstruction by skin weights, and note its error.

    Parameters
    ----------
    result : Result
        That the cages are of, or that they were made from.

    Raises
    ------
    InputError
        When the settings of the result are damaged.
    NumericalError
        When the system of the cages is singular.
    """
    with progress.stage("fit"), error_context(result.path), limit_blas_threads(1):
        conditions = FitConditions(_read_solve_settings(result), sampling=request.sampling)
        target = _settle_rest(target)
        rig = _fit_rig(target, request.influences, conditions)
        progress.note("note", f"{request.name}: {rig.message}")
        if request.compares:
            progress.note("influences", _compare_influences(target, conditions))
    return rig


def _compare_influences(target: Reconstruction, conditions: FitConditions) -> str:
    """List the error of several numbers of influences, as far as the cage has so many vertices."""
    texts = []
    for count in COMPARED_INFLUENCES:
        if count <= len(target.binding.cage.vertices):
            error = _fit_rig(target, count, conditions).error
            texts.append(f"{count}: {error.rms:.2g}, {error.largest:.2g} %")
    return f"rms and largest error: {'; '.join(texts)}"


def _fit_rig(target: Reconstruction, influences: int | None, conditions: FitConditions) -> Rig:
    """Return the rig with the weights of the target, or with few that are fitted again."""
    if influences is None or _has_few(target.binding, influences):
        return _keep_weights(target)
    with error_context("few influences, with the alpha and beta of the result"):
        return _refit_weights(target, influences, conditions)


def check_influences(result: Result, influences: int | None) -> None:
    """Refuse more influences than the cage of a result has vertices.

    Raises
    ------
    SettingError
    """
    n = len(result.cage.vertices)
    if influences is not None and influences > n:
        raise SettingError(
            f"{result.path}: --influences is {influences}, but the cage has {n} vertices; give "
            f"{n} or less"
        )


def _read_solve_settings(result: Result) -> SolveSettings:
    """Return how the cages of a result were solved; an edited one does not say it."""
    names = ("alpha", "beta")
    held = {name: result.settings[name] for name in names if name in result.settings}
    if not all(isinstance(value, int | float) for value in held.values()):
        raise FormatError(
            "attribute `settings` does not hold numbers alpha and beta; extract it again"
        )
    return SolveSettings(**held)


def _settle_rest(target: Reconstruction) -> Reconstruction:
    """Return a target whose rest pose is what its rest cage gives.

    That differs by more than rounding where vertices outside the cage were projected.
    """
    binding = target.binding
    if binding.has_offsets:
        return target
    vertices = reconstruct(binding.weights, binding.cage.vertices[None])[0]
    rest = binding.rest.move(vertices)
    return Reconstruction(replace(binding, rest=rest), target.cages)


def _has_few(binding: Binding, count: int) -> bool:
    """Return whether weights have at most `count` influences, and are made for that."""
    return binding.has_offsets and int((binding.weights > 0).sum(axis=1).max()) <= count


def _keep_weights(target: Reconstruction) -> Rig:
    """Return the rig with the weights and the cages of the target."""
    weights = compute_skin_weights(target.binding.weights)
    skinned = _bind_skin(target.binding, weights)

    def pose(block: Block) -> Block:
        meshes = reconstruct_frames(skinned, block.cages, block.rotations)
        return replace(block, meshes=meshes)

    return _measure_rig(target, weights, pose)


def _refit_weights(target: Reconstruction, count: int, conditions: FitConditions) -> Rig:
    """Return the rig with weights of `count` influences, and the cages of these weights."""
    fitter = Fitter(target.binding, FitSettings(influences=count), conditions)
    model = fitter.limit_influences(fitter.sample([target]), DEFAULT_REGULARIZATION, count)
    weights = compute_skin_weights(model.weights)
    solver = DualLaplacianSolver(_bind_skin(target.binding, weights), conditions.solve)

    def pose(block: Block) -> Block:
        solution = solver.solve(block.meshes)
        return Block(solution.cages, solution.rotations, solution.reconstructions)

    return _measure_rig(target, weights, pose)


def _bind_skin(binding: Binding, weights: SkinWeights) -> Binding:
    """Return a binding of skin weights, which need not reproduce the rest pose."""
    dense = weights.to_dense(len(binding.cage.vertices))
    return replace(binding, weights=dense, has_offsets=True)


def _measure_rig(
    target: Reconstruction, weights: SkinWeights, pose: Callable[[Block], Block]
) -> Rig:
    """Pose all frames, and measure how far they are from the target."""
    rotations, squares, largest = [], 0.0, 0.0
    for block in target.blocks(BLOCK_FRAMES):
        posed = pose(block)
        rotations.append(posed.rotations)
        distances = np.square(posed.meshes - block.meshes).sum(axis=2)
        squares += float(distances.sum())
        largest = max(largest, float(distances.max()))
    rest = target.binding.rest
    count = target.cages.count * len(rest.vertices)
    percent = 100 / rest.diagonal
    error = SkinError(percent * float(np.sqrt(squares / count)), percent * float(np.sqrt(largest)))
    skin = Skin(rest, weights, np.concatenate(rotations))
    return Rig(skin, error, lambda: map(pose, target.blocks(BLOCK_FRAMES)))
