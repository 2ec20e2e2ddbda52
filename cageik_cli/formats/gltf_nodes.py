"""The nodes of a glTF file: one per part, below those in its path, and the spaces that they are."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cageik_cli.geometry.parts import Part
from cageik_cli.util.arrays import Floats

SHEAR_TOL = 1e-6
"""Cosine of axes above which a transform shears, which the transform of a node cannot."""


@dataclass(frozen=True, eq=False)
class NodeSpace:
    """The space of a node: rows of it times `transform`, (4, 4), are in that of the scene."""

    transform: Floats

    @property
    def is_scene(self) -> bool:
        """Whether it is the space of the scene."""
        return np.array_equal(self.transform, np.eye(4))

    def take_positions(self, positions: Floats) -> Floats:
        """Take positions (..., 3) of the scene into the space."""
        if self.is_scene:
            return positions
        return np.asarray((positions - self.transform[3, :3]) @ self._inverse)

    def take_moves(self, moves: Floats) -> Floats:
        """Take differences of positions, (..., 3), into the space."""
        return moves if self.is_scene else np.asarray(moves @ self._inverse)

    def take_normals(self, normals: Floats) -> tuple[Floats, Floats]:
        """Take unit normals (k, 3); differences are to be multiplied by the second, (k, 3, 3)."""
        if self.is_scene:
            return normals, np.broadcast_to(np.eye(3), (len(normals), 3, 3))
        turn = self.transform[:3, :3].T
        lengths = np.linalg.norm(normals @ turn, axis=1)
        turns = turn / np.where(lengths > 0, lengths, 1.0)[:, None, None]
        return np.einsum("ka,kab->kb", normals, turns), turns

    @property
    def _inverse(self) -> Floats:
        return np.asarray(np.linalg.inv(self.transform[:3, :3]))


def choose_spaces(parts: Sequence[Part]) -> list[NodeSpace]:
    """Return the space of the node of each part.

    It is that of the part if the node can have the transform from there into the space of the next
    part above, or the scene; else it is that space.
    """
    matrices: dict[str, Floats] = {}
    for part in sorted(parts, key=lambda part: part.name.strip("/").count("/")):
        path = part.name.strip("/")
        outer = _find_outer(path, matrices)
        local = part.transform @ np.linalg.inv(outer)
        matrices[path] = part.transform if _is_of_node(local) else outer
    return [NodeSpace(matrices[part.name.strip("/")]) for part in parts]


def _is_of_node(matrix: Floats) -> bool:
    """Return whether a node can have a transform: it does not shear, and does not mirror."""
    rows = matrix[:3, :3]
    axes = rows / np.linalg.norm(rows, axis=1)[:, None]
    is_sheared = np.abs(axes @ axes.T - np.eye(3)).max() > SHEAR_TOL
    return not is_sheared and bool(np.linalg.det(axes) > 0)


def _find_outer(path: str, matrices: dict[str, Floats]) -> Floats:
    """Return the matrix of the next path above that has one, or of the scene."""
    above = path.rpartition("/")[0]
    while above and above not in matrices:
        above = above.rpartition("/")[0]
    return matrices.get(above, np.eye(4))


def make_part_nodes(
    names: Sequence[str],
    first: int,
    spaces: Sequence[NodeSpace] = (),
    **every: Any,
) -> tuple[list[Any], list[int], list[int]]:
    """Return a node per part, with mesh k of part k, below nodes for what is above in its path.

    Parameters
    ----------
    first : int
        Number of the first of these nodes in the file.
    spaces : sequence of NodeSpace, optional
        Of the parts; that of the scene if absent.
    **every
        Other fields of the nodes of parts.

    Returns
    -------
    nodes, tops, meshes
        The nodes, the numbers of those at the top, and of those that have meshes.
    """
    import pygltflib as gltf

    numbers: dict[str, int] = {}
    nodes: list[Any] = []
    tops: list[int] = []

    def place(path: str) -> Any:
        above, _, name = path.strip("/").rpartition("/")
        numbers[path] = first + len(nodes)
        node = gltf.Node(name=name)
        nodes.append(node)
        if not above:
            tops.append(numbers[path])
        else:
            if above not in numbers:
                place(above)
            nodes[numbers[above] - first].children.append(numbers[path])
        return node

    meshes = []
    for k, name in enumerate(names):
        path = name.strip("/")
        node = nodes[numbers[path] - first] if path in numbers else place(path)
        node.mesh = k
        for field, value in every.items():
            setattr(node, field, value)
        meshes.append(numbers[path])
    matrices = {name.strip("/"): one.transform for name, one in zip(names, spaces, strict=False)}
    for path, number in numbers.items():
        _set_matrix(nodes[number - first], path, matrices)
    return nodes, tops, meshes


def _set_matrix(node: Any, path: str, matrices: dict[str, Floats]) -> None:
    """Set the matrix of the node of a part into the space of the next part above."""
    if path not in matrices:
        return
    local = matrices[path] @ np.linalg.inv(_find_outer(path, matrices))
    if not np.array_equal(local, np.eye(4)):
        node.matrix = local.ravel().tolist()


def place_node(node: Any, placement: dict[str, list[float]]) -> None:
    """Place a node at the top by a rotation (a quaternion) and a scale, around what it has."""
    if node.matrix is None:
        for field, value in placement.items():
            setattr(node, field, value)
        return
    x, _, _, w = placement.get("rotation", [0.0, 0.0, 0.0, 1.0])  # about x
    cosine, sine = w * w - x * x, 2 * x * w
    turn = np.array([[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]])
    outer = np.eye(4)
    outer[:3, :3] = turn * np.array(placement.get("scale", [1.0, 1.0, 1.0]))
    node.matrix = (np.reshape(node.matrix, (4, 4)) @ outer).ravel().tolist()
