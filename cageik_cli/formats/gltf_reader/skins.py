"""Skins: joints, and how much each of them moves each vertex."""

from collections.abc import Container
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.gltf_reader.accessors import read_floats, read_wholes
from cageik_cli.formats.gltf_reader.document import Document
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import format_count

INFLUENCE_SET_BYTES = 128
"""Memory that a set of four joints and weights takes at a vertex, as they are and sorted."""

SUM_TOL = 0.01
"""Weights whose sum is this far from 1 get a note; a byte per weight rounds by less."""


class Skin:
    """The joints of a skin.

    Attributes
    ----------
    joints : (J,) int64
        Numbers of nodes.
    """

    def __init__(self, document: Document, number: int) -> None:
        item = document.skins[number]
        self.joints = item.list_wholes("joints", len(document.nodes))
        count = len(self.joints)
        if not count:
            raise item.make_error("joints", [], "one joint or more")
        self._inverse_binds = np.tile(np.eye(4), (count, 1, 1))
        accessor = item.find_whole("inverseBindMatrices", len(document.accessors))
        if accessor is not None:
            rows = read_floats(document, accessor, (16,), needs_float=True)
            if len(rows) < count or not np.isfinite(rows[:count]).all():
                raise FormatError(
                    f"{item.place} has {len(rows)} inverse bind matrices, expected {count} of "
                    "finite numbers, one per joint; export the file again"
                )
            # Files have them column by column.
            self._inverse_binds = rows[:count].astype(np.float64).reshape(-1, 4, 4).swapaxes(1, 2)

    def compute_moves(self, worlds: Floats) -> Floats:
        """Return what moves a vertex with each joint, (J, 4, 4) for columns, into the scene."""
        return np.asarray(worlds[self.joints] @ self._inverse_binds)


class Influences:
    """Joints and weights of vertices.

    Attributes
    ----------
    joints : (n, s) int64
        Places in the list of the skin, ascending, and 0 where the weight is 0.
    weights : (n, s) float64
        Each row has the sum 1.
    notes : list of str
        What was changed.
    """

    def __init__(self, joints: Integers, weights: Floats, joint_count: int) -> None:
        """Check and sort them.

        Raises
        ------
        FormatError
            When a weight is not a finite number from 0 on, or a joint is not there.
        """
        self.notes: list[str] = []
        if not (np.isfinite(weights).all() and (weights >= 0).all()):
            raise FormatError(
                "has weights of joints that are not finite numbers from 0 on; export the file again"
            )
        sums = weights.sum(axis=1)
        is_lost = sums == 0
        weights = weights.copy()
        weights[is_lost, 0] = sums[is_lost] = 1
        if is_lost.any():
            count = format_count(int(np.count_nonzero(is_lost)), "vertex")
            self.notes.append(
                f"the weights of {count} sum to 0; the first joint that is named there moves each"
            )
        is_off = np.abs(sums - 1) > SUM_TOL
        if is_off.any():
            count = format_count(int(np.count_nonzero(is_off)), "vertex")
            self.notes.append(
                f"the weights of {count} sum to {sums.min():.3g} to "
                f"{sums.max():.3g}, and are divided by their sum"
            )
        self.weights = weights / sums[:, None]
        is_absent = (joints >= joint_count) & (self.weights > 0)
        if is_absent.any():
            raise FormatError(
                f"vertex {int(np.argmax(is_absent.any(axis=1)))} follows joint "
                f"{joints[is_absent][0]}, expected 0 to {joint_count - 1}; export the file again"
            )
        self._count = joint_count
        last = np.where(self.weights > 0, joints, joint_count)
        order = np.argsort(last, axis=1, kind="stable")
        self.weights = np.take_along_axis(self.weights, order, axis=1)
        self.joints = np.where(self.weights > 0, np.take_along_axis(joints, order, axis=1), 0)

    def make_matrix(self, vertices: Integers) -> Any:
        """Return the weights of some vertices as a sparse matrix, (m, J)."""
        joints, weights = self.joints[vertices], self.weights[vertices]
        rows = np.repeat(np.arange(len(vertices)), joints.shape[1])
        places = rows, joints.ravel()
        from scipy.sparse import csr_array  # slow to import, and few clips have skins

        return csr_array((weights.ravel(), places), (len(vertices), self._count))


def count_influence_sets(attributes: Container[str]) -> int:
    """Return how many sets of joints and weights vertices have: JOINTS_0, JOINTS_1 and so on."""
    count = 0
    while count == 0 or f"JOINTS_{count}" in attributes:
        for name in (f"JOINTS_{count}", f"WEIGHTS_{count}"):
            if name not in attributes:
                raise FormatError(
                    f"has a skin, and a primitive without {name}; export the file again"
                )
        count += 1
    return count


def read_influences(
    document: Document, attributes: dict[str, int], set_count: int, vertex_count: int
) -> tuple[Integers, Floats]:
    """Read all sets of joints and weights of some vertices, (n, 4 sets); zeros where one lacks."""
    joints = np.zeros((vertex_count, 4 * set_count), np.int64)
    weights = np.zeros(joints.shape)
    for k in range(set_count):
        if f"JOINTS_{k}" not in attributes:
            continue
        columns = slice(4 * k, 4 * k + 4)
        values: dict[str, NDArray[Any]] = {
            f"JOINTS_{k}": read_wholes(document, attributes[f"JOINTS_{k}"], 4),
            f"WEIGHTS_{k}": read_floats(document, attributes[f"WEIGHTS_{k}"], (4,)),
        }
        for name, found in values.items():
            if len(found) != vertex_count:
                raise FormatError(
                    f"{name} has {len(found)} vertices, POSITION {vertex_count}; export the file "
                    "again"
                )
        joints[:, columns], weights[:, columns] = values.values()
    return joints, weights


def blend(points: Floats, matrix: Any, moves: Floats) -> Floats:
    """Return points (m, 3) moved by the weighted sum of the moves (J, 4, 4) of joints.

    `matrix` are the weights, (m, J).
    """
    blended = (matrix @ moves[:, :3].reshape(-1, 12)).reshape(-1, 3, 4)
    return np.asarray(np.einsum("mab,mb->ma", blended[:, :, :3], points) + blended[:, :, 3])
