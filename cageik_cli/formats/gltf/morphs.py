"""A mesh animation as glTF: the rest pose, few morph targets, and a track of their weights."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.base.writers import Animation, choose_short_names, to_float32
from cageik_cli.formats.gltf.file import (
    MAX_GLB_BYTES,
    GlbWriter,
    Singles,
    VectorSpool,
    describe_excess,
)
from cageik_cli.formats.gltf.nodes import choose_spaces, make_part_nodes, place_node
from cageik_cli.formats.gltf.surface import Primitive, cut_surface
from cageik_cli.util.arrays import Floats, spread_evenly
from cageik_cli.util.errors import OutputError
from cageik_cli.util.messages import say
from cageik_cli.util.text import format_count, group_digits
from cageik_cli.util.threads import limit_blas_threads

EXACT_TOL = 1e-6
"""Of the diagonal: errors below this are rounding in single precision."""

MAX_SAMPLED_FRAMES = 1024
"""Frames of which the singular vectors are taken, at most; spread over the animation."""

MAX_PRODUCT_BYTES = 1 << 28
"""Bytes of the products of all frames with those, at most."""

RANK_TOL = 1e-14
"""Squares of singular values below this share of the largest are rounding."""


@dataclass(frozen=True, eq=False)
class Modes:
    """The mean of F frames of displacements D, (F, 3 m), and K - 1 singular vectors around it.

    The first target has weight one in all frames: what it holds makes the weights of the others
    begin at zero. Programs with sliders, such as Blender, cut off weights below zero or above one.

    Attributes
    ----------
    sums : (K - 1, F) float64
        Singular vectors are `sums @ D`, the strongest first.
    loads : (F, K - 1) float64
        Frames are nearly the mean plus `loads` times the vectors.
    residuals : (K,) float64
        Sum of the squares that the mean and the first k vectors leave.
    """

    sums: Floats
    loads: Floats
    residuals: Floats

    @property
    def count(self) -> int:
        """The number of targets, K."""
        return len(self.residuals)

    def truncate(self, count: int) -> "Modes":
        """Return the modes of the first `count` targets."""
        return Modes(self.sums[: count - 1], self.loads[:, : count - 1], self.residuals[:count])

    @cached_property
    def weights(self) -> Singles:
        """The weights of the targets, (F, K), from 0 to 1."""
        scaled = (self.loads - self._low) / self._range
        return np.insert(scaled, 0, 1, axis=1).clip(0, 1).astype(np.float32)

    def compute_targets(self, block: Floats) -> Singles:
        """Return the targets (K, b, 3) of displacements (F, 3 b)."""
        first = 1 / len(block) + self._low @ self.sums
        return _round_targets(np.vstack([first, self.sums * self._range[:, None]]) @ block)

    def fit_targets(self, block: Floats) -> Singles:
        """Return the targets (K, b, 3) nearest to vectors (F, 3 b) with these weights."""
        return _round_targets(self._inverse @ block)

    @cached_property
    def _inverse(self) -> Floats:
        return np.asarray(np.linalg.pinv(self.weights.astype(np.float64)))

    @cached_property
    def _low(self) -> Floats:
        return np.asarray(self.loads.min(axis=0))

    @cached_property
    def _range(self) -> Floats:
        return np.asarray(np.ptp(self.loads, axis=0))


def _round_targets(targets: Floats) -> Singles:
    return targets.astype(np.float32).reshape(len(targets), -1, 3)


def compute_modes(spool: VectorSpool, limit: int) -> Modes:
    """Compute the mean and singular vectors of displacements, at most `limit` targets.

    They come from the products of frames with each other, so no more than a block of vertices is
    in memory. Signs are such that the load of largest size of each vector is above zero.
    """
    frames = spool.frame_count
    count = min(frames, MAX_SAMPLED_FRAMES, max(limit, MAX_PRODUCT_BYTES // (8 * frames)))
    sampled = spread_evenly(frames, count)
    products, total, spread = np.zeros((frames, count)), 0.0, 0.0
    for _, block in spool.read_blocks(0, spool.vertex_count):
        total += float(np.einsum("fc,fc->", block, block))
        block -= block.mean(axis=0)
        spread += float(np.einsum("fc,fc->", block, block))
        products += block @ block[sampled].T
    values, vectors = np.linalg.eigh(products[sampled])
    kept = min(int((values > RANK_TOL * total).sum()), limit - 1)
    values, vectors = values[::-1][:kept], vectors[:, ::-1][:, :kept]
    vectors = vectors / np.sqrt(values)
    loads = products @ vectors
    signs = np.sign(loads[np.abs(loads).argmax(axis=0), np.arange(kept)])
    sums = np.zeros((kept, frames))
    sums[:, sampled] = (vectors * signs).T
    sums -= sums.mean(axis=1, keepdims=True)  # of displacements from their mean
    residuals = spread - np.concatenate([[0], np.cumsum(np.square(loads).sum(axis=0))])
    return Modes(sums, loads * signs, np.maximum(residuals, 0))


def measure_modes(spool: VectorSpool, modes: Modes) -> tuple[float, float]:
    """Measure what the modes leave, with targets and weights as they are written.

    Returns
    -------
    rms, largest : float
        Of the distances of the morphed vertices from the frames, in the unit of the frames.
    """
    weights = modes.weights.astype(np.float64)
    squares, largest = 0.0, 0.0
    for _, block in spool.read_blocks(0, spool.vertex_count):
        targets = modes.compute_targets(block).astype(np.float64)
        misses = block - weights @ targets.reshape(len(targets), -1)
        distances = np.square(misses).reshape(len(block), -1, 3).sum(axis=2)
        squares += float(distances.sum())
        largest = max(largest, float(distances.max()))
    count = spool.frame_count * spool.vertex_count
    return float(np.sqrt(squares / count)), float(np.sqrt(largest))


def choose_modes(
    spool: VectorSpool, modes: Modes, tolerance: float
) -> tuple[Modes, tuple[float, float]]:
    """Choose the fewest targets whose largest error is at most `tolerance`, or all.

    The rms error, which is known for any number, is a lower bound; between it and all modes the
    number is found by bisection.

    Their errors are returned as of `measure_modes`.
    """
    rms, largest = measure_modes(spool, modes)
    if largest > tolerance:
        return modes, (rms, largest)
    count = spool.frame_count * spool.vertex_count
    enough = np.flatnonzero(modes.residuals <= count * tolerance**2)
    high = modes.count
    low = 1 + int(enough[0]) if len(enough) else high
    while low < high:
        middle = (low + high) // 2
        found_rms, found_largest = measure_modes(spool, modes.truncate(middle))
        if found_largest <= tolerance:
            high, rms, largest = middle, found_rms, found_largest
        else:
            low = middle + 1
    return modes.truncate(high), (rms, largest)


class Writer(GlbWriter):
    """The rest pose plus weights times morph targets is each frame, to an error that is noted.

    The targets are the singular vectors of the displacements from the rest pose, in float32. The
    track has their weights at the times of the frames, from 0 s on, linear between. Normals are
    those of the rest pose, and targets of normals that are fitted to the frames' by least squares.
    """

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        self._settings = animation.morphs
        self._surface = cut_surface(animation.rest, self._settings.has_normals)
        # Too large with as many targets as are allowed, if that is known.
        settings = self._settings
        least = 1 if settings.tolerance is not None else settings.limit
        count = 1 + min(least, self._animation.frame_count)
        size = 12 * count * len(self._surface.origins) * (2 if settings.has_normals else 1)
        if size > MAX_GLB_BYTES:
            raise OutputError(describe_excess(size))
        self._rest = to_float32(animation.rest.vertices).astype(np.float64)
        self._parts = animation.split()
        self._spaces = choose_spaces(self._parts)
        self._rest_normals = self._surface.compute_normals(self._rest)
        self._moves, self._turns = self.open_file(len(self._surface.origins), spool_count=2)

    def append(self, frames: Floats) -> None:
        """Keep the next frames."""
        origins = self._surface.origins
        for positions in frames:
            self._moves.append(to_float32(positions - self._rest)[origins])
            if self._settings.has_normals:
                turns = self._surface.compute_normals(positions) - self._rest_normals
                self._turns.append(turns.astype(np.float32))

    def complete(self) -> None:
        """Compute the targets, and compose the file."""
        with limit_blas_threads(1):  # the last digits depend on how many
            modes, rms, largest = self._choose_modes()
            primitives = [self._write_primitive(each, modes) for each in self._surface.primitives]
        self._compose(primitives, modes, rms, largest)
        self._open.close()

    def _choose_modes(self) -> tuple[Modes, float, float]:
        """Return the targets and their errors, rms and largest, in percent of the diagonal.

        They are noted; an error above the tolerance is refused.
        """
        settings, unit = self._settings, self._animation.rest.diagonal / 100
        exact = 100 * EXACT_TOL
        wanted = exact if settings.tolerance is None else settings.tolerance
        modes = compute_modes(self._moves, settings.limit)
        modes, errors = choose_modes(self._moves, modes, wanted * unit)
        rms, largest = (error / unit for error in errors)
        text = format_count(modes.count, "morph target")
        if settings.tolerance is not None and largest > settings.tolerance:
            raise OutputError(
                f"{text} leave a largest error of {largest:.2g} % of the diagonal, above the "
                f"tolerance of {settings.tolerance:g} %; "
                + say("give a higher `tolerance=`")
                + ("" if settings.morphs is None else say(" or a higher `morphs=`"))
                + ", or write .usdc, .abc or .pc2"
            )
        quality = f"error: rms {rms:.2g}, largest {largest:.2g} % of the diagonal"
        if largest <= exact:
            quality = "exact to single precision"
        self.notes += (f"{text}; {quality}",)
        whole, written = len(self._rest), len(self._surface.origins)
        if written != whole:
            split = "split where texture coordinates, normals or materials differ"
            self.notes += (f"{group_digits(whole)} vertices are {written} in the file, {split}",)
        return modes, rms, largest

    def _write_primitive(self, part: Primitive, modes: Modes) -> Any:
        """Write the vertices, targets and triangles of one primitive, and return it."""
        import pygltflib as gltf

        count, space = part.stop - part.start, self._spaces[part.part]
        places = space.take_positions(self._rest[self._surface.origins[part.start : part.stop]])
        normals, turns = space.take_normals(self._rest_normals[part.start : part.stop])
        kinds: dict[str, tuple[Any, Floats, Any]] = {
            "POSITION": (
                self._moves,
                places,
                lambda first, block: space.take_moves(modes.compute_targets(block).astype(float)),
            )
        }
        if self._settings.has_normals:
            kinds["NORMAL"] = (
                self._turns,
                normals,
                lambda first, block: _turn(modes.fit_targets(block), turns[first:]),
            )
        attributes, targets = {}, []
        for name, (spool, base, compute) in kinds.items():
            is_place = name == "POSITION"
            rows = base.astype(np.float32)
            attributes[name] = self._file.add_array(rows, gltf.ARRAY_BUFFER, bounds=is_place)
            written = self._file.reserve_targets(modes.count, count)
            for first, block in spool.read_blocks(part.start, part.stop):
                vectors = compute(first - part.start, block).astype(np.float32)
                self._file.write_targets(written, first - part.start, vectors)
            targets.append(self._file.add_targets(written, bounds=is_place))
        primitive = self._surface.write_primitive(self._file, part, attributes)
        primitive.targets = [
            gltf.Attributes(**dict(zip(kinds, numbers, strict=True)))
            for numbers in zip(*targets, strict=True)
        ]
        return primitive

    def _write_track(self, modes: Modes, nodes: list[int]) -> Any:
        """Write the weights of all frames, which are those of all nodes; return the animation."""
        import pygltflib as gltf

        times = self.add_times()
        weights = self._file.add_array(modes.weights.ravel())
        channels = [
            gltf.AnimationChannel(
                sampler=0, target=gltf.AnimationChannelTarget(node=node, path="weights")
            )
            for node in nodes
        ]
        sampler = gltf.AnimationSampler(input=times, output=weights)
        return self.make_animation(channels, [sampler])

    def _compose(self, primitives: list[Any], modes: Modes, rms: float, largest: float) -> None:
        """Compose a mesh and a node per part."""
        import pygltflib as gltf

        extras = {
            "targetNames": [f"morph_{k:03d}" for k in range(modes.count)],
            "cageik": {
                "morphs": modes.count,
                "rms_percent": float(f"{rms:.3g}"),
                "largest_percent": float(f"{largest:.3g}"),
            },
        }
        names = [part.name for part in self._parts]
        nodes, tops, with_meshes = make_part_nodes(names, self._spaces)
        for top in tops:
            place_node(nodes[top], self.make_node_transform())
        owners = [each.part for each in self._surface.primitives]
        meshes = [
            gltf.Mesh(
                name=name,
                primitives=[
                    each for each, owner in zip(primitives, owners, strict=True) if owner == k
                ],
                weights=[0.0] * modes.count,
                extras=extras,
            )
            for k, name in enumerate(choose_short_names(names))
        ]
        self._file.complete(
            scene=0,
            scenes=[gltf.Scene(nodes=tops)],
            nodes=nodes,
            meshes=meshes,
            materials=self._surface.make_materials(),
            animations=[self._write_track(modes, with_meshes)],
        )


def _turn(vectors: Singles, turns: Floats) -> Floats:
    """Turn vectors (K, b, 3) at the first b of some vertices by their matrices (k, 3, 3)."""
    return np.asarray(np.einsum("nka,kab->nkb", vectors, turns[: vectors.shape[1]]))
