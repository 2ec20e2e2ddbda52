"""The data of a player as one text, for the script of a page; large models are drawn coarser."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.coordinates.binding import Binding
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.posing.poser import DEFAULT_POSE_ALPHA
from cageik_cli.report.player.clip import PlayerClip, find_mirror
from cageik_cli.report.player.compression import (
    Predictor,
    RoundedWeights,
    find_smooth_motions,
    pack_arrays,
    round_weights,
)
from cageik_cli.report.render.shading import COLOUR_SCALE, MESH_COLOURS, choose_scale_end
from cageik_cli.util.arrays import Floats, Integers

MAX_DRAWN_VERTICES = 50_000
"""A larger model is decimated."""

MAX_WEIGHTS = 1 << 24
"""Weights of a page at most; a model of more in its cage is decimated, too."""

MAX_INT16 = 32_767
"""The largest integer that steps of lengths are stored as."""


def build_payload(clip: PlayerClip, apply_url: str = "") -> str:
    """Build the data of a player.

    Lengths are in diagonals of the rest model, and positions relative to the middle of its cage, so
    that single precision is enough anywhere. The page sends its handles to `apply_url` when they
    are applied; if it is "", they are only saved. The text is as of `pack_arrays`.
    """
    rest, cage = clip.binding.rest, clip.binding.cage
    diagonal, origin = rest.diagonal or 1.0, cage.vertices.mean(axis=0)
    chosen, faces = choose_vertices(clip.binding)
    rounded = round_weights(clip.binding.weights[chosen], find_smooth_motions(cage))
    arrays: dict[str, NDArray[Any]] = {
        "faces": faces.astype("<u4"),
        "cageFaces": cage.faces.astype("<u4"),
        # By column: neighbouring numbers are then alike, and pack better.
        "weights": np.ascontiguousarray(rounded.integers.T).astype("<i2"),
        "smooth": np.ascontiguousarray(rounded.motions.T).astype("<f4"),
        "rests": np.ascontiguousarray(rounded.rests.T),
        "cage": _scale((cage.vertices - origin) / diagonal),
        # By coordinate, for the same reason.
        "cages": _scale(_round_cages((clip.cages - origin) / diagonal)).T,
        # Positions are relative to the origin, and turning about it moves nothing else.
        "rotations": clip.rotations.astype("<f4"),
    }
    header = {
        "schema": 1,
        "origin": origin.tolist(),
        "diagonal": diagonal,
        "levels": rounded.levels,
        "restStep": rounded.rest_step,
        "vertexCount": len(rest.vertices),
        "isClip": bool(clip.frames),
        "frames": list(clip.frames),
        "skipped": list(clip.skipped),
        "fps": clip.fps,
        "up": clip.up_axis,
        "focus": _list_focus(clip, chosen),
        "mirror": _list_mirror(clip),
        "colours": list(COLOUR_SCALE),
        "missing": MESH_COLOURS["missing"],
        "alpha": DEFAULT_POSE_ALPHA,
        "rigidity": 10,  # rounds that the page offers first
        "target": clip.target,
        "applyUrl": apply_url,
    }
    base = (clip.base[chosen] - origin) / diagonal
    header |= _add_base(base, rounded, (cage.vertices - origin) / diagonal, arrays)
    if len(chosen) < len(rest.vertices):
        arrays["vertices"] = chosen.astype("<u4")
    header |= _add_errors(clip, chosen, arrays)
    # These are smooth over the surface, and stored as differences from a prediction.
    header["predicted"] = [name for name in ("weights", "held") if name in arrays]
    predictor = Predictor(faces, len(chosen))
    for name in header["predicted"]:
        arrays[name] = predictor.encode(arrays[name])
    return pack_arrays(header, arrays)


def choose_vertices(binding: Binding) -> tuple[Integers, Integers]:
    """Choose the vertices that are drawn, and faces between them: all, unless there are too many.

    They are returned as by `decimate`.
    """
    rest, count = binding.rest, len(binding.rest.vertices)
    largest = min(MAX_DRAWN_VERTICES, MAX_WEIGHTS // len(binding.cage.vertices))
    if count <= largest:
        return np.arange(count), rest.faces
    return decimate(rest, largest)


def decimate(mesh: TriMesh, max_vertices: int) -> tuple[Integers, Integers]:
    """Keep at most `max_vertices` vertices of a mesh, one per cell of a grid.

    Vertices are not moved, so that weights of the mesh are weights of the coarse one. Faces of
    which two corners fall together are left out. Vertices that no face uses are left out too.

    Returns
    -------
    vertices : (k,) int64
        Their numbers in the mesh, ascending.
    faces : (t, 3) int64
        Indices into `vertices`.
    """
    used = np.unique(mesh.faces)
    if len(used) <= max_vertices:
        return used, np.searchsorted(used, mesh.faces)
    points = mesh.vertices[used]
    points = (points - points.min(axis=0)) / (mesh.diagonal or 1.0)
    size = 1 / np.sqrt(max_vertices)  # too small: a surface of m cells of this size is that large
    cells = _find_cells(points, size)
    while cells.max() >= max_vertices:
        size *= 1.1
        cells = _find_cells(points, size)
    chosen = _choose_vertices(points, cells)
    corners = cells[np.searchsorted(used, mesh.faces)]
    is_kept = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    # Faces are turned so that the smallest corner is first: the same face is then kept once.
    kept = corners[is_kept]
    turned = np.take_along_axis(kept, (kept.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    order = np.argsort(used[chosen])
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    return used[chosen[order]], number[np.unique(turned, axis=0)].reshape(-1, 3)


def _find_cells(points: Floats, size: float) -> Integers:
    """Return the number of each point's cell, counted from 0 without gaps."""
    places = np.floor(points / size).astype(np.int64)
    width = places.max() + 1
    keys = (places[:, 0] * width + places[:, 1]) * width + places[:, 2]
    return np.asarray(np.unique(keys, return_inverse=True)[1].reshape(-1))


def _choose_vertices(points: Floats, cells: Integers) -> Integers:
    """Return the point of each cell that is closest to the mean of its points."""
    counts = np.bincount(cells)
    means = np.stack([np.bincount(cells, weights=axis) for axis in points.T], axis=1)
    distances = np.linalg.norm(points - (means / counts[:, None])[cells], axis=1)
    order = np.lexsort((distances, cells))
    return np.asarray(order[np.searchsorted(cells[order], np.arange(len(counts)))])


def _round_cages(cages: Floats, step: float = 2.0**-20) -> Floats:
    """Round to a power of two of a diagonal: the last bits of numbers are then zero."""
    return np.rint(cages / step) * step


def _scale(values: Floats, largest: float = 1e30) -> NDArray[np.float32]:
    """Draw what is farther away at `largest`, in diagonals: single precision ends near."""
    return np.clip(values, -largest, largest).astype("<f4")


def _add_base(
    base: Floats, rounded: RoundedWeights, cage: Floats, arrays: dict[str, NDArray[Any]]
) -> dict[str, Any]:
    """Add what the weights of the page lack to the base mesh: little, unless they have offsets."""
    min_step = 1e-7  # diagonals, as single precision has
    lack = base - rounded.restore() @ cage
    step = max(float(np.abs(lack).max()) / MAX_INT16, min_step)
    arrays["lack"] = np.ascontiguousarray(np.rint(lack / step).T).astype("<i2")
    return {"lackStep": step}


def _add_errors(
    clip: PlayerClip, chosen: Integers, arrays: dict[str, NDArray[Any]]
) -> dict[str, Any]:
    """Add the errors over the clip and of held frames to the arrays; return their scales."""
    missing_level, min_step = 0xFFFF, 1e-5
    scales: dict[str, Any] = {"held": [], "rms": None}
    if clip.vertex_rms is not None:
        rms = clip.vertex_rms[chosen]
        is_known = np.isfinite(rms)
        top = float(rms[is_known].max(initial=0.0)) or 1.0
        levels = np.full(len(rms), missing_level, "<u2")
        levels[is_known] = np.rint(rms[is_known] / top * (missing_level - 1))
        arrays["rms"] = levels
        scales["rms"] = {"top": top, "end": choose_scale_end(rms[is_known])}
    if clip.held:
        # Vertices that are missing in a frame have no error there.
        errors = np.nan_to_num(np.stack([errors[chosen] for _, errors in clip.held.values()]))
        step = max(float(np.abs(errors).max()) / MAX_INT16, min_step)
        # By coordinate, for the same reason as weights by column.
        arrays["held"] = np.rint(errors / step).transpose(0, 2, 1).astype("<i2")
        scales["held"] = [
            {"frame": frame, "label": label} for frame, (label, _) in clip.held.items()
        ]
        scales["heldStep"] = step
        scales["deviationEnd"] = choose_scale_end(_list_deviations(clip))
    return scales


def _list_deviations(clip: PlayerClip) -> Floats:
    """Return the deviations of all held frames, percent of the diagonal; none of missing data."""
    found = np.concatenate(
        [100 * np.linalg.norm(errors, axis=1) for _, errors in clip.held.values()]
    )
    return np.asarray(found[np.isfinite(found)])


def _list_focus(clip: PlayerClip, chosen: Integers) -> dict[str, Any] | None:
    """List where the worst region is; its vertex is the nearest of those that are drawn."""
    if clip.focus is None:
        return None
    rest = clip.binding.rest.vertices
    nearest = np.linalg.norm(rest[chosen] - rest[clip.focus["vertex"]], axis=1).argmin()
    return clip.focus | {"vertex": int(nearest)}


def _list_mirror(clip: PlayerClip) -> dict[str, Any] | None:
    mirror = find_mirror(clip.binding)
    if mirror is None:
        return None
    return {"normal": mirror.normal.tolist(), "point": mirror.point.tolist()}
