"""The tree of nodes: names of paths, and transforms from the top down."""

import numpy as np

from cageik_cli.formats.gltf_reader.accessors import count_rows, read_floats
from cageik_cli.formats.gltf_reader.document import Document
from cageik_cli.formats.gltf_reader.items import Item
from cageik_cli.geometry.surface_parts import MAX_NAME_LENGTH
from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import number_names

TRS_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
"""Numbers of the values that place a node; rotations are quaternions (x, y, z, w)."""

INSTANCING = "EXT_mesh_gpu_instancing"


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
        self._parents = self._find_parents()
        self._children = self._list_children(document)
        self._levels = self._order_levels()
        self.is_shown = self._find_shown(document)
        count = len(self._items)
        self.values = {
            "translation": np.zeros((count, 3)),
            "rotation": np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
            "scale": np.ones((count, 3)),
        }
        self.matrices: dict[int, Floats] = {}
        for k, item in enumerate(self._items):
            for name, width in TRS_WIDTHS.items():
                found = item.find_numbers(name, width)
                if found is not None:
                    self.values[name][k] = found
            matrix = item.find_numbers("matrix", 16)
            if matrix is not None:
                self.matrices[k] = matrix.reshape(4, 4).T
        self._names = self._choose_names()

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
        names: list[str] = []
        length, k = 0, number
        while k >= 0:
            names.append(self._names[k])
            length += 1 + len(self._names[k])
            if length > MAX_NAME_LENGTH:
                raise FormatError(
                    f"the path of nodes[{number}] has more than {MAX_NAME_LENGTH} characters; "
                    "give its nodes shorter names, or fewer above it"
                )
            k = int(self._parents[k])
        return "/" + "/".join(reversed(names))

    def list_in_order(self) -> list[int]:
        """List all nodes, each before those below it, and these before the next beside it."""
        found, waiting = [], self._children[-1][::-1]
        while waiting:
            found.append(waiting.pop())
            waiting += self._children[found[-1]][::-1]
        return found

    def list_above(self, number: int) -> list[int]:
        """Return a node and those above it."""
        found = []
        while number >= 0:
            found.append(number)
            number = int(self._parents[number])
        return found

    def _find_parents(self) -> Integers:
        """Return the node above each; -1 at the top."""
        parents = np.full(len(self._items), -1)
        for k, item in enumerate(self._items):
            for child in item.list_wholes("children", len(self._items)).tolist():
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
        listed = [] if scene is None else scene.list_wholes("nodes", len(self._items)).tolist()
        tops = dict.fromkeys([*(k for k in listed if k in tops), *tops])
        below = [item.list_wholes("children", len(self._items)).tolist() for item in self._items]
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
            shown[scene.list_wholes("nodes", len(self._items))] = True
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
    return scenes[document.root.find_whole("scene", len(scenes)) or 0] if scenes else None


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
        and (number := attributes.find_whole(name.upper(), len(document.accessors))) is not None
    }
    counts = {count_rows(document, number) for number in numbers.values()}
    if len(counts) != 1:
        found = " and ".join(map(str, sorted(counts))) or "no"
        raise FormatError(
            f"{extension.place} has {found} translations, rotations and scales, expected as many "
            "of each that is there; export the file again"
        )
    count = counts.pop()
    document.claim(count * 400)  # bytes of the place and the name of a copy
    values = {
        "translation": np.zeros((count, 3)),
        "rotation": np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
        "scale": np.ones((count, 3)),
    }
    for name, number in numbers.items():
        values[name] = np.asarray(read_floats(document, number, (TRS_WIDTHS[name],)), np.float64)
        if not np.isfinite(values[name]).all():
            raise FormatError(f"{extension.place} has a {name} that is not finite; export it again")
    return make_matrices(values)


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
