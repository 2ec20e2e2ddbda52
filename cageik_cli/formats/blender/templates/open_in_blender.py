"""Set up a model that its cage moves live in Blender, as a script or as an extension.

`cageik export` writes this file beside the data, live_cage.npz. Open it in Blender's text editor,
and run it. Or install the .zip beside it once, and import any live_cage.npz by File > Import. Both
make a collection with the model and the cage. The cage plays its animation, and the model follows
whatever moves the cage: hooks, shape keys, modifiers, edit mode.

A vertex of the model is where it was at rest, moved by the sum of its weights times how far the
vertices of the cage are from rest. Weights are attributes of the model, of three vertices of the
cage each, and of any sign. Weights of few influences have offsets, too, which turn with the frames.
"""

import json
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, StringProperty
from bpy_extras.io_utils import ImportHelper
from numpy.typing import NDArray

DATA_NAME = "live_cage.npz"
DATA_FORMAT = 1
"""Of the data; a script or an extension of another version may not know it."""

OLDEST_BLENDER = (5, 0, 0)

REST, MOVE, TURN = "cage_rest", "cage_move", "cage_turn_"
"""Attributes of the cage: positions at rest, how far three are from it, and rows of R - 1."""

OFFSET, WEIGHT = "cage_offset", "cage_weight_"
"""Attributes of the model: offsets, and weights of three cage vertices, the first by its number."""

RAYS = ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow")
"""For which the cage is not there, and so in no picture."""

Arrays = Mapping[str, NDArray[Any]]


class LiveCageError(Exception):
    """A file that cannot be set up; the message says what to do."""


# The data


def read_live_cage(path: Path) -> tuple[dict[str, Any], Arrays]:
    """Read what is said of a live cage, and its arrays; refuse other files."""
    if bpy.app.version < OLDEST_BLENDER:
        raise LiveCageError(f"Blender {bpy.app.version_string} is too old; use 5.0 or newer")
    unsound = LiveCageError(f"{path}: is not a sound live cage; export it again")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        about = json.loads(str(arrays.pop("about")))
        found = about["format"]
    except FileNotFoundError:
        raise LiveCageError(
            f"{path}: does not exist; keep the files of its folder together"
        ) from None
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile):
        raise unsound from None
    if found != DATA_FORMAT:
        raise LiveCageError(
            f"{path}: is a live cage of version {found}, expected {DATA_FORMAT}; use the script or "
            "the extension beside it"
        )
    try:
        check_shapes(about, arrays)
    except (ValueError, TypeError, KeyError):
        raise unsound from None
    return about, arrays


def check_shapes(about: Mapping[str, Any], arrays: Arrays) -> None:
    """Raise an error if an array is missing, or does not fit to the others."""
    n, m = arrays["weights"].shape
    shapes = {"rest": (m, 3), "offsets": (m, 3), "cage": (n, 3)}
    for name, shape in {**shapes, "moves": (about["frame_count"], n + 3, 3)}.items():
        if arrays[name].shape != shape:
            raise ValueError(name)
    counts = {str(number): part["vertex_count"] for number, part in enumerate(about["parts"])}
    if sum(counts.values()) != m:
        raise ValueError("parts")
    for key, count in {"cage": n, **counts}.items():
        corners = arrays[f"{key}_corners"]
        is_whole = arrays[f"{key}_counts"].sum() == len(corners)
        if not is_whole or (len(corners) and not 0 <= corners.min() <= corners.max() < count):
            raise ValueError(key)


# Objects


def set_up(path: Path, sets_time: bool = True) -> bpy.types.Collection:
    """Make the collection of a live cage: the cage, and the parts of the model."""
    about, arrays = read_live_cage(path)
    collection = bpy.data.collections.new(about["name"])
    bpy.context.scene.collection.children.link(collection)
    cage = make_cage(about, arrays)
    collection.objects.link(cage)
    inputs = {"Cage": cage, "Cage Vertices": len(arrays["cage"])}
    start = 0
    for number, part in enumerate(about["parts"]):
        own = slice(start, start + part["vertex_count"])
        model = make_part(part, str(number), arrays, own)
        model.location = about["origin"]
        add_nodes(model, make_deformer(), inputs)
        collection.objects.link(model)
        start = own.stop
    if sets_time:
        set_time(about)
    return collection


def make_cage(about: Mapping[str, Any], arrays: Arrays) -> bpy.types.Object:
    """Make the cage, which plays its animation."""
    mesh = make_mesh("cage", arrays["cage"], arrays["cage_counts"], arrays["cage_corners"])
    add_attribute(mesh, REST, "FLOAT_VECTOR", arrays["cage"])
    cage = bpy.data.objects.new("cage", mesh)
    cage.location = about["origin"]
    cage.display_type, cage.show_in_front = "WIRE", True
    for kind in RAYS:  # `hide_render` would leave it out of exports
        setattr(cage, f"visible_{kind}", False)
    no_faces = np.empty(0, np.int32)
    moves = make_mesh(f"{about['name']} moves", arrays["moves"].reshape(-1, 3), no_faces, no_faces)
    inputs = {
        # In no collection: the modifier alone uses it.
        "Moves": bpy.data.objects.new(moves.name, moves),
        "Cage Vertices": len(arrays["cage"]),
        "First Frame": about["start"],
        "Frame Step": about["frame_step"],
    }
    add_nodes(cage, make_player(), inputs)
    return cage


def make_part(part: Mapping[str, Any], key: str, arrays: Arrays, own: slice) -> bpy.types.Object:
    """Make a part of the model at rest, with its surface and the weights of its vertices."""
    counts, corners = arrays[f"{key}_counts"], arrays[f"{key}_corners"]
    mesh = make_mesh(part["name"], arrays["rest"][own], counts, corners)
    for number in range(0, len(arrays["weights"]), 3):
        weights = arrays["weights"][number : number + 3, own].T
        threes = np.pad(weights, ((0, 0), (0, 3 - weights.shape[1])))
        add_attribute(mesh, f"{WEIGHT}{number}", "FLOAT_VECTOR", threes)
    if arrays["offsets"].any():
        add_attribute(mesh, OFFSET, "FLOAT_VECTOR", arrays["offsets"][own])
    if f"{key}_uvs" in arrays:
        layer = mesh.uv_layers.new(name="UVMap")
        layer.uv.foreach_set("vector", arrays[f"{key}_uvs"].ravel())
    if f"{key}_colours" in arrays:
        add_attribute(mesh, "Color", "FLOAT_COLOR", arrays[f"{key}_colours"])
    for name, colour in part["materials"]:
        mesh.materials.append(None if name is None else find_material(name, colour))
    if f"{key}_materials" in arrays:
        mesh.polygons.foreach_set("material_index", arrays[f"{key}_materials"])
    mark_sharp(mesh, arrays[f"{key}_sharp"])
    return bpy.data.objects.new(part["name"], mesh)


def make_mesh(
    name: str, positions: NDArray[Any], counts: NDArray[Any], corners: NDArray[Any]
) -> bpy.types.Mesh:
    """Make a mesh of smooth polygons, whose corners follow one another."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(positions))
    mesh.vertices.foreach_set("co", positions.ravel())
    mesh.loops.add(len(corners))
    mesh.loops.foreach_set("vertex_index", corners)
    mesh.polygons.add(len(counts))
    mesh.polygons.foreach_set("loop_start", (np.cumsum(counts) - counts).astype(np.int32))
    mesh.update(calc_edges=True)
    return mesh


def add_attribute(mesh: bpy.types.Mesh, name: str, kind: str, values: NDArray[Any]) -> None:
    """Give the vertices of a mesh an attribute."""
    field = {"FLOAT": "value", "FLOAT_VECTOR": "vector", "FLOAT_COLOR": "color"}[kind]
    attribute = mesh.attributes.new(name, kind, "POINT")
    attribute.data.foreach_set(field, values.ravel())


def mark_sharp(mesh: bpy.types.Mesh, pairs: NDArray[Any]) -> None:
    """Mark the edges, (e, 2) vertices, at which faces have normals of their own."""
    if not len(pairs):
        return
    edges = np.empty(2 * len(mesh.edges), np.int32)
    mesh.edges.foreach_get("vertices", edges)
    ends = (edges.reshape(-1, 2), pairs)
    own, sharp = (np.sort(each, axis=1) @ [len(mesh.vertices), 1] for each in ends)
    layer = mesh.attributes.new("sharp_edge", "BOOLEAN", "EDGE")
    layer.data.foreach_set("value", np.isin(own, sharp))


def find_material(name: str, colour: list[float]) -> bpy.types.Material:
    """Return the material of a name, with the shaders that it may have already; else make it."""
    material = bpy.data.materials.get(name)
    if material is None:
        material = bpy.data.materials.new(name)
        material.diffuse_color = colour
        surface = next(one for one in material.node_tree.nodes if one.type == "BSDF_PRINCIPLED")
        surface.inputs["Base Color"].default_value = (*colour[:3], 1)
        surface.inputs["Alpha"].default_value = colour[3]
    return material


def add_nodes(item: bpy.types.Object, tree: Any, inputs: Mapping[str, Any]) -> None:
    """Give an object a modifier of nodes, and values to its inputs, by their names."""
    modifier = item.modifiers.new(tree.name, "NODES")
    modifier.node_group = tree
    for socket in tree.interface.items_tree:
        if socket.in_out == "INPUT" and socket.name in inputs:
            modifier[socket.identifier] = inputs[socket.name]


def set_time(about: Mapping[str, Any]) -> None:
    """Give the scene the frame rate and the frames of the clip."""
    scene = bpy.context.scene
    scene.render.fps = max(1, round(about["fps"]))
    scene.render.fps_base = scene.render.fps / about["fps"]
    last = about["start"] + (about["frame_count"] - 1) * about["frame_step"]
    scene.frame_start, scene.frame_end = int(np.floor(about["start"])), int(np.ceil(last))
    scene.frame_set(scene.frame_start)


# Nodes


class Builder:
    """Builds a tree of geometry nodes. It counts the sockets of a node that Blender shows."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree

    def add(self, kind: str, *values: Any, **settings: Any) -> Any:
        """Add a node with its settings, and values or links to its inputs; None is left out."""
        node = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(node, name, value)
        inputs = [socket for socket in node.inputs if socket.enabled]
        for socket, value in zip(inputs, values, strict=False):
            self.give(socket, value)
        return node

    def give(self, socket: Any, value: Any) -> None:
        """Give an input a value or a link."""
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        elif value is not None:
            socket.default_value = value

    def get(self, *words: Any, name: str = "", **settings: Any) -> Any:
        """Add a node, and return its output of a name, or the first."""
        outputs = [one for one in self.add(*words, **settings).outputs if one.enabled]
        return next(one for one in outputs if name in ("", one.name))

    def attribute(self, name: Any, kind: str = "FLOAT_VECTOR") -> Any:
        """Read an attribute, which is 0 where there is none."""
        return self.get("GeometryNodeInputNamedAttribute", name, data_type=kind)

    def store(self, geometry: Any, name: str, vector: Any) -> Any:
        """Give the vertices of a geometry an attribute."""
        words = {"data_type": "FLOAT_VECTOR", "domain": "POINT"}
        return self.get("GeometryNodeStoreNamedAttribute", geometry, None, name, vector, **words)

    def position(self) -> Any:
        """Read positions."""
        return self.get("GeometryNodeInputPosition")

    def sample(self, geometry: Any, vector: Any, index: Any) -> Any:
        """Read a vector of a vertex of another geometry."""
        words = {"data_type": "FLOAT_VECTOR", "domain": "POINT"}
        return self.get("GeometryNodeSampleIndex", geometry, vector, index, **words)

    def move(self, geometry: Any, offset: Any) -> Any:
        """Move all vertices."""
        return self.get("GeometryNodeSetPosition", geometry, None, None, offset)

    def number(self, operation: str, *values: Any) -> Any:
        """Compute with numbers."""
        return self.get("ShaderNodeMath", *values, operation=operation)

    def whole(self, operation: str, *values: Any) -> Any:
        """Compute with whole numbers."""
        return self.get("FunctionNodeIntegerMath", *values, operation=operation)

    def vector(self, operation: str, *values: Any) -> Any:
        """Compute with vectors."""
        return self.get("ShaderNodeVectorMath", *values, operation=operation)

    def count(self, geometry: Any) -> Any:
        """Count vertices."""
        return self.get("GeometryNodeAttributeDomainSize", geometry, name="Point Count")

    def read_object(self, item: Any, space: str) -> Any:
        """Read the geometry of another object: in its own space, or relative to this one."""
        return self.get("GeometryNodeObjectInfo", item, name="Geometry", transform_space=space)

    def finish(self, geometry: Any, *, otherwise: Any, counted: Any, message: str) -> None:
        """End with a geometry if a pair of counts is equal, otherwise with a warning."""
        words = {"data_type": "INT", "operation": "NOT_EQUAL"}
        fails = self.get("FunctionNodeCompare", *counted, **words)
        fails = self.get("GeometryNodeWarning", fails, message)
        out = self.get("GeometryNodeSwitch", fails, geometry, otherwise, input_type="GEOMETRY")
        self.add("NodeGroupOutput", out)


def find_tree(name: str) -> Any:
    """Return the tree of a name that an earlier live cage has brought; None if none has."""
    found = bpy.data.node_groups.get(name)
    return found if found is not None and found.get("cageik") == DATA_FORMAT else None


def make_tree(name: str, inputs: Mapping[str, str]) -> tuple[Builder, dict[str, Any]]:
    """Make a tree for a modifier; with it are its inputs, by their names, which have kinds."""
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    tree["cageik"], tree.is_modifier = DATA_FORMAT, True
    for socket, kind in {"Geometry": "Geometry", **inputs}.items():
        tree.interface.new_socket(socket, in_out="INPUT", socket_type=f"NodeSocket{kind}")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    given = {one.name: one for one in tree.nodes.new("NodeGroupInput").outputs}
    return Builder(tree), given


def make_player() -> Any:
    """Make the nodes that add the animation of the cage to what else moves it.

    Of each frame, the vertices of `Moves` are how far those of the cage are from rest, then the
    three rows of R - 1, where R turns the rest pose to the frame.
    """
    name, kinds = "Cage Animation", {"Moves": "Object", "Cage Vertices": "Int"}
    if (known := find_tree(name)) is not None:
        return known
    build, given = make_tree(name, {**kinds, "First Frame": "Float", "Frame Step": "Float"})
    moves = build.read_object(given["Moves"], "ORIGINAL")
    geometry, count = given["Geometry"], given["Cage Vertices"]
    size = build.whole("ADD", count, 3)
    last = build.whole("SUBTRACT", build.whole("DIVIDE", build.count(moves), size), 1)
    frame = build.get("GeometryNodeInputSceneTime", name="Frame")
    frame = build.number("SUBTRACT", frame, given["First Frame"])
    frame = build.number("DIVIDE", frame, given["Frame Step"])
    frame = build.number("MINIMUM", build.number("MAXIMUM", frame, 0.0), last)
    before = build.get("FunctionNodeFloatToInt", frame, rounding_mode="FLOOR")
    after = build.whole("MINIMUM", build.whole("ADD", before, 1), last)
    share = build.number("SUBTRACT", frame, before)

    def read_row(row: Any) -> Any:
        """Read a row of a frame, or between two frames."""
        one, other = (
            build.sample(moves, build.position(), build.whole("MULTIPLY_ADD", k, size, row))
            for k in (before, after)
        )
        return build.vector("MULTIPLY_ADD", build.vector("SUBTRACT", other, one), share, one)

    moved = build.move(geometry, read_row(build.get("GeometryNodeInputIndex")))
    for k in range(3):
        moved = build.store(moved, f"{TURN}{k}", read_row(build.whole("ADD", count, k)))
    build.finish(
        moved,
        otherwise=geometry,
        counted=(build.count(geometry), count),
        message="The cage has other vertices than its animation: undo what adds or removes some",
    )
    return build.tree


def make_deformer() -> Any:
    """Make the nodes that move the model by its cage.

    With H the weights, d how far the cage is from rest, and o the offsets, they add
    mean(d) + H (d - mean(d)) + o (R - 1). Rows of H sum to 1, so the mean changes nothing, but that
    single precision keeps the digits of a figure that walks away.
    """
    name = "Cage Deform"
    if (known := find_tree(name)) is not None:
        return known
    build, given = make_tree(name, {"Cage": "Object", "Cage Vertices": "Int"})
    geometry, count = given["Geometry"], given["Cage Vertices"]
    cage = build.read_object(given["Cage"], "RELATIVE")
    moves = build.vector("SUBTRACT", build.position(), build.attribute(REST))
    statistic = ("GeometryNodeAttributeStatistic", cage, None, moves)
    mean = build.get(*statistic, data_type="FLOAT_VECTOR", name="Mean")
    stored = store_threes(build, cage, build.vector("SUBTRACT", moves, mean))
    total = build.vector("ADD", mean, sum_weighted_moves(build, stored, count))
    offset = build.add("ShaderNodeSeparateXYZ", build.attribute(OFFSET))
    for k in range(3):
        row = build.sample(cage, build.attribute(f"{TURN}{k}"), 0)
        total = build.vector("MULTIPLY_ADD", row, offset.outputs[k], total)
    build.finish(
        build.move(geometry, total),
        otherwise=geometry,
        counted=(build.count(cage), count),
        message="The cage is missing or has other vertices than the weights: undo what changed it",
    )
    return build.tree


def store_threes(build: Builder, cage: Any, moves: Any) -> Any:
    """Give each vertex of the cage the matrix of its move and those of the next two, as columns."""
    matrix = build.add("FunctionNodeCombineMatrix")
    index = build.get("GeometryNodeInputIndex")
    words = {"data_type": "FLOAT_VECTOR", "domain": "POINT"}
    for k in range(3):
        at = build.whole("ADD", index, k)
        move = build.get("GeometryNodeFieldAtIndex", moves, at, **words)
        for row, value in enumerate(build.add("ShaderNodeSeparateXYZ", move).outputs):
            build.give(matrix.inputs[4 * k + row], value)
    words["data_type"] = "FLOAT4X4"
    stored = ("GeometryNodeStoreNamedAttribute", cage, None, MOVE, matrix.outputs[0])
    return build.get(*stored, **words)


def sum_weighted_moves(build: Builder, cage: Any, count: Any) -> Any:
    """Sum the moves of all cage vertices, each times its weight, at the vertices of the model.

    A zone repeats for each three vertices of the cage, whose weights are a vector that the matrix
    of their moves turns into the sum of three. It makes one long sum, which Blender then computes
    at all vertices of the model at once. One by one, small models would wait for the zone.
    """
    first, last = build.add("GeometryNodeRepeatInput"), build.add("GeometryNodeRepeatOutput")
    first.pair_with_output(last)
    last.repeat_items.clear()
    last.repeat_items.new("VECTOR", "Sum")
    threes = build.whole("DIVIDE", build.whole("ADD", count, 2), 3)
    build.give(first.inputs["Iterations"], threes)
    number = build.whole("MULTIPLY", first.outputs["Iteration"], 3)
    join = build.add("GeometryNodeStringJoin")
    # The last link is the first string.
    digits = build.get("FunctionNodeValueToString", number, data_type="INT")
    for word in (digits, build.get("FunctionNodeInputString", string=WEIGHT)):
        build.give(join.inputs["Strings"], word)
    moves = build.attribute(MOVE, "FLOAT4X4")
    words = {"data_type": "FLOAT4X4", "domain": "POINT"}
    matrix = build.get("GeometryNodeSampleIndex", cage, moves, number, **words)
    weights = build.attribute(join.outputs[0])
    moved = build.get("FunctionNodeTransformDirection", weights, matrix)
    build.give(last.inputs["Sum"], build.vector("ADD", first.outputs["Sum"], moved))
    return last.outputs["Sum"]


# The extension and the script


class ImportLiveCage(bpy.types.Operator, ImportHelper):
    """The operator of File > Import."""

    bl_idname = "import_scene.cageik_live_cage"
    bl_label = "Import Live Cage"
    bl_description = "Import a model that its animated cage moves live"
    bl_options = {"UNDO"}  # noqa: RUF012

    filename_ext = ".npz"
    filter_glob: StringProperty(default="*.npz", options={"HIDDEN"})
    sets_time: BoolProperty(
        name="Set Frames and Rate",
        description="Give the scene the frame range and the frame rate of the clip",
        default=True,
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Import the file that was chosen."""
        try:
            set_up(Path(self.filepath), self.sets_time)
        except LiveCageError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


def draw_entry(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry of File > Import."""
    menu.layout.operator(ImportLiveCage.bl_idname, text="Live cage of cageik (.npz)")


def register() -> None:
    """Begin as an extension."""
    bpy.utils.register_class(ImportLiveCage)
    bpy.types.TOPBAR_MT_file_import.append(draw_entry)


def unregister() -> None:
    """End as an extension."""
    bpy.types.TOPBAR_MT_file_import.remove(draw_entry)
    bpy.utils.unregister_class(ImportLiveCage)


def find_own_folder() -> Path:
    """Return the folder of this script; in the text editor, its text knows it."""
    text = getattr(bpy.context.space_data, "text", None)
    return Path(__file__ if text is None else bpy.path.abspath(text.filepath)).parent


def main() -> None:
    """Set up the live cage beside this script."""
    try:
        set_up(find_own_folder() / DATA_NAME)
    except LiveCageError as error:
        message = str(error)
        if bpy.app.background:
            sys.exit(message)
        bpy.context.window_manager.popup_menu(
            lambda menu, context: menu.layout.label(text=message), title="cageik", icon="ERROR"
        )


if __name__ == "__main__":
    main()
