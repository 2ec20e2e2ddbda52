"""A mesh that follows an animation by skin weights: its own, or few that are fitted again."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, tee

import numpy as np

from cageik_cli.fit.fit import Fitter
from cageik_cli.fit.settings import DEFAULT_STRENGTH, FitSettings
from cageik_cli.formats.base.skeleton import (
    Skin,
    SkinWeights,
    compute_skin_weights,
    count_skin_bytes,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.seams import Seams
from cageik_cli.inputs.input_frames import InputFrames
from cageik_cli.inputs.reconstruction import Reconstruction
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import (
    FRAMES_PER_PRODUCT,
    Binding,
    reconstruct,
    reconstruct_frames,
)
from cageik_cli.rigs.joints import JointPoses, JointSolver, NormalAngles
from cageik_cli.rigs.merging import MIN_JOINTS, MIN_JOINTS_PER_LIMB
from cageik_cli.rigs.skinning import compare_roughness, group_joints, limit_influences
from cageik_cli.store.result import Result, StoredAnimation
from cageik_cli.util.arrays import Floats, spread_evenly
from cageik_cli.util.errors import FormatError, SettingError, error_context
from cageik_cli.util.messages import Hint
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.settings import DEFAULT_MEMORY
from cageik_cli.util.text import format_bytes, group_digits
from cageik_cli.util.threads import limit_blas_threads

Pose = Callable[[JointPoses], JointPoses]
"""Poses the joints of a skin for some frames of the reconstruction."""

FRAMES_PER_RIG_BLOCK = 4 * FRAMES_PER_PRODUCT
"""Frames that are posed together; constant, because the last digits depend on it."""

MAX_HELD_BYTES = 1 << 27
"""Joints that take more are posed again when they are written."""

DEFAULT_INFLUENCES = 4
"""Influences of fewer joints than the cage has vertices, if no number is given."""

MAX_PROBED_POSES = 100
"""Frames in which vertices that come apart are sought."""

COMPARED_INFLUENCES = (4, 8, 16, 32)
"""Numbers of influences whose errors are compared."""


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """A skin, the motion of its joints, and how far it is from what it follows.

    Attributes
    ----------
    skin : Skin
        Without the turns of its joints, which `blocks` has.
    cage : TriMesh
        Its vertices are the joints at rest.
    rms, largest : float
        Distances of the skinned mesh from the target, the reconstruction or the input, over all
        vertices and frames, in percent of the diagonal of the rest pose.
    angles : (float, float), optional
        Between the normals that the joints turn and those of the target, degrees: the root mean
        square over all vertices and frames, and the 99th percentile. None where no normals are
        written, no vertex has one, or the joints only translate.
    total : float, optional
        The largest that the rms distance from the input can be, in the same percent: that of the
        reconstruction and this one, added, or that of the input. None where it is not known.
    is_of_input : bool
        Whether the target is the input.
    blocks : callable
        Yields all frames in order, which are posed as they are taken.
    posed : tuple of JointPoses, optional
        Their joints without the meshes, if they take no more than `MAX_HELD_BYTES`.
    roughness : float, optional
        Of the weights over the surface, as a share of that of the largest ones before they were
        fitted again. None where they were not.
    """

    skin: Skin
    cage: TriMesh
    rms: float
    largest: float
    blocks: Callable[[], Iterator[JointPoses]]
    angles: tuple[float, float] | None = None
    total: float | None = None
    is_of_input: bool = False
    posed: tuple[JointPoses, ...] | None = None
    roughness: float | None = None

    def stream(self, turns: bool) -> tuple[Skin, Iterator[Floats]]:
        """Return the skin, and the places of its joints, (k, n, 3), in blocks of all frames.

        With `turns` it has those of its joints: of the frames whose places are taken.
        """
        skin = replace(self.skin, error=self.total)
        if not turns:
            return skin, (block.cages for block in self.posed or self.blocks())
        blocks, others = tee(self.posed or self.blocks())
        every = (block.turns for block in others if block.turns is not None)
        skin = replace(skin, turns=chain.from_iterable(every))
        return skin, (block.cages for block in blocks)

    @property
    def figures(self) -> str:
        """The errors, in a few characters."""
        return f"{self.rms:.2g}, {self.largest:.2g} %"

    @property
    def line(self) -> str:
        """What it costs, for a comparison: errors, normals, and bytes of what is written."""
        joints, weights = len(self.cage.vertices), self.skin.weights.joints.shape[1]
        size = count_skin_bytes(self.skin, joints)
        normals = "" if self.angles is None else f", normals {self.angles[0]:.2g} degrees off"
        return (
            f"{joints} joints, {weights} influences: {self.rms:.2g} %, largest "
            f"{self.largest:.2g} %{normals}, about {format_bytes(size)}"
        )

    @property
    def message(self) -> str:
        """A sentence for the user."""
        clauses = [f"up to {self.skin.weights.joints.shape[1]} influences per vertex"]
        if self.skin.cage_joints is not None:
            clauses[0] = f"{len(self.cage.vertices)} joints, {clauses[0]}"
        added = f"it adds an rms of {self.rms:.2g} %, largest {self.largest:.2g} %"
        if self.is_of_input:
            stated = f"an rms of {self.rms:.2g} %, largest {self.largest:.2g} % of the diagonal"
            clauses.append(f"against the input, {stated}")
        elif self.largest < 1e-6:  # rounding: single precision is coarser
            clauses.append("the mesh moves as with the full weights")
        elif self.total is None:
            clauses.append(f"{added} of the diagonal, against the full weights")
        else:
            clauses += [added, f"against the input, the rms is at most {self.total:.2g} %"]
        if self.angles is not None:
            shaded = "normals are {:.2g} degrees off (rms), 1 % of them more than {:.2g}"
            clauses.append(shaded.format(*(round(angle, 2) for angle in self.angles)))
        return "; ".join(clauses)


def make_rig(
    result: StoredAnimation,
    target: Reconstruction,
    progress: ProgressListener,
    *,
    influences: int | None,
    name: str,
    joints: str | int = "turn",
    is_shaded: bool = False,
    compares: bool = False,
    input_rms: float | None = None,
    memory: int = DEFAULT_MEMORY,
    jobs: int = 1,
) -> Rig:
    """Return a mesh that follows a reconstruction, or the input, by skin weights; note its error.

    Parameters
    ----------
    result : StoredAnimation
        That the cages are of, or that they were made from.
    influences : int or None
        Joints per vertex, at most, with weights that are fitted again; None keeps the weights of
        the reconstruction, which must not be negative.
    name : str
        What the note on the error is about.
    joints : str or int
        One of `JOINT_MOTIONS`, or how many joints that turn those of the cage are merged into.
    is_shaded : bool
        Whether the skin itself is written, with normals, which joints that turn take along: the
        note says how far off. Its joints are in limbs.
    input_rms : float, optional
        Distance of the reconstruction from the input, rms over all vertices and frames, in
        percent of the diagonal, where it is known.
    """
    with progress.stage("fit"), error_context(result.path), limit_blas_threads(1):
        solve = _read_solve_settings(result)
        target = _settle_rest(target)
        fit_rig = partial(
            _fit_rig,
            target,
            _find_seams(target),
            is_shaded=is_shaded,
            solve=solve,
            memory=memory,
            jobs=jobs,
        )
        rig = fit_rig(influences, joints)
        if rig.is_of_input:
            rig = replace(rig, total=rig.rms)
        elif input_rms is not None:
            rig = replace(rig, total=input_rms + rig.rms)
        progress.note("note", f"{name}: {rig.message}")
        if compares:
            if rig.roughness is not None:
                count = rig.skin.weights.joints.shape[1]
                progress.note(
                    "weights",
                    f"{rig.roughness:.2g} times as rough over the surface as the {count} largest "
                    "of the result",
                )
            n = len(target.binding.cage.vertices)
            counts = [k for k in COMPARED_INFLUENCES if k <= len(rig.cage.vertices)]
            texts = [
                f"{k}: {fit_rig(k, joints).figures}" for k in counts
            ]  # holds one rig at a time
            progress.note("influences", f"rms and largest error: {'; '.join(texts)}")
            for fewer in (n // 2, n // 4) if isinstance(joints, int) and n >= 16 else ():
                for count in COMPARED_INFLUENCES[:2]:
                    if count <= fewer:
                        progress.note("joints", fit_rig(count, fewer).line)
    return rig


def _fit_rig(
    target: Reconstruction,
    seams: Seams | None,
    influences: int | None,
    joints: str | int,
    *,
    is_shaded: bool,
    solve: SolveSettings,
    memory: int,
    jobs: int,
) -> Rig:
    """Return the rig with the weights of the target, or with few that are fitted again.

    Few weights that the target has are made for joints that only translate. Vertices that never
    come apart are fitted as one; errors are those of all.
    """
    welded = target if seams is None else _weld(target, seams)
    binding, turns = welded.binding, joints != "translate"
    if keeps_weights(binding, influences, joints):
        return _keep_weights(target)
    if influences is None and isinstance(joints, int):
        influences = min(DEFAULT_INFLUENCES, joints)
    if influences is None and binding.has_offsets:
        influences = _count_influences(binding)
    with error_context("few influences, with the alpha and beta of the result"):
        held, labels, limbs, roughness = binding, None, None, None
        is_grouped = is_shaded and len(binding.cage.vertices) >= 2 * MIN_JOINTS_PER_LIMB
        needs_tree = turns and (is_grouped or isinstance(joints, int))
        if influences is not None or needs_tree:
            settings = FitSettings(influences=influences)
            fitter = Fitter(binding, settings, solve=solve, memory=memory, jobs=jobs)
            sample = fitter.sample([welded])
            if needs_tree:
                tree = group_joints(fitter.cage_solve, sample.target)
                labels = tree.cut(joints) if isinstance(joints, int) else None
                limbs = tree.group_limbs(labels)
            if influences is not None:
                alternator = fitter.make_alternator(sample, DEFAULT_STRENGTH)
                held = limit_influences(
                    alternator, sample.target, influences, turns=turns, joints=labels
                )
                roughness = compare_roughness(alternator, held, influences, labels)
        weights = compute_skin_weights(held.weights)
        solver = DualLaplacianSolver(_bind_skin(held, weights), solve)
        poser = JointSolver(solver) if turns else None

        def pose(block: JointPoses) -> JointPoses:
            meshes = block.meshes if seams is None else block.meshes[:, seams.firsts]
            if poser is not None:
                posed = poser.solve(meshes)
            else:
                found = solver.solve(meshes)
                posed = JointPoses(found.cages, found.rotations, found.reconstructions)
            return posed if seams is None else replace(posed, meshes=posed.meshes[:, seams.places])

        if seams is not None:
            weights = SkinWeights(weights.joints[seams.places], weights.values[seams.places])
        rig = _measure_rig(target, held.cage, weights, pose, is_shaded=turns and is_shaded)
        skin = replace(rig.skin, cage_joints=labels, limbs=limbs)
        return replace(rig, skin=skin, roughness=roughness)


def keeps_weights(binding: Binding, influences: int | None, joints: str | int) -> bool:
    """Return whether joints are the cage vertices, and have their weights as they are."""
    is_held = influences is None or _has_few(binding, influences)
    return joints == "translate" and is_held


def check_rig(result: StoredAnimation, influences: int | None, joints: str | int) -> None:
    """Refuse too few joints, and more joints or influences than a cage has vertices."""
    n = len(result.cage.vertices)
    if isinstance(joints, int) and not MIN_JOINTS <= joints <= n:
        raise SettingError(
            f"{result.path}: "
            + Hint("joints", joints)
            + f", but the cage has {group_digits(n)} vertices; give {MIN_JOINTS} to {n}"
        )
    if influences is not None and influences > n:
        raise SettingError(
            f"{result.path}: "
            + Hint("influences", influences)
            + f", but the cage has {group_digits(n)} vertices; give {n} or less"
        )


def measure_input_rms(result: StoredAnimation) -> float | None:
    """Return the rms of a result, percent; None if it is not that of all vertices and frames."""
    rms = result.metrics.rms
    is_whole = np.isfinite(rms).all() and np.isfinite(result.vertex_rms).all()
    if not (is_whole and isinstance(result, Result)):
        return None
    return 100 * float(np.sqrt(np.mean(np.square(rms)))) / result.rest.diagonal


def _read_solve_settings(result: StoredAnimation) -> SolveSettings:
    """Return how the cages of a result were solved; a missing setting has its default."""
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
    if binding.has_offsets or isinstance(target, InputFrames):
        return target
    vertices = reconstruct(binding.weights, binding.cage.vertices[None])[0]
    rest = binding.rest.move(vertices)
    return Reconstruction(replace(binding, rest=rest), target.cages)


def _find_seams(target: Reconstruction) -> Seams | None:
    """Find the vertices that never come apart in some frames of a target."""
    probed = spread_evenly(len(target), MAX_PROBED_POSES).tolist()
    return Seams.find(target.binding.rest, map(target.read_frame, probed))


def _weld(target: Reconstruction, seams: Seams) -> Reconstruction:
    """Return a target with one vertex for those that never come apart."""
    binding = target.binding
    welded = replace(binding, rest=seams.weld(), weights=binding.weights[seams.firsts])
    if isinstance(target, InputFrames):
        return target.take(welded, seams.firsts)
    return Reconstruction(welded, target.cages)


def _has_few(binding: Binding, count: int) -> bool:
    """Return whether weights have at most `count` influences, and are made for that."""
    return binding.has_offsets and _count_influences(binding) <= count


def _count_influences(binding: Binding) -> int:
    """Return how many weights above zero a vertex has, at most."""
    return int((binding.weights > 0).sum(axis=1).max())


def _keep_weights(target: Reconstruction) -> Rig:
    """Return the rig with the weights and the cages of the target."""
    weights = compute_skin_weights(target.binding.weights)
    skinned = _bind_skin(target.binding, weights)

    def pose(block: JointPoses) -> JointPoses:
        return replace(block, meshes=reconstruct_frames(skinned, block))

    return _measure_rig(target, target.binding.cage, weights, pose)


def _bind_skin(binding: Binding, weights: SkinWeights) -> Binding:
    """Return a binding of skin weights, which need not reproduce the rest pose."""
    dense = weights.to_dense(len(binding.cage.vertices))
    return replace(binding, weights=dense, has_offsets=True)


def _measure_rig(
    target: Reconstruction,
    cage: TriMesh,
    weights: SkinWeights,
    pose: Pose,
    *,
    is_shaded: bool = False,
) -> Rig:
    """Pose all frames, and measure how far they and their normals are from the target."""
    rest = target.binding.rest
    rotations = []
    joints: list[JointPoses] | None = []
    squares = largest = 0.0
    dense = weights.to_dense(len(cage.vertices))
    normals = NormalAngles(rest, dense) if is_shaded else None
    for block in target.blocks(FRAMES_PER_RIG_BLOCK):
        posed = pose(block)
        rotations.append(posed.rotations)
        if joints is not None:
            joints.append(replace(posed, meshes=np.empty((0, 0, 3)), normals=None))
            joints = joints if _count_bytes(joints) <= MAX_HELD_BYTES else None
        distances = np.square(posed.meshes - block.meshes)[:, rest.used_vertices].sum(axis=2)
        squares += float(distances.sum())
        largest = max(largest, float(distances.max()))
        if normals is not None and posed.turns is not None:
            normals.add(posed.turns, block.meshes, posed.normals)
    count = target.cages.count * len(rest.used_vertices)
    percent = 100 / rest.diagonal
    return Rig(
        skin=Skin(rest, weights, np.concatenate(rotations)),
        cage=cage,
        rms=percent * float(np.sqrt(squares / count)),
        largest=percent * float(np.sqrt(largest)),
        angles=None if normals is None else normals.summarize(),
        is_of_input=isinstance(target, InputFrames),
        blocks=lambda: map(pose, target.blocks(FRAMES_PER_RIG_BLOCK)),
        posed=None if joints is None else tuple(joints),
    )


def _count_bytes(joints: list[JointPoses]) -> int:
    """Return the bytes of the places and the turns of joints."""
    return sum(one.cages.nbytes + (0 if one.turns is None else one.turns.nbytes) for one in joints)
