"""Names of limbs by their place in the rest pose, and of joints in them, as `L_upper_front_02`.

Left is +x and the front is +z, as glTF has characters; if z is up, the front is −y.
"""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers

MIN_CENTRE_OFFSET = 0.5
"""A limb is at one side if its centre is so far from the middle, in halves of its own extent."""

HEIGHTS = ("lower", "middle", "upper")
"""The thirds of the model that the centre of a limb can be in."""


def name_joints(
    places: Floats, limbs: Integers, owners: Integers, rest: TriMesh, up_axis: str
) -> tuple[list[str], list[str]]:
    """Return the names of limbs, and of joints at `places`, (n, 3), numbered from the top down.

    Parameters
    ----------
    limbs : (n,) int64
        Limb of each joint.
    owners : (m,) int64
        Joint that each vertex of `rest` follows.
    """
    rest_places, joint_places = (
        _turn_upright(rest.vertices, up_axis),
        _turn_upright(places, up_axis),
    )
    used = rest.is_used
    box = np.stack([rest_places[used].min(axis=0), rest_places[used].max(axis=0)])
    limb_of_vertex = np.where(used, limbs[owners], -1)
    found = []
    for k in range(int(limbs.max()) + 1):
        points = rest_places[limb_of_vertex == k]
        found.append(_describe(points if len(points) else joint_places[limbs == k], box))
    limb_names = _tell_apart(found)
    joint_names = [""] * len(places)
    step = 1e-6 * (np.ptp(box, axis=0).max() or 1)  # ties of mirrored joints are no rounding
    across, height, depth = np.round((joint_places - box.mean(axis=0)) / step).T
    order = np.lexsort([across, np.abs(across), -depth, -height])
    for k, name in enumerate(limb_names):
        chosen = order[limbs[order] == k]
        digits = max(2, len(str(len(chosen))))
        for number, joint in enumerate(chosen, start=1):
            joint_names[joint] = f"{name}_{number:0{digits}}"
    return limb_names, joint_names


def _tell_apart(names: list[str]) -> list[str]:
    """Give the second of equal names a b, the third a c."""
    counts: dict[str, int] = {}
    found = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        found.append(name if counts[name] == 1 else f"{name}_{chr(ord('a') + counts[name] - 1)}")
    return found


def _turn_upright(points: Floats, up_axis: str) -> Floats:
    """Return points with y up, and the front at +z."""
    return points if up_axis == "Y" else points[:, [0, 2, 1]] * [1, 1, -1]


def _describe(points: Floats, box: Floats) -> str:
    """Return where points are in a box, (2, 3), in words."""
    low, high = points.min(axis=0), points.max(axis=0)
    centre, half = (low + high) / 2, (high - low) / 2
    offset = centre - box.mean(axis=0)
    is_aside = np.abs(offset) > MIN_CENTRE_OFFSET * half
    share = (centre[1] - box[0, 1]) / (np.ptp(box[:, 1]) or 1)
    words = [HEIGHTS[int(np.clip(3 * share, 0, 2))]]
    if is_aside[0]:
        words.insert(0, "L" if offset[0] > 0 else "R")
    if is_aside[2]:
        words.append("front" if offset[2] > 0 else "back")
    return "_".join(words)
