"""Skins of few influences: errors, normals, bytes and seconds; and beside bones of Dem Bones.

    python -m tests.benchmarks.rigs DATA [CLIP ...]

DATA has a folder per clip, with the packed clip (`CLIP.h5` with `verts`, `tris` and `rest`) and
cages (`cage_60.obj`, `cage_120.obj`); the clip `walker` is that of the fixtures, in its cage of 80.
One line per skin, against the frames of the clip:

- joints of each cage, that turn and that only translate, with weights fitted to every second tenth
  of the frames: errors of those, and of the others, which are held out;
- fewer joints that turn, into which those of the larger cage are merged, fitted to all frames;
- if `py_dem_bones` is installed, which is no dependency of the project, its bones (Le and Deng
  2012, 2014) and as many joints, all fitted to all frames.

Errors and distances are in percent of the diagonal, angles of normals are rms in degrees, bytes
are those of the whole clip as .glb. Seconds are of the processor, in two parts: the bind and the
fit of all weights of the cage, which skins of one cage share, and what the skin takes on top, with
its joints in all frames.

Dem Bones gets frames without the best rigid motion of each, which our solve takes away, too, and a
surface whose components are joined: else its bones stay on few of them.
"""

import importlib.util
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from time import process_time

import h5py
import numpy as np
from scipy.spatial import cKDTree

from cageik_cli.cages.bind import bind
from cageik_cli.fit.fit import Fitter
from cageik_cli.fit.settings import DEFAULT_STRENGTH, FitSettings, Strength
from cageik_cli.formats.base.sequence import ArraySequence
from cageik_cli.formats.base.skeleton import Skin, compute_skin_weights
from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.gltf.skeleton import SkeletonWriter
from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.solve.alignment import best_motions
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.rigs.joints import JointPoses, JointSolver, NormalAngles
from cageik_cli.rigs.jumps import follow_frames
from cageik_cli.rigs.skinning import group_joints, limit_influences
from cageik_cli.util.threads import limit_blas_threads

CLIPS = ("samba", "horse-gallop", "chickenCrossing", "walker")
WALKER = Path(__file__).parents[2] / "data_fixtures" / "walker"
COUNTS = (60, 120)
INFLUENCES = (4, 8)
FEWER = (20, 24, 40)
FEW = 4
"""Influences of fewer joints, and of bones."""

BONES = 24
STRENGTH = Strength(0.03, 1.0)
"""Of the weights of the cage; it is stated, so that seconds have no search in them."""

TENTHS = 10
BLOCK = 16

TITLES = "clip|skin|influences|error, %|held out|largest, %|held out|normals|held out|bytes|seconds"


def main(data, *clips):
    """Print the table."""
    print(f"| {TITLES.replace('|', ' | ')} |\n|{'---|' * len(TITLES.split('|'))}", flush=True)
    with limit_blas_threads(1):
        for name in clips or CLIPS:
            rest, frames, cages = load(Path(data) / name)
            is_held = np.arange(len(frames)) * TENTHS // len(frames) % 2 == 1
            for cage in cages:
                measure_cage(name, Model(rest, cage, frames[~is_held]), frames, is_held)
            every = Model(rest, cages[-1], frames)
            for count in FEWER:
                measure_fewer(name, every, count)
            if importlib.util.find_spec("py_dem_bones") is not None:
                measure_fewer(name, every, measure_bones(name, every.binding, frames))


def load(folder):
    """The rest pose, the frames and the cages of a clip."""
    if folder.name == WALKER.name:
        clip = open_sequence([str(WALKER / "frames")])
        return clip.first, np.stack(list(clip)), [load_mesh(WALKER / "cage.obj").mesh]
    with h5py.File(folder / f"{folder.name}.h5") as file:
        rest = TriMesh(file["rest"][:].astype(float), file["tris"][:])
        frames = file["verts"][:].astype(float)
    return rest, frames, [load_mesh(folder / f"cage_{n}.obj").mesh for n in COUNTS]


class Model:
    """A rest pose in a cage, whose weights are fitted to frames."""

    def __init__(self, rest, cage, frames):
        start = process_time()
        self.frames, self.clip = frames, ArraySequence(frames, rest)
        binding = bind(rest, cage)
        fitter = Fitter(binding, FitSettings())
        fitted, _ = fitter.fit_sample(fitter.sample([self.clip]), STRENGTH)
        self.binding = replace(binding, weights=fitted.weights)
        self.seconds = process_time() - start

    def fit_skin(self, influences, *, turns, count=None):
        """A binding of few influences, and the limb of each joint."""
        fitter = Fitter(self.binding, FitSettings(influences=influences))
        sample = fitter.sample([self.clip])
        tree = group_joints(fitter.cage_solve, sample.target) if turns else None
        joints = None if count is None else tree.cut(count)
        alternator = fitter.make_alternator(sample, DEFAULT_STRENGTH)
        limited = limit_influences(
            alternator, sample.target, influences, turns=turns, joints=joints
        )
        return limited, tree.group_limbs(joints) if turns else None


def measure_cage(name, model, frames, is_held):
    """Print the lines of a cage, fitted to some frames and measured on all."""
    for influences in INFLUENCES:
        for turns in (True, False):
            start = process_time()
            binding, limbs = model.fit_skin(influences, turns=turns)
            poses = pose_joints(binding, frames, turns=turns)
            seconds = f"{model.seconds:.1f} + {process_time() - start:.1f}"
            sides = [measure(binding, poses, frames, side) for side in (~is_held, is_held)]
            skin = f"{len(binding.cage.vertices)} joints {'turn' if turns else 'translate'}"
            size = count_bytes(binding, poses, limbs, turns=turns)
            print_line(name, skin, influences, *sides, size, seconds)


def measure_fewer(name, model, count):
    """Print the line of joints into which those of a cage are merged."""
    start = process_time()
    binding, limbs = model.fit_skin(FEW, turns=True, count=count)
    poses = pose_joints(binding, model.frames, turns=True)
    seconds = f"{model.seconds:.1f} + {process_time() - start:.1f}"
    every = measure(binding, poses, model.frames)
    size = count_bytes(binding, poses, limbs, turns=True)
    print_line(name, f"{count} joints turn", FEW, every, None, size, seconds)


def measure_bones(name, binding, frames):
    """Print the line of Dem Bones, and return how many bones it made."""
    from py_dem_bones import solve_skinning

    rest = binding.rest.move(binding.rest.vertices - binding.rest.vertices.mean(axis=0))
    centres, rotations = best_motions(frames, rest.vertices, np.ones(len(rest.vertices)))
    aligned = (frames - centres[:, None]) @ rotations.swapaxes(1, 2)
    start = process_time()
    found = solve_skinning(rest.vertices, aligned, BONES, faces=join_components(rest).tolist())
    seconds = process_time() - start
    weights, matrices = found.weights.T, found.transforms
    turns, places = matrices[:, :, :3, :3].swapaxes(2, 3), matrices[:, :, :3, 3]
    meshes = [
        np.einsum("mn,nmx->mx", weights, rest.vertices @ turn + place[:, None])
        for turn, place in zip(turns, places, strict=True)
    ]
    poses = JointPoses(places, rotations, np.array(meshes), turns)
    bones = replace(binding, rest=rest, weights=weights)
    count = weights.shape[1]
    every = measure(bones, poses, aligned)
    print_line(name, f"{count} bones of Dem Bones", FEW, every, None, None, f"{seconds:.1f}")
    return count


def join_components(rest):
    """The faces, and one from each vertex to the nearest of another component."""
    labels, (a, b, c) = rest.components, rest.faces.T
    beside = np.empty(len(labels), np.int64)
    beside[a], beside[b], beside[c] = b, c, a
    joined = [rest.faces]
    for label in np.unique(labels[rest.faces]):
        inside = np.flatnonzero(labels == label)
        others = np.flatnonzero((labels != label) & rest.is_used)
        if len(others):
            near = others[cKDTree(rest.vertices[others]).query(rest.vertices[inside])[1]]
            joined.append(np.column_stack([inside, near, beside[near]]))
    return np.concatenate(joined)


def pose_joints(binding, frames, *, turns):
    """The joints of all frames."""
    solver = DualLaplacianSolver(binding, SolveSettings())
    joints = JointSolver(solver) if turns else None
    split = [frames[start : start + BLOCK] for start in range(0, len(frames), BLOCK)]
    blocks = [] if joints is None else list(follow_frames(joints, split))
    for block in split if joints is None else ():
        found = solver.solve(block)
        whole = np.repeat(found.rotations[:, None], len(binding.cage.vertices), axis=1)
        blocks.append(JointPoses(found.cages, found.rotations, found.reconstructions, whole))
    names = ("cages", "rotations", "meshes", "turns")
    return JointPoses(*(np.concatenate([getattr(b, name) for b in blocks]) for name in names))


def measure(binding, poses, frames, chosen=slice(None)):
    """The rms and the largest distance, percent, and the rms angle of normals."""
    distances = np.linalg.norm(poses.meshes[chosen] - frames[chosen], axis=2)
    percent = 100 * distances / binding.rest.diagonal
    angles = NormalAngles(binding.rest, binding.weights)
    for turns, frame in zip(poses.turns[chosen], frames[chosen], strict=True):
        angles.add(turns[None], frame[None])
    return np.sqrt(np.square(percent).mean()), percent.max(), angles.summarize()[0]


def count_bytes(binding, poses, limbs, *, turns):
    """The size of the clip as .glb, in bytes."""
    weights = compute_skin_weights(binding.weights)
    joints = poses.turns if turns else None
    skin = Skin(binding.rest, weights, poses.rotations, joints, limbs=limbs)
    animation = Animation(binding.cage, len(poses.cages), Scene(), "clip")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "clip.glb"
        writer = SkeletonWriter(path, animation, skin)
        writer.append(poses.cages)
        writer.complete()
        return path.stat().st_size


def print_line(name, skin, influences, seen, held, size, seconds):
    """Print one line of the table."""
    figures = []
    for k, form in enumerate(("{:.3f}", "{:.2f}", "{:.1f}")):
        figures += [form.format(seen[k]), "" if held is None else form.format(held[k])]
    cells = [name, skin, influences, *figures, "" if size is None else size, seconds]
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
