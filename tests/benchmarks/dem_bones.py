"""Fitted weights beside bones fitted by Dem Bones (Le and Deng 2012, 2014) to the same frames.

    python -m tests.benchmarks.dem_bones FOLDER [FOLDER ...]

A folder holds a packed clip (`NAME.h5` with `verts`, `tris` and `rest`) and cages (`cage_60.obj`,
...). Needs `py-dem-bones`, which is no dependency of the project. One line per method: rms over all
frames in percent of the diagonal, seconds (of the wall clock, without reading), and the numbers
that must be kept: once, and per frame.
"""

import sys
from pathlib import Path
from time import perf_counter

import h5py
import numpy as np
from py_dem_bones import solve_skinning

from cageik_cli.cages.bind import bind
from cageik_cli.formats.open import load_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.run.api import extract
from cageik_cli.run.fit import fit_weights

BONES = 20
COUNTS = (60, 120)


def main(*folders):
    """Print the table."""
    print("| clip | method | rms, % | seconds | floats once | floats per frame |")
    for folder in map(Path, folders):
        with h5py.File(next(folder.glob("*.h5"))) as file:
            rest = TriMesh(file["rest"][:].astype(float), file["tris"][:])
            frames = file["verts"][:].astype(float)
        for count in COUNTS:
            measure_cage(folder.name, rest, load_mesh(folder / f"cage_{count}.obj").mesh, frames)
        measure_bones(folder.name, rest, frames)


def measure_cage(name, rest, cage, frames):
    """Print the lines of harmonic and of fitted weights."""
    start = perf_counter()
    binding = bind(rest, cage)
    animation = extract(frames, binding)
    seconds, count = perf_counter() - start, len(cage.vertices)
    print_line(
        name, f"harmonic, {count}", animation.rms_percent, seconds, binding.weights.size, 3 * count
    )
    start = perf_counter()
    fitted = fit_weights(binding, [frames])
    animation = extract(frames, fitted.binding)
    seconds += perf_counter() - start
    floats = fitted.report.fixed_floats
    print_line(name, f"fitted, {count}", animation.rms_percent, seconds, floats, 3 * count)


def measure_bones(name, rest, frames):
    """Print the line of Dem Bones, with four influences per vertex."""
    start = perf_counter()
    found = solve_skinning(rest.vertices, frames, BONES, faces=rest.faces.tolist())
    seconds = perf_counter() - start
    transforms = np.asarray(found.transforms)
    if transforms.shape[0] != len(frames):
        transforms = transforms.swapaxes(0, 1)
    total = 0.0
    for pose, frame in zip(transforms, frames, strict=True):
        moved = np.einsum("bxy,vy->bvx", pose[:, :3, :3], rest.vertices) + pose[:, None, :3, 3]
        total += ((np.einsum("bv,bvx->vx", found.weights, moved) - frame) ** 2).sum()
    error = 100 * np.sqrt(total / frames.shape[0] / frames.shape[1]) / rest.diagonal
    bones = len(found.weights)
    kept = 2 * np.count_nonzero(found.weights > 1e-8)
    print_line(name, f"Dem Bones, {bones} bones", error, seconds, kept, 12 * bones)


def print_line(name, method, error, seconds, once, per_frame):
    """Print one line of the table."""
    print(f"| {name} | {method} | {error:.3f} | {seconds:.1f} | {once} | {per_frame} |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
