"""How seconds and memory of a bind grow with the cage and the model: a table, and a plot of it.

python -m tests.benchmarks.growth [PLOT.png] [--accuracy preview] [--most 100000]

Every bind runs in a process of its own, so that its peak of memory is its own. Cages are wavy
spheres, models are points sampled inside them.
"""

import argparse
import json
import resource
import subprocess
import sys
import time

import numpy as np
from scipy.spatial import ConvexHull

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.harmonic import harmonic_weights

CAGES, MODELS = (60, 120, 300, 1000), (10**4, 10**5, 10**6)


def wavy(directions: np.ndarray) -> np.ndarray:
    """Radius of the cage in each direction, (k, 3)."""
    x, y, z = directions.T
    return 1 + 0.25 * np.sin(3 * x + y) * np.cos(2 * z)


def spread_directions(count: int) -> np.ndarray:
    """Evenly spread directions, (count, 3)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    across = np.sqrt(1 - z * z)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def wavy_sphere(count: int) -> TriMesh:
    """A cage of `count` vertices, evenly spread over the directions."""
    directions = spread_directions(count)
    faces = ConvexHull(directions).simplices.astype(np.int64)
    a, b, c = (directions[faces[:, i]] for i in range(3))
    inward = np.einsum("fx,fx->f", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward, ::-1]
    return TriMesh(wavy(directions)[:, None] * directions, faces)


def points_within(count: int) -> np.ndarray:
    """Points sampled inside the wavy sphere, most of them near its surface as a model's are."""
    generator = np.random.default_rng(0)
    directions = generator.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    depth = generator.uniform(0.4, 0.9, count)
    return directions * (0.85 * depth * wavy(directions))[:, None]


def measured(vertices: int, points: int, accuracy: str) -> dict[str, float]:
    """Bind in this process."""
    cage, model = wavy_sphere(vertices), points_within(points)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.perf_counter()
    weights = harmonic_weights(cage, model, accuracy)
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    beside = (peak - before) / 1024 - weights.values.nbytes / 2**20
    return {"n": vertices, "m": points, "seconds": seconds, "error": weights.error,
            "megabytes": beside, "weights": weights.values.nbytes / 2**20}  # fmt: skip


def plotted(rows: list[dict[str, float]], path: str) -> None:
    """Seconds and memory over m, a line a cage."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for marker, n in zip("os^D", CAGES, strict=True):
        own = [row for row in rows if row["n"] == n]
        for axis, what in zip(axes, ("seconds", "megabytes"), strict=True):
            values = [row[what] for row in own]
            axis.plot([row["m"] for row in own], values, marker=marker, label=f"n = {n}")
    for axis, title in zip(axes, ("seconds", "peak memory beside the weights, MB"), strict=True):
        axis.set(xscale="log", yscale="log", xlabel="points m", title=title)
        axis.grid(alpha=0.3)
    axes[0].legend(title="cage vertices")
    figure.savefig(path, dpi=110, metadata={"Software": None})


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("plot", nargs="?")
    parser.add_argument("--accuracy", default="standard")
    parser.add_argument("--most", type=int, default=max(MODELS))
    parser.add_argument("--one", nargs=2, type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measured(*options.one, options.accuracy)))
        return
    rows = []
    print(f"{'n':>5} {'m':>8} {'seconds':>8} {'MB beside H':>12} {'MB of H':>8} {'error':>8}")
    for n in CAGES:
        for m in MODELS:
            if m <= options.most:
                words = [sys.executable, "-m", "tests.benchmarks.growth", "--one", str(n), str(m)]
                words += ["--accuracy", options.accuracy]
                row = json.loads(subprocess.run(words, check=True, capture_output=True).stdout)
                rows.append(row)
                print(
                    f"{n:5} {m:8} {row['seconds']:8.2f} {row['megabytes']:12.0f} "
                    f"{row['weights']:8.0f} {row['error']:8.4f}",
                    flush=True,
                )
    if options.plot:
        plotted(rows, options.plot)


if __name__ == "__main__":
    main()
