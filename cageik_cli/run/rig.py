"""A mesh that follows an animation by skin weights: its own, or few that are fitted again."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import cache as keep_result
from functools import partial
from itertools import chain, tee
from pathlib import Path

import numpy as np

from cageik_cli.fit.fit import Fitter
from cageik_cli.fit.settings import DEFAULT_STRENGTH, FitSettings
from cageik_cli.formats.base.skeleton import (
    MIN_WEIGHT,
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
from cageik_cli.rigs.jumps import follow_frames
from cageik_cli.rigs.merging import MIN_JOINTS, count_limbs, split_budget
from cageik_cli.rigs.skinning import compare_roughness, group_joints, limit_influences
from cageik_cli.store.cache import Entry, EntryCache, compute_rig_key, find_rig
from cageik_cli.store.result import Result, StoredAnimation
from cageik_cli.util.arrays import Floats, Integers, cut_blocks, spread_evenly
from cageik_cli.util.errors import FileAccessError, FormatError, SettingError, error_context
from cageik_cli.util.messages import Hint
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.settings import DEFAULT_MEMORY
from cageik_cli.util.text import format_bytes, format_count, group_digits
from cageik_cli.util.threads import limit_blas_threads

Pose = Callable[[Iterator[JointPoses]], Iterator[JointPoses]]
"""Poses the joints of a skin for all frames of the reconstruction, block by block."""

RIG_VERSION = 5
"""Raise it when skins or their figures change, so that kept ones are not used."""

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
    frame_errors : (F, 2) float64
        The rms and the largest of those distances in each frame, in the same percent.
    posed : tuple of JointPoses, optional
        Their joints without the meshes, if they take no more than `MAX_HELD_BYTES`.
    roughness : float, optional
        Of the weights over the surface, as a share of that of the largest ones before they were
        fitted again. None where they were not.
    jumps : (k, 2) int64
        Frames, and joints that jump from the frame before.
    heads : int
        Joints above all others in a file: the root, and the body if the root is extracted. 0
        where joints are not counted.
    """

    skin: Skin
    cage: TriMesh
    rms: float
    largest: float
    blocks: Callable[[], Iterator[JointPoses]]
    frame_errors: Floats
    angles: tuple[float, float] | None = None
    total: float | None = None
    is_of_input: bool = False
    posed: tuple[JointPoses, ...] | None = None
    roughness: float | None = None
    jumps: Integers = field(default_factory=lambda: np.empty((0, 2), np.int64))
    heads: int = 0

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
    def joint_count(self) -> int:
        """How many joints a file has."""
        return self.heads + self.skin.limb_count + len(self.cage.vertices)

    @property
    def figures(self) -> str:
        """The errors, in a few characters."""
        return f"{self.rms:.2g}, {self.largest:.2g} %"

    @property
    def line(self) -> str:
        """What it costs, for a comparison: errors, normals, and bytes of what is written."""
        weights = self.skin.weights.joints.shape[1]
        size = count_skin_bytes(self.skin, len(self.cage.vertices))
        normals = "" if self.angles is None else f", normals {self.angles[0]:.2g} degrees off"
        return (
            f"{self.joint_count} joints, {weights} influences: {self.rms:.2g} %, largest "
            f"{self.largest:.2g} %{normals}, about {format_bytes(size)}"
        )

    @property
    def message(self) -> str:
        """A sentence for the user."""
        clauses = [f"up to {self.skin.weights.joints.shape[1]} influences per vertex"]
        if self.heads:
            clauses.insert(0, f"{group_digits(self.joint_count)} joints ({self._kinds})")
        clauses.append(self._describe_errors(self.rms, self.largest, self.total))
        if self.angles is not None:
            shaded = "normals are {:.2g} degrees off (rms), 1 % of them more than {:.2g}"
            clauses.append(shaded.format(*(round(angle, 2) for angle in self.angles)))
        return "; ".join(clauses)

    @property
    def _kinds(self) -> str:
        """How many joints of a file are of which kind."""
        kinds = ["root", "body"][: self.heads]
        if self.skin.limb_count:
            kinds.append(format_count(self.skin.limb_count, "limb"))
        own = group_digits(len(self.cage.vertices))
        return ", ".join([*kinds, f"{own} that move the mesh"])

    def describe_clip(self, frames: slice, input_rms: float | None) -> tuple[float | None, str]:
        """Return the total of a clip, as of `total`, which is some of the frames; and a sentence.

        `input_rms` is that of the clip.
        """
        rms = float(np.sqrt(np.square(self.frame_errors[frames, 0]).mean()))
        largest = float(self.frame_errors[frames, 1].max())
        total = self._add_input_rms(rms, input_rms)
        return total, self._describe_errors(rms, largest, total, share="")

    def _add_input_rms(self, rms: float, input_rms: float | None) -> float | None:
        """Return the largest that an rms distance from the input can be, percent."""
        if self.is_of_input:
            return rms
        return None if input_rms is None else input_rms + rms

    def _describe_errors(
        self, rms: float, largest: float, total: float | None, share: str = " of the diagonal"
    ) -> str:
        """Say how far the skin is from what it follows, and from the input."""
        added = f"it adds an rms of {rms:.2g} %, largest {largest:.2g} %"
        if self.is_of_input:
            stated = f"an rms of {rms:.2g} %, largest {largest:.2g} %{share}"
            return f"against the input, {stated}"
        if largest < 1e-6:  # rounding: single precision is coarser
            return "the mesh moves as with the full weights"
        if total is None:
            return f"{added}{share}, against the full weights"
        return f"{added}; against the input, the rms is at most {total:.2g} %"


def make_rig(
    result: StoredAnimation,
    target: Reconstruction,
    progress: ProgressListener,
    *,
    influences: int | None,
    name: str,
    joints: str | int = "turn",
    heads: int = 1,
    is_shaded: bool = False,
    compares: bool = False,
    input_rms: float | None = None,
    memory: int = DEFAULT_MEMORY,
    jobs: int = 1,
    cache: Path | None = None,
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
        One of `JOINT_MOTIONS`, or how many joints a file has, which turn. Those of the cage are
        merged if they are more.
    heads : int
        How many of these are above the limbs: the root, and the body if the root is extracted.
    is_shaded : bool
        Whether the skin itself is written, with normals, which joints that turn take along: the
        note says how far off. Its joints are in limbs.
    input_rms : float, optional
        Distance of the reconstruction from the input, rms over all vertices and frames, in
        percent of the diagonal, where it is known.
    cache : Path, optional
        A folder that keeps the rig, with the joints of all frames: another format, or a change of
        what is written, fits and poses nothing again.
    """
    with error_context(result.path), limit_blas_threads(1):
        target = _settle_rest(target)
        with progress.stage("fit"):
            seams = _find_seams(target)
        make_fit = partial(
            _RigFit,
            target,
            seams,
            heads=heads,
            is_shaded=is_shaded,
            solve=_read_solve_settings(result),
            memory=memory,
            jobs=jobs,
            cache=cache,
        )
        rig = make_fit(progress).find(influences, joints)
        rig = replace(rig, total=rig._add_input_rms(rig.rms, input_rms))
        progress.note("note", f"{name}: {rig.message}")
        if compares:
            with progress.stage("compare"):
                fit_rig = make_fit(ProgressListener()).find
                _compare(rig, len(target.binding.cage.vertices), joints, fit_rig, progress)
    return rig


def _compare(
    rig: Rig,
    n: int,
    joints: str | int,
    fit_rig: Callable[[int, str | int], Rig],
    progress: ProgressListener,
) -> None:
    """Note how rough a skin is, and how far rigs of other numbers are, held one at a time.

    The cage has `n` vertices.
    """
    if rig.roughness is not None:
        count = rig.skin.weights.joints.shape[1]
        progress.note(
            "weights",
            f"{rig.roughness:.2g} times as rough over the surface as the {count} largest of the "
            "result",
        )
    counts = [k for k in COMPARED_INFLUENCES if k <= len(rig.cage.vertices)]
    texts = [f"{k}: {fit_rig(k, joints).figures}" for k in counts]
    progress.note("influences", f"rms and largest error: {'; '.join(texts)}")
    for fewer in (n // 2, n // 4) if isinstance(joints, int) and n >= 16 else ():
        for count in COMPARED_INFLUENCES[:2]:
            if count <= fewer - rig.heads:
                progress.note("joints", fit_rig(count, fewer).line)


class _RigFit:
    """Rigs that follow one target: from the cache, or fitted and posed.

    Vertices that never come apart, of `seams`, are fitted as one; errors are those of all.
    """

    def __init__(
        self,
        target: Reconstruction,
        seams: Seams | None,
        progress: ProgressListener,
        *,
        heads: int,
        is_shaded: bool,
        solve: SolveSettings,
        memory: int,
        jobs: int,
        cache: Path | None,
    ) -> None:
        self._target, self._seams = target, seams
        self._welded = target if seams is None else _weld(target, seams)
        self._progress, self._heads, self._is_shaded = progress, heads, is_shaded
        self._solve, self._memory, self._jobs, self._cache = solve, memory, jobs, cache

    def find(self, influences: int | None, joints: str | int) -> Rig:
        """Return the rig with the weights of the target, or with few that are fitted again.

        Few weights that the target has are made for joints that only translate.
        """
        rig = self._find(influences, joints)
        skin = replace(rig.skin, has_limb_joints=self._split(joints)[1] != 0)
        is_counted = self._is_shaded or isinstance(joints, int)
        return replace(rig, skin=skin, heads=self._heads if is_counted else 0)

    def _find(self, influences: int | None, joints: str | int) -> Rig:
        target = self._target
        if keeps_weights(self._welded.binding, influences, joints):
            with self._progress.stage("pose"):
                return _keep_weights(target)
        if self._cache is None:
            return self._compute(influences, joints)
        settings = {
            "rig": RIG_VERSION,
            "influences": influences,
            "joints": joints,
            "heads": self._heads,
            "shaded": self._is_shaded,
            "solve": asdict(self._solve),
            "memory": self._memory,
            "input": isinstance(target, InputFrames),
            "clips": target.cages.clip_counts,
        }
        frames = target.hash_frames()

        def compute() -> Rig:
            rig = self._compute(influences, joints)
            if target.hash_frames() != frames:
                raise FileAccessError("the frames changed during the run; run again")
            return rig

        return find_rig(
            EntryCache(self._cache, partial(self._progress.note, "skin")),
            compute_rig_key(target.binding, settings, frames),
            compute,
            _to_entry,
            partial(self._from_entry, joints != "translate"),
        )

    def _compute(self, influences: int | None, joints: str | int) -> Rig:
        """Fit the weights, pose the joints in all frames, and measure how far they are."""
        welded, progress = self._welded, self._progress
        binding, turns = welded.binding, joints != "translate"
        turning, limb_count = self._split(joints)
        if isinstance(joints, int):
            influences = min(influences or DEFAULT_INFLUENCES, turning)
        if influences is None and binding.has_offsets:
            influences = count_influences(binding)
        with error_context("few influences, with the alpha and beta of the result"):
            held, labels, limbs, roughness = binding, None, None, None
            is_grouped = self._is_shaded and count_limbs(turning) > 0
            needs_tree = turns and (is_grouped or isinstance(joints, int))
            with progress.stage("fit"):
                if influences is not None or needs_tree:
                    settings = FitSettings(influences=influences)
                    fitter = Fitter(
                        binding, settings, solve=self._solve, memory=self._memory, jobs=self._jobs
                    )
                    sample = fitter.sample([welded])
                    if needs_tree:
                        tree = group_joints(fitter.cage_solve, sample.target)
                        labels = tree.cut(turning) if isinstance(joints, int) else None
                        limbs = tree.group_limbs(labels, limb_count)
                    if influences is not None:
                        alternator = fitter.make_alternator(sample, DEFAULT_STRENGTH)
                        held = limit_influences(
                            alternator, sample.target, influences, turns=turns, joints=labels
                        )
                        roughness = compare_roughness(alternator, held, influences, labels)
            weights = compute_skin_weights(held.weights)
            with progress.stage("pose"):
                pose = self._make_pose(held.cage, weights, turns)
                is_shaded = turns and self._is_shaded
                if self._seams is not None:
                    weights = _take_rows(weights, self._seams.places)
                rig = _measure_rig(self._target, held.cage, weights, pose, is_shaded=is_shaded)
            skin = replace(rig.skin, cage_joints=labels, limbs=limbs)
            return replace(rig, skin=skin, roughness=roughness)

    def _split(self, joints: str | int) -> tuple[int, int | None]:
        """Return how many joints move the mesh, and how many limbs are joints; None for all."""
        count = len(self._welded.binding.cage.vertices)
        if not isinstance(joints, int):
            return count, None
        return split_budget(joints, count, self._heads)

    def _make_pose(self, cage: TriMesh, weights: SkinWeights, turns: bool) -> Pose:
        """Return what poses joints; its system is factored for the first frames.

        The weights are those of the places that vertices which never come apart share.
        """
        skinned, seams = _bind_skin(replace(self._welded.binding, cage=cage), weights), self._seams

        @keep_result
        def prepare() -> tuple[DualLaplacianSolver, JointSolver | None]:
            solver = DualLaplacianSolver(skinned, self._solve)
            return solver, JointSolver(solver) if turns else None

        def pose(blocks: Iterator[JointPoses]) -> Iterator[JointPoses]:
            poser = prepare()[1]
            firsts = slice(None) if seams is None else seams.firsts
            meshes = (block.meshes[:, firsts] for block in blocks)
            for posed in map(translate, meshes) if poser is None else follow(poser, meshes):
                if seams is None:
                    yield posed
                else:  # the normals of places know no hard edges
                    yield replace(posed, meshes=posed.meshes[:, seams.places], normals=None)

        def follow(poser: JointSolver, meshes: Iterator[Floats]) -> Iterator[JointPoses]:
            counts = self._target.cages.clip_counts or (self._target.cages.count,)
            for clip in cut_blocks(meshes, counts):  # none is smooth with the one before
                yield from follow_frames(poser, clip)

        def translate(meshes: Floats) -> JointPoses:
            found = prepare()[0].solve(meshes)
            return JointPoses(found.cages, found.rotations, found.reconstructions)

        return pose

    def _from_entry(self, turns: bool, entry: Entry) -> Rig:
        """Return the rig that an entry of the cache holds."""
        target, places, rotations = self._target, entry["places"], entry["rotations"]
        weights = SkinWeights(entry["joints"], entry["weights"])
        cage = TriMesh(entry["cage"], entry["faces"])
        labels, limbs = (entry[name] if len(entry[name]) else None for name in ("labels", "limbs"))
        own = weights if self._seams is None else _take_rows(weights, self._seams.firsts)
        pose = self._make_pose(cage, own, turns)
        bounds = range(FRAMES_PER_RIG_BLOCK, len(places), FRAMES_PER_RIG_BLOCK)
        blocks = (np.split(entry[name], bounds) for name in ("places", "turns", "rotations"))
        posed = tuple(
            JointPoses(cages, turned, np.empty((0, 0, 3)), turns=found if turns else None)
            for cages, found, turned in zip(*blocks, strict=True)
        )
        return Rig(
            skin=Skin(target.binding.rest, weights, rotations, cage_joints=labels, limbs=limbs),
            cage=cage,
            rms=entry["rms"],
            largest=entry["largest"],
            angles=entry["angles"],
            is_of_input=isinstance(target, InputFrames),
            blocks=lambda: pose(target.blocks(FRAMES_PER_RIG_BLOCK)),
            frame_errors=entry["frame_errors"],
            posed=posed if entry["is_posed"] else None,
            roughness=entry["roughness"],
            jumps=entry["jumps"],
        )


def _to_entry(rig: Rig) -> Entry:
    """Return what the cache keeps of a rig; joints that are not held are posed again."""
    none, skin = np.empty(0, np.int64), rig.skin
    posed = rig.posed or ()
    count, n = (len(skin.rotations) if posed else 0), len(rig.cage.vertices)
    turns = [one.turns for one in posed if one.turns is not None]
    return {
        "joints": skin.weights.joints,
        "weights": skin.weights.values,
        "cage": rig.cage.vertices,
        "faces": rig.cage.faces,
        "labels": none if skin.cage_joints is None else skin.cage_joints,
        "limbs": none if skin.limbs is None else skin.limbs,
        "rotations": skin.rotations,
        "frame_errors": rig.frame_errors,
        "places": np.concatenate([np.empty((0, n, 3)), *(one.cages for one in posed)]),
        "turns": np.concatenate([np.empty((0, n, 3, 3)), *turns])
        if turns
        else np.empty((count, 0)),
        "rms": rig.rms,
        "largest": rig.largest,
        "angles": rig.angles,
        "roughness": rig.roughness,
        "jumps": rig.jumps,
        "is_posed": bool(posed),
    }


def keeps_weights(binding: Binding, influences: int | None, joints: str | int) -> bool:
    """Return whether joints are the cage vertices, and have their weights as they are."""
    is_held = influences is None or _has_few(binding, influences)
    return joints == "translate" and is_held


def check_rig(
    result: StoredAnimation, influences: int | None, joints: str | int, heads: int = 1
) -> None:
    """Refuse fewer or more joints than a skeleton can have, and more influences than vertices.

    The vertices are those of the cage; `heads` of the joints are above the limbs.
    """
    n = len(result.cage.vertices)
    least, most = heads + MIN_JOINTS, heads + count_limbs(n) + n
    if isinstance(joints, int) and not least <= joints <= most:
        raise SettingError(
            f"{result.path}: "
            + Hint("joints", joints)
            + f", and the skeleton of a cage of {group_digits(n)} vertices has {least} joints at "
            f"least and {most} at most; give {least} to {most}"
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


def _take_rows(weights: SkinWeights, rows: Integers) -> SkinWeights:
    """Return the weights of some vertices, (k,)."""
    return SkinWeights(weights.joints[rows], weights.values[rows])


def _has_few(binding: Binding, count: int) -> bool:
    """Return whether weights have at most `count` influences, and are made for that."""
    return binding.has_offsets and count_influences(binding) <= count


def count_influences(binding: Binding) -> int:
    """Return how many weights a vertex has that a skin keeps, at most."""
    return int((binding.weights >= MIN_WEIGHT).sum(axis=1).max())


def _keep_weights(target: Reconstruction) -> Rig:
    """Return the rig with the weights and the cages of the target."""
    weights = compute_skin_weights(target.binding.weights)
    skinned = _bind_skin(target.binding, weights)

    def pose(blocks: Iterator[JointPoses]) -> Iterator[JointPoses]:
        for block in blocks:
            yield replace(block, meshes=reconstruct_frames(skinned, block))

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
    rotations, errors = [], []
    jumps, done = [np.empty((0, 2), np.int64)], 0
    joints: list[JointPoses] | None = []
    squares = largest = 0.0
    dense = weights.to_dense(len(cage.vertices))
    normals = NormalAngles(rest, dense) if is_shaded else None
    blocks, others = tee(target.blocks(FRAMES_PER_RIG_BLOCK))
    for block, posed in zip(blocks, pose(others), strict=True):
        rotations.append(posed.rotations)
        if posed.jumps is not None:
            jumps.append(np.argwhere(posed.jumps) + np.array([done, 0]))
        done += len(posed.rotations)
        if joints is not None:
            held = replace(posed, meshes=np.empty((0, 0, 3)), normals=None, jumps=None)
            joints.append(held)
            joints = joints if _count_bytes(joints) <= MAX_HELD_BYTES else None
        distances = np.square(posed.meshes - block.meshes)[:, rest.used_vertices].sum(axis=2)
        squares += float(distances.sum())
        errors.append(np.stack([distances.mean(axis=1), distances.max(axis=1)], axis=1))
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
        blocks=lambda: pose(target.blocks(FRAMES_PER_RIG_BLOCK)),
        frame_errors=percent * np.sqrt(np.concatenate(errors)),
        posed=None if joints is None else tuple(joints),
        jumps=np.concatenate(jumps),
    )


def _count_bytes(joints: list[JointPoses]) -> int:
    """Return the bytes of the places and the turns of joints."""
    return sum(one.cages.nbytes + (0 if one.turns is None else one.turns.nbytes) for one in joints)
