"""How many damaged cages come back fit, and how far their vertices moved.

    python -m tests.benchmarks.cage_damage MODEL CAGE [CAGE ...]

prints one line for each damage of each cage, and a table in the end.
"""

import sys
from pathlib import Path
from time import perf_counter

import numpy as np

from cageik_cli.cages.repair.repair import repair_cage
from cageik_cli.formats.open import load_mesh
from tests.cages.damage import DAMAGES


def measure(cage, model, damage, seed=0):
    """Damage and repair one cage: whether it is fit, and its moves in percent of the diagonal."""
    damaged = damage(cage, np.random.default_rng(seed))
    start = perf_counter()
    repaired = repair_cage(damaged, model)
    moves = 100 * np.linalg.norm(repaired.moves, axis=1) / model.diagonal
    return {
        "fit": repaired.is_fit,
        "moved": float(np.mean(moves > 0)),
        "mean": float(moves[moves > 0].mean()) if (moves > 0).any() else 0.0,
        "max": float(moves.max()),
        "seconds": perf_counter() - start,
        "left": [fault.kind for fault in repaired.faults],
        "kept": len(repaired.mesh.vertices) / len(cage.vertices),
    }


def main(model_path, *cage_paths):
    """Print the lines and the table."""
    model = load_mesh(Path(model_path)).mesh
    rows = {damage.__name__: [] for damage in DAMAGES}
    for path in cage_paths:
        for damage in DAMAGES:
            row = measure(load_mesh(Path(path)).mesh, model, damage)
            rows[damage.__name__].append(row)
            print(Path(path).name, damage.__name__, row, flush=True)
    print_table(rows)


def print_table(rows):
    """One line for each damage: over all cages."""
    print("| damage | fit | vertices moved | mean move | largest move |\n|---|---|---|---|---|")
    for name, results in rows.items():
        fit = sum(row["fit"] for row in results)
        moved, mean, largest = ([row[key] for row in results] for key in ("moved", "mean", "max"))
        print(
            f"| {name.replace('_', ' ')} | {fit} of {len(results)} | {100 * np.mean(moved):.0f} % "
            f"| {np.mean(mean):.2f} % | {max(largest):.2f} % |"
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
