"""How long a move of the anchors takes over the size of the model: a table, and a plot of it.

python -m tests.benchmarks.latency [PLOT.png] [--most 1000000]

One thread, medians of 1000 moves. The cage's time does not depend on the model.
"""

import argparse

from cageik_cli.method.pose.poser import Poser
from cageik_cli.util.threads import limit_blas_threads
from tests.benchmarks.drags import median_seconds, moves_of, spread_anchors, synthetic

VERTICES, ANCHORS, MOVES = 100, 8, 1000
MODELS = (10**3, 3 * 10**3, 10**4, 3 * 10**4, 10**5, 3 * 10**5, 10**6)


def measured(points: int) -> dict[str, float]:
    """Microseconds of the cage, of cage and mesh, and of a cage whose cells turn."""
    binding = synthetic(VERTICES, points)
    poser = Poser(binding, spread_anchors(binding, ANCHORS), hold=False)
    moves = moves_of(MOVES, ANCHORS)
    poser.solve_mesh(moves[0])
    return {
        "m": points,
        "cage": 1e6 * median_seconds(moves, poser.solve_cage),
        "both": 1e6 * median_seconds(moves, lambda t: (poser.solve_cage(t), poser.solve_mesh(t))),
        "turning": 1e6 * median_seconds(moves, lambda t: poser.solve_cage(t, 10)),
    }


def plotted(rows: list[dict[str, float]], path: str) -> None:
    """Microseconds over m."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(5.4, 3.6), layout="constrained")
    labels = {"turning": "cage, rigidity 10", "both": "cage and mesh", "cage": "cage"}
    for marker, (name, label) in zip("^so", labels.items(), strict=True):
        values = [row[name] for row in rows]
        axis.plot([row["m"] for row in rows], values, marker=marker, label=label)
    axis.set(
        xscale="log", yscale="log", xlabel="vertices of the model, m",
        title=f"median of {MOVES} moves, µs (n = {VERTICES}, l = {ANCHORS})",
    )  # fmt: skip
    axis.set_ylim(bottom=1)
    axis.grid(alpha=0.3)
    axis.legend()
    figure.savefig(path, dpi=110, metadata={"Software": None})


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("plot", nargs="?")
    parser.add_argument("--most", type=int, default=max(MODELS))
    options = parser.parse_args()
    rows = []
    print(f"{'m':>8} {'cage, us':>9} {'and mesh, us':>13} {'rigidity 10, us':>16}")
    with limit_blas_threads(1):
        for points in MODELS:
            if points <= options.most:
                rows.append(measured(points))
                print(
                    "{m:8} {cage:9.1f} {both:13.1f} {turning:16.0f}".format(**rows[-1]), flush=True
                )
    if options.plot:
        plotted(rows, options.plot)


if __name__ == "__main__":
    main()
