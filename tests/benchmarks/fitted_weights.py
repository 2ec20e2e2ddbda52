"""What fitted weights gain on real clips: tables of errors, costs and seconds.

python -m tests.benchmarks.fitted_weights DATA [--clips samba,...] [--cages 60,120] [--tables ...]

DATA holds a folder per clip with CLIP.h5 (`verts`, `tris`, `rest`) and cage_N.obj. Every second
frame is fitted, the others are measured, in percent of the diagonal. Bindings are not timed.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from cageik_cli import Binding, TriMesh, bind, load_mesh
from cageik_cli.fit.fit import Fitter
from cageik_cli.fit.fitted import FittedWeights
from cageik_cli.fit.settings import DEFAULT_STRENGTH, FitSettings
from cageik_cli.method.solve.settings import FITTED_NORM, LEAST_SQUARES, SolveSettings
from cageik_cli.run.api import extract
from cageik_cli.util.threads import count_processors, limit_blas_threads
from tests.fitted import Frames

JOBS = count_processors()
SOLVE = SolveSettings(norm=FITTED_NORM)
"""As runs have it by default; weights of low rank or few influences are of least squares."""
TABLES = ("errors", "halves", "rank", "influences", "growth")


def load(folder: Path) -> tuple[np.ndarray, TriMesh]:
    """Frames (F, m, 3) and the rest pose."""
    with h5py.File(folder / f"{folder.name}.h5") as file:
        rest = TriMesh(file["rest"][:].astype(float), file["tris"][:].astype(np.int64))
        return file["verts"][:].astype(float), rest


def timed(binding: Binding, frames: np.ndarray, **settings: object) -> tuple[FittedWeights, float]:
    """The fitted weights with their report, and the seconds of all of it."""
    start = time.perf_counter()
    found = Fitter(binding, FitSettings(**settings), solve=SOLVE, jobs=JOBS).fit([Frames(frames)])
    return found, time.perf_counter() - start


def deviations(frames: np.ndarray, binding: Binding, norm: float = FITTED_NORM) -> str:
    """The rms, 99th percentile and largest deviation of frames in percent of the diagonal."""
    animation = extract(frames, binding, norm=norm)
    errors = []
    for k, frame in enumerate(frames):
        errors.append(np.linalg.norm(animation.reconstruct(k) - frame, axis=1))
    scale = 100 / binding.rest.diagonal
    return (
        f"{animation.rms_percent:8.4f} {scale * np.percentile(errors, 99):7.3f} "
        f"{scale * np.max(errors):7.3f}"
    )


def errors(name: str, frames: np.ndarray, binding: Binding) -> None:
    """Held-out frames against harmonic weights: a given strength, the default, and to be played."""
    n = binding.weights.shape[1]
    print(f"{name:16} {n:4} harmonic {deviations(frames[1::2], binding, LEAST_SQUARES)}")
    for settings in ({"regularization": 0.1}, {}, {"use": "play"}):
        found, seconds = timed(binding, frames[::2], **settings)
        report, quality = found.report, found.binding.quality
        exactness = max(quality.partition_of_unity, quality.linear_precision)
        print(
            f"{name:16} {n:4} {report.regularization:g}, {report.smoothness:g} "
            f"({report.limit}) {deviations(frames[1::2], found.binding)} "
            f"negative {report.negative_per_row:.4f} smallest {report.min_weight:.3f} "
            f"edits {report.edits.smooth:.2f} {report.edits.local:.2f} affine {exactness:.0e} "
            f"blocks {report.held_out_blocks.fitted.rms:.3f} "
            f"third {report.unseen_third.fitted.rms:.3f} "
            f"{seconds:5.2f} s",
            flush=True,
        )


def halves(name: str, frames: np.ndarray, binding: Binding) -> None:
    """The second half of a clip, with weights fitted to the first."""
    middle = len(frames) // 2
    found, _ = timed(binding, frames[:middle])
    print(
        f"{name:16} {binding.weights.shape[1]:4} harmonic "
        f"{deviations(frames[middle:], binding, LEAST_SQUARES)}"
        f"   fitted {deviations(frames[middle:], found.binding)}",
        flush=True,
    )


def forms(name: str, frames: np.ndarray, binding: Binding, cases: list[dict[str, int]]) -> None:
    """Held-out frames for weights of other forms."""
    for case in cases:
        found, seconds = timed(binding, frames[::2], **case)
        rms = 100 * np.sqrt(np.mean(extract(frames[1::2], found.binding).rms ** 2))
        print(
            f"{name:16} {binding.weights.shape[1]:4} {case} {rms / binding.rest.diagonal:8.4f} "
            f"roughness {found.report.roughness:.3f} floats {found.report.fixed_floats} "
            f"{seconds:5.2f} s",
            flush=True,
        )


def rank(name: str, frames: np.ndarray, binding: Binding) -> None:
    """Low rank."""
    forms(name, frames, binding, [{"rank": 10}])


def influences(name: str, frames: np.ndarray, binding: Binding) -> None:
    """Few influences."""
    forms(name, frames, binding, [{"influences": count} for count in (4, 8, 16)])


def growth(name: str, frames: np.ndarray, binding: Binding) -> None:
    """Seconds of the fit alone over the frames, and with its report."""
    for count in (25, 50, len(frames)):
        clip = frames[np.linspace(0, len(frames) - 1, count).astype(int)]
        start = time.perf_counter()
        with limit_blas_threads(1):
            fitter = Fitter(binding, jobs=JOBS)
            fitter.fit_sample(fitter.sample([Frames(clip)]), DEFAULT_STRENGTH)
        alone = time.perf_counter() - start
        _, whole = timed(binding, clip)
        m, n = binding.weights.shape
        print(f"{name:16} m {m} n {n} F {count:4} fit {alone:6.2f} s with report {whole:6.2f} s")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("data", type=Path)
    parser.add_argument("--clips", default="samba,horse-gallop,chickenCrossing")
    parser.add_argument("--cages", default="60,120")
    parser.add_argument("--tables", default=",".join(TABLES))
    options = parser.parse_args()
    tables: dict[str, Callable[[str, np.ndarray, Binding], None]] = {
        table.__name__: table for table in (errors, halves, rank, influences, growth)
    }
    clips = {}
    for name in options.clips.split(","):
        frames, rest = load(options.data / name)
        for n in options.cages.split(","):
            cage = load_mesh(str(options.data / name / f"cage_{n}.obj"))
            clips[name, n] = frames, bind(rest, cage)
    for table in options.tables.split(","):
        print(f"# {table}: {tables[table].__doc__}")
        for (name, _), (frames, binding) in clips.items():
            tables[table](name, frames, binding)


if __name__ == "__main__":
    main()
