"""The tree of nodes, read and written: paths and transforms, and skins whose joints are nodes."""

from collections.abc import Container, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.mesh_data import Change
from cageik_cli.formats.gltf.document import Document, Item, count_rows, read_floats, read_integers
from cageik_cli.geometry.attributes import MAX_NAME_LENGTH
from cageik_cli.geometry.parts import Part
from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import group_digits, number_names

TRS_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
"""Numbers of the values that place a node; rotations are quaternions (x, y, z, w)."""

INSTANCING = "EXT_mesh_gpu_instancing"

INSTANCE_BYTES = 400
"""Memory of the place and the name of an instance, whether it is read or not."""

INFLUENCE_SET_BYTES = 128
"""Memory that a set of four joints and weights takes at a vertex, as they are and sorted."""

NODE_BYTES, JOINT_BYTES = 2000, 1500
"""Memory of a node, and of a joint: names, and transforms of the frames that threads read."""

SUM_TOL = 0.01
"""Weights whose sum is this far from 1 get a note; a byte per weight rounds by less."""

SHEAR_TOL = 1e-6
"""Cosine of axes above which a transform shears, which the transform of a node cannot."""


class NodeTree:
    """The nodes of a file.

    Attributes
    ----------
    values : dict
        At rest, by name: (N, 3) translations and scales, (N, 4) rotations.
    matrices : dict
        Of the nodes that have one instead, (4, 4) for columns, by their numbers.
    is_shown : (N,) bool
        Whether each is in the scene that a viewer opens, and visible.
    """

    def __init__(self, document: Document) -> None:
        self._items = document.nodes
        document.claim_objects(len(self._items), "nodes", NODE_BYTES)
        self._parents = self._find_parents()
        self._children = self._list_children(document)
        self._levels = self._order_levels()
        self.is_shown = self._find_shown(document)
        self.values = make_still_values(len(self._items))
        self.matrices: dict[int, Floats] = {}
        for k, item in enumerate(self._items):
            for name, width in TRS_WIDTHS.items():
                found = item.find_numbers(name, width)
                if found is not None:
                    self.values[name][k] = found
            matrix = item.find_numbers("matrix", 16)
            if matrix is not None:
                self.matrices[k] = matrix.reshape(4, 4).T
        self._names, self._paths = self._choose_names(), dict[int, str]()

    def compute_worlds(self, values: dict[str, Floats]) -> Floats:
        """Return the transforms (N, 4, 4) of all nodes into the scene, for columns.

        `values` are as the attribute of that name.
        """
        local = make_matrices(values)
        for k, matrix in self.matrices.items():
            local[k] = matrix
        world = local
        for level in self._levels[1:]:
            world[level] = world[self._parents[level]] @ local[level]
        return world

    def make_path(self, number: int) -> str:
        """Return the names of the nodes from the top to one."""
        added, k = [], number
        while k >= 0 and k not in self._paths:
            added.append(k)
            k = int(self._parents[k])
        path = self._paths.get(k, "")
        for k in reversed(added):
            path += f"/{self._names[k]}"
            if len(path) > MAX_NAME_LENGTH:
                raise FormatError(
                    f"the path of nodes[{number}] has more than {MAX_NAME_LENGTH} characters; "
                    "give its nodes shorter names, or fewer above it"
                )
            self._paths[k] = path
        return path

    def list_in_order(self) -> list[int]:
        """List all nodes, each before those below it, and these before the next beside it."""
        found, waiting = [], self._children[-1][::-1]
        while waiting:
            found.append(waiting.pop())
            waiting += self._children[found[-1]][::-1]
        return found

    def mark_below(self, marked: Mask) -> Mask:
        """Return which nodes are marked, (N,), or below one that is."""
        marked = marked.copy()
        for level in self._levels[1:]:
            marked[level] |= marked[self._parents[level]]
        return marked

    def _find_parents(self) -> Integers:
        """Return the node above each; -1 at the top."""
        parents = np.full(len(self._items), -1)
        for k, item in enumerate(self._items):
            for child in item.list_integers("children", len(self._items)).tolist():
                if parents[child] >= 0:
                    raise FormatError(
                        f"nodes[{child}] is below nodes[{parents[child]}] and nodes[{k}], expected "
                        "one node above it; export the file again"
                    )
                parents[child] = k
        return parents

    def _list_children(self, document: Document) -> list[list[int]]:
        """Return the nodes below each, as they are listed; last those at the top.

        Of the latter, those in the scene that a viewer opens are first.
        """
        tops = dict.fromkeys(np.flatnonzero(self._parents < 0).tolist())
        scene = _find_scene(document)
        listed = [] if scene is None else scene.list_integers("nodes", len(self._items)).tolist()
        tops = dict.fromkeys([*(k for k in listed if k in tops), *tops])
        below = [item.list_integers("children", len(self._items)).tolist() for item in self._items]
        return [*below, list(tops)]

    def _order_levels(self) -> list[Integers]:
        """Return the nodes at the top, those below them, and so on."""
        level = self._children[-1]
        levels, found = [], 0
        while level:
            levels.append(np.array(level))
            found += len(level)
            level = [child for k in level for child in self._children[k]]
        if found < len(self._items):
            reached = np.zeros(len(self._items), bool)
            for numbers in levels:
                reached[numbers] = True
            raise FormatError(
                f"nodes[{int(np.argmin(reached))}] is below itself, or below one that is; export "
                "the file again"
            )
        return levels

    def _find_shown(self, document: Document) -> Mask:
        """Return which nodes are in the scene that a viewer opens, and visible."""
        shown = np.ones(len(self._items), bool)
        scene = _find_scene(document)
        if scene is not None:
            tops = self._parents < 0
            shown[tops] = False
            shown[scene.list_integers("nodes", len(self._items))] = True
        for k, item in enumerate(self._items):
            visibility = item.find_extension("KHR_node_visibility")
            if visibility is not None and visibility.values.get("visible") is False:
                shown[k] = False
        for level in self._levels[1:]:
            shown[level] &= shown[self._parents[level]]
        return shown

    def _choose_names(self) -> list[str]:
        """Return a name per node, no two alike below one node; slashes would part paths."""
        names = [
            item.read_name().replace("/", "_") or f"node_{k}" for k, item in enumerate(self._items)
        ]
        for siblings in self._children:
            unique = number_names(names[k] for k in siblings)
            for k, name in zip(siblings, unique, strict=True):
                names[k] = name
        return names


def _find_scene(document: Document) -> Item | None:
    """Return the scene that a viewer opens; None if there is none."""
    scenes = document.root.list_items("scenes")
    return scenes[document.root.find_integer("scene", len(scenes)) or 0] if scenes else None


def read_instances(document: Document, node: Item) -> Floats | None:
    """Return the places of the copies of the mesh of a node, (K, 4, 4) for columns, in its space.

    None if the node has its mesh once, without the extension `INSTANCING`.

    Raises
    ------
    FormatError
        When there are not as many translations, rotations and scales.
    """
    extension = node.find_extension(INSTANCING)
    if extension is None:
        return None
    attributes = extension.find_item("attributes")
    numbers = {
        name: number
        for name in TRS_WIDTHS
        if attributes is not None
        and (number := attributes.find_integer(name.upper(), len(document.accessors))) is not None
    }
    counts = {count_rows(document, number) for number in numbers.values()}
    if len(counts) != 1:
        found = " and ".join(map(str, sorted(counts))) or "no"
        raise FormatError(
            f"{extension.place} has {found} translations, rotations and scales, expected as many "
            "of each that is there; export the file again"
        )
    count = counts.pop()
    document.claimed.claim_copy(count * INSTANCE_BYTES)
    values = make_still_values(count)
    for name, number in numbers.items():
        values[name] = np.asarray(read_floats(document, number, (TRS_WIDTHS[name],)), np.float64)
        if not np.isfinite(values[name]).all():
            raise FormatError(f"{extension.place} has a {name} that is not finite; export it again")
    return make_matrices(values)


def make_still_values(count: int) -> dict[str, Floats]:
    """Return translations, rotations and scales that change nothing, (count, width) each."""
    still = {"translation": [0.0] * 3, "rotation": [0.0, 0.0, 0.0, 1.0], "scale": [1.0] * 3}
    return {name: np.tile(values, (count, 1)) for name, values in still.items()}


def make_matrices(values: dict[str, Floats]) -> Floats:
    """Return the matrices (k, 4, 4), for columns, of translations, rotations and scales."""
    matrices = np.zeros((len(values["scale"]), 4, 4))
    matrices[:, :3, :3] = make_rotations(values["rotation"]) * values["scale"][:, None]
    matrices[:, :3, 3] = values["translation"]
    matrices[:, 3, 3] = 1
    return matrices


def make_rotations(quaternions: Floats) -> Floats:
    """Return the matrices (k, 3, 3), for columns, of quaternions (k, 4) of any length but 0.

    A length of 0 turns nothing.
    """
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    unit = np.where(lengths > 0, quaternions / np.where(lengths > 0, lengths, 1), [0, 0, 0, 1])
    x, y, z, w = unit.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


class Skin:
    """The joints of a skin.

    Attributes
    ----------
    joints : (J,) int64
        Numbers of nodes.
    """

    def __init__(self, document: Document, number: int) -> None:
        item = document.skins[number]
        document.claim_objects(item.count("joints"), "joints", JOINT_BYTES)
        self.joints = item.list_integers("joints", len(document.nodes))
        count = len(self.joints)
        if not count:
            raise item.make_error("joints", [], "one joint or more")
        self._inverse_binds = np.tile(np.eye(4), (count, 1, 1))
        accessor = item.find_integer("inverseBindMatrices", len(document.accessors))
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
    notes : list of Change
        What was changed.
    """

    def __init__(self, joints: Integers, weights: Floats, joint_count: int) -> None:
        """Check and sort them.

        Raises
        ------
        FormatError
            When a weight is not a finite number from 0 on, or a joint is not there.
        """
        self.notes: list[Change] = []
        if not (np.isfinite(weights).all() and (weights >= 0).all()):
            raise FormatError(
                "has weights of joints that are not finite numbers from 0 on; export the file again"
            )
        sums = weights.sum(axis=1)
        is_lost = sums == 0
        weights = weights.copy()
        weights[is_lost, 0] = sums[is_lost] = 1
        if is_lost.any():
            words = "the weights of {} sum to 0; the first joint that is named there moves each"
            self.notes.append(Change(words, "vertex", int(np.count_nonzero(is_lost))))
        is_off = np.abs(sums - 1) > SUM_TOL
        if is_off.any():
            words = "the weights of {} sum to {span}, and are divided by their sum"
            count, span = int(np.count_nonzero(is_off)), (sums.min(), sums.max())
            self.notes.append(Change(words, "vertex", count, span=span))
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
            f"JOINTS_{k}": read_integers(document, attributes[f"JOINTS_{k}"], 4),
            f"WEIGHTS_{k}": read_floats(document, attributes[f"WEIGHTS_{k}"], (4,)),
        }
        for name, found in values.items():
            if len(found) != vertex_count:
                raise FormatError(
                    f"{name} has {group_digits(len(found))} vertices, POSITION "
                    f"{group_digits(vertex_count)}; export the file "
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
    names: Sequence[str], spaces: Sequence[NodeSpace] = (), **every: Any
) -> tuple[list[Any], list[int], list[int]]:
    """Return a node per part, with mesh k of part k, below nodes for what is above in its path.

    Parameters
    ----------
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
        numbers[path] = len(nodes)
        node = gltf.Node(name=name)
        nodes.append(node)
        if not above:
            tops.append(numbers[path])
        else:
            if above not in numbers:
                place(above)
            nodes[numbers[above]].children.append(numbers[path])
        return node

    meshes = []
    for k, name in enumerate(names):
        path = name.strip("/")
        node = nodes[numbers[path]] if path in numbers else place(path)
        node.mesh = k
        for field, value in every.items():
            setattr(node, field, value)
        meshes.append(numbers[path])
    matrices = {name.strip("/"): one.transform for name, one in zip(names, spaces, strict=False)}
    for path, matrix in matrices.items():
        local = matrix @ np.linalg.inv(_find_outer(path, matrices))
        if not np.array_equal(local, np.eye(4)):
            nodes[numbers[path]].matrix = local.ravel().tolist()
    return nodes, tops, meshes


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
