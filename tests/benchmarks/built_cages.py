"""How good built cages are, by an independent checker, and how well they express an animation.

    python -m tests.benchmarks.built_cages [kinds] [COUNT,COUNT...] FOLDER [FOLDER ...]

A folder holds a model (`model.obj`) or a packed clip (`NAME.h5` with `verts`, `tris` and `rest`),
and cages to compare with (`cage_60.obj`, ...). Each model gets cages of 60, 120 and 300 vertices;
each clip gets two of each, without and with the animation, and their errors with harmonic weights,
and with weights fitted to the clip, on all frames are divided by those of the given cage. One line
per cage. With `kinds`, each model gets a cage of triangles instead, and cages with quads, with
loops, and with both, whose errors are divided by those of the triangles; their lines have the share
of quads among the faces.
"""

import sys
from dataclasses import replace
from pathlib import Path
from time import process_time

import h5py
import numpy as np

from cageik_cli.cages.bind import bind
from cageik_cli.cages.builder.build import build_cage
from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.fit.fit import Fitter
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.open import load_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import bounds_volume
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import reconstruct
from cageik_cli.run.api import extract
from cageik_cli.run.cage import make_measured_clip
from tests.cages.independent import examine
from tests.fitted import Frames

COUNTS = (60, 120, 300)
CLEARANCE = 0.004
BLOCK = 16
KINDS = {
    "--quads": {"quads": True},
    "--loops": {"loops": True},
    "--quads --loops": {"quads": True, "loops": True},
}


def main(*words):
    """Print one line per cage."""
    counts, folders = COUNTS, list(words)
    has_kinds = folders[0] == "kinds"
    folders = folders[has_kinds:]
    if folders[0].replace(",", "").isdigit():
        counts, folders = [int(word) for word in folders[0].split(",")], folders[1:]
    print("| model | n | vertices | genus | clearance | angle | valence | volume | seconds | fit |")
    for count in counts:
        for folder in map(Path, folders):
            (compare_kinds if has_kinds else compare_given)(folder, count)


def compare_given(folder, count):
    """Print the lines of a model, without and with its animation."""
    model, frames = read_folder(folder)
    given = folder / f"cage_{count}.obj"
    known = measure_errors(model, load_mesh(given).mesh, frames) if given.exists() else None
    measure_cage(folder.name, model, BuildSettings(count, CLEARANCE), clip=frames, known=known)
    if frames is not None:
        settings = BuildSettings(count, CLEARANCE)
        measure_cage(f"{folder.name} --for", model, settings, frames, frames, known)


def compare_kinds(folder, count):
    """Print the lines of a model with triangles, and with quads, loops, and both."""
    model, frames = read_folder(folder)
    settings = BuildSettings(count, CLEARANCE)
    cage = measure_cage(folder.name, model, settings)
    known = None if frames is None else measure_errors(model, cage, frames)
    for name, kind in KINDS.items():
        wanted = replace(settings, **kind)
        measure_cage(f"{folder.name} {name}", model, wanted, clip=frames, known=known)


def read_folder(folder):
    """The rest mesh of a folder, and all frames if it has a clip."""
    packed = sorted(folder.glob("*.h5"))
    if not packed:
        return load_mesh(folder / "model.obj").mesh, None
    with h5py.File(packed[0]) as file:
        return TriMesh(file["rest"][:].astype(float), file["tris"][:]), file["verts"][:]


def measure_cage(name, model, settings, frames=None, clip=None, known=None):
    """Build a cage, print what it is like, and return it."""
    start = process_time()
    purpose = None
    if frames is not None:
        purpose = make_measured_clip(model, len(frames), lambda k: frames[k].astype(float), jobs=1)
    built = build_cage(model, settings, purpose)
    seconds = process_time() - start
    cage = built.cage
    opinion = examine(cage, model, CLEARANCE)
    volume = f"{cage.volume / model.volume:.3f}" if bounds_volume(model) else "open"
    line = (
        f"| {name} | {settings.vertices} | {len(cage.vertices)} | {opinion.genus} | "
        f"{100 * opinion.clearance:.3f} % | {opinion.smallest_angle:.1f} | "
        f"{opinion.largest_valence} | {volume} | {seconds:.1f} | {diagnose(cage, model).verdict} |"
    )
    if settings.quads:
        line += f" {100 * (cage.polygons.corner_counts == 4).mean():.0f} % quads |"
    if known is not None:
        for kind, error, other in zip(
            ("harmonic", "fitted"), measure_errors(model, cage, clip), known, strict=True
        ):
            line += f" {kind} {error:.4f} %, other {other:.4f} %, ratio {error / other:.3f} |"
    print(line, *opinion.faults, built.chosen.recipe, flush=True)
    return cage


def measure_errors(model, cage, frames):
    """The rms distance on all frames, percent of the diagonal: harmonic, and fitted to them."""
    binding = bind(model, cage)
    solver = DualLaplacianSolver(binding, SolveSettings())
    total = 0.0
    for start in range(0, len(frames), BLOCK):
        block = frames[start : start + BLOCK].astype(float)
        cages = solver.solve(block).cages
        total += ((reconstruct(binding.weights, cages) - block) ** 2).sum()
    rms = 100 * np.sqrt(total / (len(frames) * len(model.vertices))) / model.diagonal
    frames = np.asarray(frames, float)
    fitted = Fitter(binding, FitSettings(), jobs=1).fit([Frames(frames)]).binding
    return rms, extract(frames, fitted).rms_percent


if __name__ == "__main__":
    main(*sys.argv[1:])
