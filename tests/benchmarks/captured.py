"""What captured clips lose: spoilt frames of a real clip against the clean ones, with rivals.

python -m tests.benchmarks.captured DATA [--clip samba] [--cage 120] [--cases noise,all] [--hidden]

DATA holds a folder per clip with CLIP.h5 (`verts`, `tris`) and cage_N.obj. Errors are to the clean
frames, as multiples of the clean run's; so are accelerations of the cages. Rivals filter the
vertices, or the cages of the plain solve, over time; frames without data are interpolated first.
With --hidden, one piece is hidden for 5, 20 and 60 frames, and in all.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
from scipy.signal import savgol_filter
from scipy.spatial import cKDTree

from tests.corruptions import CORRUPTIONS, corrupt

HIDDEN_SHARE = 0.21
OURS = ("--robust", "--smooth", "auto", "--missing", "--fill-gaps")
FPS = 24.0


def fill_over_time(values: np.ndarray) -> np.ndarray:
    """Interpolate what is nan linearly over the frames."""
    flat = values.reshape(len(values), -1).copy()
    for column in flat.T:
        known = np.flatnonzero(~np.isnan(column))
        if len(known) < len(column):
            column[:] = np.interp(np.arange(len(column)), known, column[known])
    return flat.reshape(values.shape)


def savitzky_golay(values: np.ndarray) -> np.ndarray:
    return savgol_filter(values, 7, 3, axis=0)


def one_euro(values: np.ndarray, cutoff: float = 1.0, slope: float = 5.0) -> np.ndarray:
    """Casiez, Roussel and Vogel 2012."""
    share = lambda rate: 1 / (1 + FPS / (2 * np.pi * rate))  # noqa: E731
    found, speed = values.copy(), np.zeros_like(values[0])
    for k in range(1, len(values)):
        speed += share(1.0) * ((values[k] - found[k - 1]) * FPS - speed)
        rate = share(cutoff + slope * np.abs(speed))
        found[k] = found[k - 1] + rate * (values[k] - found[k - 1])
    return found


def call(*words: object) -> None:
    """Run a command of cageik."""
    subprocess.run([sys.executable, "-m", "cageik_cli", *map(str, words), "-q"], check=True)


def run(frames: np.ndarray, faces: np.ndarray, folder: Path, *options: str):
    """Cages of an extraction, and seconds of its stages that are not read and write."""
    np.savez(folder / "clip.npz", verts=frames, faces=faces)
    words = ["--binding", folder / "binding.h5", "-o", folder / "cages.h5", "--overwrite"]
    words += ["--timings", folder / "seconds.json", "--rest", folder / "rest.obj"]
    call("extract", folder / "clip.npz", *words, *options)
    stages = json.loads((folder / "seconds.json").read_text())
    with h5py.File(folder / "cages.h5") as file:
        return file["verts"][:], sum(stages.get(name, 0) for name in ("solve", "smooth"))


def measure(weights: np.ndarray, cages: np.ndarray, frames: np.ndarray) -> np.ndarray:
    return np.array(
        [((weights @ c - v) ** 2).sum(axis=1).mean() for c, v in zip(cages, frames, strict=True)]
    )


def table(frames: np.ndarray, faces: np.ndarray, folder: Path, cases: list[str]) -> None:
    """Print a line per case and method."""
    bend = lambda cages: np.sqrt((np.diff(cages, 2, axis=0) ** 2).mean())  # noqa: E731
    with h5py.File(folder / "binding.h5") as file:
        weights = file["weights"][:]
    size = np.linalg.norm(np.ptp(frames[0], axis=0))
    clean, seconds = run(frames, faces, folder)
    base, still = measure(weights, clean, frames), bend(clean)
    print(f"clean, plain: {100 * np.sqrt(base.mean()) / size:.4f} %, {seconds:.2f} s")
    for case in cases:
        spoilt = frames if case == "clean" else corrupt(case, frames, 1)
        lost = np.isnan(spoilt).all(axis=(1, 2))
        whole = fill_over_time(spoilt)
        plain, took = run(whole, faces, folder)
        ours, own = run(spoilt, faces, folder, *OURS)
        methods = {
            "plain": (plain, took),
            "Savitzky-Golay, vertices": run(savitzky_golay(whole), faces, folder),
            "Savitzky-Golay, cages": (savitzky_golay(plain), took),
            "One-Euro, vertices": run(one_euro(whole), faces, folder),
            "One-Euro, cages": (one_euro(plain), took),
            "cageik": (ours, own),
        }
        for label, (cages, used) in methods.items():
            error = measure(weights, cages, frames)
            ratio = np.sqrt(error.mean() / base.mean())
            gaps = np.sqrt(error[lost].mean() / base[lost].mean()) if lost.any() else np.nan
            print(
                f"{case:9} {label:26} error {ratio:7.3f}  filled {gaps:7.3f}  "
                f"acceleration {bend(cages) / still:6.3f}  {used:6.2f} s",
                flush=True,
            )


def hide(frames: np.ndarray, count: int) -> np.ndarray:
    """Hide the piece around a vertex in so many frames in the middle; never in the first frame."""
    spoilt, size = frames.copy(), round(HIDDEN_SHARE * frames.shape[1])
    _, piece = cKDTree(frames[0]).query(frames[0][frames.shape[1] // 3], size)
    start = max(1, (len(frames) - count) // 2)
    spoilt[start : start + count, piece] = np.nan
    return spoilt


def hidden_table(frames: np.ndarray, faces: np.ndarray, folder: Path) -> None:
    """Print a line per length and per way to smooth: errors of the frames with something hidden."""
    with h5py.File(folder / "binding.h5") as file:
        weights = file["weights"][:]
    size, (clean, _) = np.linalg.norm(np.ptp(frames[0], axis=0)), run(frames, faces, folder)
    base = measure(weights, clean, frames)
    for count in (5, 20, 60, len(frames)):
        spoilt = hide(frames, count)
        is_hidden = np.isnan(spoilt[..., 0])
        some = is_hidden.any(axis=1)
        for words in (("--missing",), ("--missing", "--smooth", "auto")):
            cages, _ = run(spoilt, faces, folder, *words)
            ratio = np.sqrt(measure(weights, cages, frames)[some].mean() / base[some].mean())
            away = np.linalg.norm(np.stack([weights @ c for c in cages]) - frames, axis=2)
            own, most = np.sqrt((away[is_hidden] ** 2).mean()), away[is_hidden].max()
            print(
                f"hidden {some.sum():3} {' '.join(words):24} error {ratio:6.3f}  hidden vertices "
                f"{100 * own / size:6.2f} %, at most {100 * most / size:6.2f} %",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--clip", default="samba")
    parser.add_argument("--cage", default="120")
    parser.add_argument("--cases", default=",".join(["clean", *(c.name for c in CORRUPTIONS)]))
    parser.add_argument("--weights", default="harmonic,fitted")
    parser.add_argument("--hidden", action="store_true")
    options = parser.parse_args()
    folder = options.data / options.clip
    with h5py.File(folder / f"{options.clip}.h5") as file:
        frames, faces = file["verts"][:].astype(float), file["tris"][:].astype(np.int64)
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        np.savez(work / "clean.npz", verts=frames, faces=faces)
        lines = ["v {!r} {!r} {!r}".format(*vertex) for vertex in frames[0].tolist()]
        lines += ["f {} {} {}".format(*corners) for corners in (faces + 1).tolist()]
        (work / "rest.obj").write_text("\n".join(lines) + "\n")
        cage = folder / f"cage_{options.cage}.obj"
        words = ["--cage", cage, "--rest", work / "rest.obj", "-o", work / "binding.h5"]
        for kind in options.weights.split(","):
            fit = ["--fit", work / "clean.npz"] if kind == "fitted" else []
            call("bind", *words, *fit, "--overwrite")
            print(f"== {options.clip}, {options.cage} cage vertices, {kind} weights")
            if options.hidden:
                hidden_table(frames, faces, work)
            else:
                table(frames, faces, work, options.cases.split(","))


if __name__ == "__main__":
    main()
