"""How tight, quick and stable built cages of simple shapes are.

    python -m tests.benchmarks.simple_shapes [table | stable | pieces] [NAME,...] [COUNT,...]

`table` prints one line per shape and number of vertices: the verdict of `check`, the volume of the
cage over that of the shape, the smallest angle, the largest valence, the smallest of the largest
weights of the vertices, seconds of processor, and what share of the faces of a cage with quads is
quads, with its volume. `stable` builds a cage of each shape once more after six changes, and prints
the largest distance between the cages, over the diagonal; and in brackets, where that is less, from
the cage after a turn or a reflection that leaves the vertices of the shape where they are. `pieces`
prints, of models in many pieces, whose shells are full of holes or tangle: the candidates that were
tried, the shell that was taken, its smallest angle, and seconds of processor.
"""

import sys
from itertools import permutations, product
from time import process_time

import numpy as np
from scipy.spatial import cKDTree

from cageik_cli.cages.builder.build import build_cage
from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.open import load_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.harmonic import harmonic_weights
from tests.cages.torture import PIECES, grid_faces, hand, helix, spikes, torus
from tests.shapes import ball, box, changed, concave, finer, merged


def revolve(profile, across=32):
    """Turn a polyline of (radius, height), from pole to pole, around the z axis."""
    profile = np.asarray(profile, float)
    rings, turn = profile[1:-1], 2 * np.pi * np.arange(across) / across
    radius, height = rings.T
    points = np.stack(
        [
            np.outer(np.cos(turn), radius),
            np.outer(np.sin(turn), radius),
            np.broadcast_to(height, (across, len(rings))),
        ],
        axis=-1,
    ).reshape(-1, 3)
    count, first = len(points), np.arange(across) * len(rings)
    following, last = np.roll(first, -1), first + len(rings) - 1
    below = np.stack([np.full(across, count), following, first], axis=1)
    above = np.stack([np.full(across, count + 1), last, np.roll(last, -1)], axis=1)
    points = np.concatenate([points, [[0, 0, profile[0, 1]], [0, 0, profile[-1, 1]]]])
    mesh = TriMesh(
        points, np.concatenate([grid_faces(across, len(rings), (True, False)), below, above])
    )
    return mesh if mesh.volume > 0 else mesh.flip()


def capsule():
    """A rod of radius 0.5 and length 2 with half balls at its ends."""
    turn = np.linspace(-np.pi / 2, 0, 13)
    low = [(0.5 * np.cos(t), -1 + 0.5 * np.sin(t)) for t in turn]
    middle = [(0.5, z) for z in np.linspace(-1, 1, 10)[1:-1]]
    return revolve([*low, *middle, *((r, -z) for r, z in low[::-1])])


def cylinder():
    """A rod of radius 0.5 and length 2 with flat ends."""
    radii = (0.125, 0.25, 0.375, 0.5)
    side = [(0.5, z) for z in np.linspace(-1, 1, 17)[1:-1]]
    return revolve(
        [(0, -1), *((r, -1) for r in radii), *side, *((r, 1) for r in radii[::-1]), (0, 1)]
    )


def cone():
    """A cone of radius 0.5 and height 1.5."""
    return revolve(
        [(0, 0), (0.2, 0), (0.4, 0), *((0.5 * (1 - s), 1.5 * s) for s in np.linspace(0, 1, 17))]
    )


def block(x, y, z):
    """A box of these sides."""
    mesh = finer(box(), 4)
    return changed(mesh, vertices=mesh.vertices * np.array([x, y, z]) / 2)


def tentacle():
    """A cone of length 3 that is bent by 90 degrees."""
    share = np.linspace(0, 1, 33)
    rings = zip(0.35 * (1 - share) + 0.08 * share, 3 * share, strict=True)
    mesh = revolve([(0, 0), *rings, (0, 3)], across=24)
    x, y, z = mesh.vertices.T
    radius = 6 / np.pi
    turn = z / radius
    bent = [radius - (radius - x) * np.cos(turn), y, (radius - x) * np.sin(turn)]
    return changed(mesh, vertices=np.stack(bent, axis=1))


def mug():
    """A cup with a wall of 0.08 and a handle that crosses it."""
    outer = [(0.5, z) for z in np.linspace(0, 1, 11)]
    inner = [(0.42, z) for z in np.linspace(1, 0.08, 11)]
    cup = revolve([(0, 0), (0.25, 0), *outer, *inner, (0.2, 0.08), (0, 0.08)])
    ring = torus(0.28, 0.06, 40, 12)
    handle = changed(ring, vertices=ring.vertices[:, [0, 2, 1]] + [0.55, 0, 0.5])
    return merged(cup, handle if handle.volume > 0 else handle.flip())


def stretched(x, y, z):
    """An ellipsoid with these axes."""
    return changed(ball(4), vertices=ball(4).vertices * [x, y, z])


SHAPES = {
    "capsule": capsule,
    "cylinder": cylinder,
    "cone": cone,
    "box 1 × 1 × 1": lambda: block(1, 1, 1),
    "box 1 × 2 × 3": lambda: block(1, 2, 3),
    "box 1 × 1 × 10": lambda: block(1, 1, 10),
    "ball": lambda: ball(4),
    "ellipsoid 1 × 2 × 5": lambda: stretched(1, 2, 5),
    "torus": lambda: torus(1.0, 0.3, 40, 16),
    "mug": mug,
    "tentacle": tentacle,
    "thick sheet": lambda: block(2, 1.4, 0.08),
}

MORE_SHAPES = {
    "concave": lambda: finer(concave(), 2),
    "hand": hand,
    "helix": helix,
    "spikes": spikes,
    "box 2 × 3 × 7": lambda: block(2, 3, 7),
    "ellipsoid 2 × 3 × 4": lambda: stretched(2, 3, 4),
    "thin torus": lambda: torus(1.0, 0.15, 48, 12),
    "walker": lambda: load_mesh("data_fixtures/walker/frames/walker_1.obj").mesh,
}
"""Shapes that the stability is measured on beside the others."""


def print_table(names, counts):
    """Print the lines of `table`."""
    for name in names:
        for count in counts:
            print_row(name, SHAPES[name](), count)


def print_row(name, model, count):
    """Build a cage with triangles and one with quads, and print what they are like."""
    start = process_time()
    built = build_cage(model, BuildSettings(count))
    seconds = process_time() - start
    cage, verdict = built.cage, built.chosen.verdict
    weight = harmonic_weights(cage, model.vertices, "preview").values.max(axis=0).min()
    quads = build_cage(model, BuildSettings(count, quads=True)).cage
    share = (quads.polygons.corner_counts == 4).mean()
    print(
        f"| {name} | {count} | {diagnose(cage, model).verdict} | {cage.volume / model.volume:.2f} "
        f"| {verdict.smallest_angle:.0f} | {verdict.largest_valence} | {weight:.2f} "
        f"| {seconds:.1f} | {100 * share:.0f} %, {quads.volume / model.volume:.2f}, "
        f"{diagnose(quads, model).verdict} |",
        flush=True,
    )


def print_pieces(names, counts):
    """Print the lines of `pieces`."""
    for name, count in product(names, counts):
        model, start = PIECES[name](), process_time()
        built = build_cage(model, BuildSettings(count))
        print(
            f"| {name} | {len(model.vertices)} | {count} | {len(built.candidates)} "
            f"| {built.chosen.recipe} | {built.chosen.verdict.smallest_angle:.0f} "
            f"| {process_time() - start:.1f} |",
            flush=True,
        )


def list_changes(model):
    """The six changes: a name, the changed model, and what brings its cage back."""
    generator = np.random.default_rng(1)
    order = generator.permutation(len(model.vertices))
    faces = np.argsort(order)[model.faces][generator.permutation(len(model.faces))]
    cycle = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    step = model.diagonal * np.array([1.85, -1.11, 0.74])
    single = model.vertices.astype(np.float32).astype(float)
    return (
        ("order", TriMesh(model.vertices[order], faces), lambda v: v),
        ("single precision", TriMesh(single, model.faces), lambda v: v),
        ("moved", TriMesh(model.vertices + step, model.faces), lambda v: v - step),
        ("axes swapped", TriMesh(model.vertices @ cycle.T, model.faces), lambda v: v @ cycle),
        ("turned by 90°", TriMesh(model.vertices @ turn.T, model.faces), lambda v: v @ turn),
        ("scaled", TriMesh(0.01 * model.vertices, model.faces), lambda v: 100 * v),
    )


def list_symmetries(model):
    """The permutations and signs of the axes that bring the vertices onto themselves."""
    centre = model.vertices.min(axis=0) / 2 + model.vertices.max(axis=0) / 2
    points = model.vertices - centre
    tree = cKDTree(points)
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        turn = np.eye(3)[list(order)] * signs
        if tree.query(points @ turn)[0].max() < 1e-6 * model.diagonal:
            found.append(lambda v, turn=turn: (v - centre) @ turn + centre)
    return found  # the first changes nothing


def measure_apart(first, second):
    """The largest distance of a point of either set from the other."""
    return max(cKDTree(a).query(b)[0].max() for a, b in ((first, second), (second, first)))


def print_stability(names, counts):
    """Print the lines of `stable`."""
    print("| shape | n | " + " | ".join(name for name, *_ in list_changes(box())) + " |")
    for name in names:
        model = (SHAPES | MORE_SHAPES)[name]()
        symmetries = list_symmetries(model)
        for count in counts:
            first = build_cage(model, BuildSettings(count)).cage.vertices
            print(f"| {name} | {count}", end="", flush=True)
            for _, other, bring_back in list_changes(model):
                second = bring_back(build_cage(other, BuildSettings(count)).cage.vertices)
                plain, *others = (
                    measure_apart(first, move(second)) / model.diagonal for move in symmetries
                )
                least = min(others, default=plain)
                bracket = f" ({least:.0e})" if least < 0.5 * plain else ""
                print(f" | {plain:.0e}{bracket}", end="", flush=True)
            print(" |", flush=True)


if __name__ == "__main__":
    what, *rest = [*sys.argv[1:], "table"][: max(1, len(sys.argv) - 1)]
    known = {"table": SHAPES, "stable": SHAPES | MORE_SHAPES, "pieces": PIECES}[what]
    wanted = rest[0].split(",") if rest else list(known)
    sizes = [int(c) for c in rest[1].split(",")] if len(rest) > 1 else [30, 60, 100]
    {"table": print_table, "stable": print_stability, "pieces": print_pieces}[what](wanted, sizes)
