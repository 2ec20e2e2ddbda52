"""glTF files evaluated number by number, as the specification has it: no array, no matrix library.

Rows of numbers are tuples, matrices are lists of four rows, and transforms multiply columns.
"""

import base64
import json
import math
import struct
from functools import reduce

CODES = {5120: ("b", 127), 5121: ("B", 255), 5122: ("h", 32767), 5123: ("H", 65535)}
CODES |= {5125: ("I", 4294967295), 5126: ("f", None)}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
IDENTITY = [[float(i == j) for j in range(4)] for i in range(4)]


class Evaluated:
    """A file, of which nothing is kept but its JSON and its buffers."""

    def __init__(self, path):
        data = path.read_bytes()
        binary = b""
        if data[:4] == b"glTF":
            (size,) = struct.unpack_from("<I", data, 12)
            self.json = json.loads(data[20 : 20 + size])
            binary = data[28 + size :]
        else:
            self.json = json.loads(data)
        self.buffers = [self._load(path, each.get("uri"), binary) for each in self.json["buffers"]]

    def _load(self, path, uri, binary):
        if uri is None:
            return binary
        if uri.startswith("data:"):
            return base64.b64decode(uri.split(",")[1])
        return (path.parent / uri.replace("%20", " ")).read_bytes()

    # --- accessors

    def rows(self, number):
        """The elements of an accessor, as tuples of floats."""
        accessor = self.json["accessors"][number]
        letter, most = CODES[accessor["componentType"]]
        width = WIDTHS[accessor["type"]]
        found = [(0.0,) * width] * accessor["count"]
        if "bufferView" in accessor:
            found = self._unpack(accessor, letter * width, accessor["count"])
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            code = CODES[sparse["indices"]["componentType"]][0]
            places = self._unpack(sparse["indices"], code, sparse["count"])
            values = self._unpack(sparse["values"], letter * width, sparse["count"])
            for (place,), value in zip(places, values, strict=True):
                found[place] = value
        if accessor.get("normalized"):
            found = [tuple(max(x / most, -1.0) for x in row) for row in found]
        return found

    def _unpack(self, held, letters, count):
        view = self.json["bufferViews"][held["bufferView"]]
        data = self.buffers[view["buffer"]]
        start = view.get("byteOffset", 0) + held.get("byteOffset", 0)
        step = view.get("byteStride", struct.calcsize("<" + letters))
        return [struct.unpack_from("<" + letters, data, start + k * step) for k in range(count)]

    # --- nodes and animations

    def value(self, animation, node, path, time, rest):
        """What a channel gives at a time; the value at rest without one."""
        held = self.json["animations"][animation]
        for channel in held["channels"]:
            if channel["target"] == {"node": node, "path": path}:
                return self.interpolate(held["samplers"][channel["sampler"]], path, time)
        return rest

    def interpolate(self, sampler, path, time):
        keys = [key for (key,) in self.rows(sampler["input"])]
        numbers = [x for row in self.rows(sampler["output"]) for x in row]
        kind = sampler.get("interpolation", "LINEAR")
        per_key = len(numbers) // len(keys)
        parts = [numbers[k * per_key : (k + 1) * per_key] for k in range(len(keys))]
        if kind == "CUBICSPLINE":
            width = per_key // 3
            parts = [(p[:width], p[width : 2 * width], p[2 * width :]) for p in parts]
            plain = [middle for _, middle, _ in parts]
        else:
            plain = parts
        if time <= keys[0]:
            return plain[0]
        if time >= keys[-1]:
            return plain[-1]
        k = max(k for k, key in enumerate(keys) if key <= time)
        step = keys[k + 1] - keys[k]
        t = (time - keys[k]) / step
        if kind == "STEP":
            return plain[k]
        if kind == "CUBICSPLINE":
            return [
                (2 * t**3 - 3 * t**2 + 1) * v0
                + step * (t**3 - 2 * t**2 + t) * out
                + (-2 * t**3 + 3 * t**2) * v1
                + step * (t**3 - t**2) * into
                for v0, out, v1, into in zip(
                    plain[k], parts[k][2], plain[k + 1], parts[k + 1][0], strict=True
                )
            ]
        a, b = plain[k], plain[k + 1]
        if path != "rotation":
            return [x + t * (y - x) for x, y in zip(a, b, strict=True)]
        # Those of 16 bits are of length 1 to 1e-5.
        a, b = ([x / math.hypot(*turn) for x in turn] for turn in (a, b))
        dot = sum(x * y for x, y in zip(a, b, strict=True))
        b, dot = ([-y for y in b], -dot) if dot < 0 else (b, dot)
        angle = math.acos(min(1.0, dot))
        if angle < 1e-6:
            return [x + t * (y - x) for x, y in zip(a, b, strict=True)]
        near, far = math.sin((1 - t) * angle), math.sin(t * angle)
        return [(near * x + far * y) / math.sin(angle) for x, y in zip(a, b, strict=True)]

    def local(self, node, animation, time):
        """The transform of a node into that above it."""
        held = self.json["nodes"][node]
        if "matrix" in held:
            return [[held["matrix"][4 * j + i] for j in range(4)] for i in range(4)]
        move = self.value(animation, node, "translation", time, held.get("translation", [0, 0, 0]))
        turn = self.value(animation, node, "rotation", time, held.get("rotation", [0, 0, 0, 1]))
        scale = self.value(animation, node, "scale", time, held.get("scale", [1, 1, 1]))
        return compose(move, turn, scale)

    def world(self, node, animation, time):
        """The transform of a node into the scene."""
        above = [k for k, each in enumerate(self.json["nodes"]) if node in each.get("children", ())]
        own = self.local(node, animation, time)
        return multiply(self.world(above[0], animation, time), own) if above else own

    # --- meshes

    def triangles(self, node, time, animation=0):
        """The corners of all triangles of a node in the scene, three tuples after one another."""
        held = self.json["nodes"][node]
        mesh = self.json["meshes"][held["mesh"]]
        if "EXT_mesh_gpu_instancing" in held.get("extensions", {}):
            return self._instances(held["extensions"], node, time, animation)
        return self._corners(mesh, lambda primitive: self.points(node, primitive, time, animation))

    def _instances(self, extensions, node, time, animation):
        """The corners of the first instance, of the second, and so on."""
        held = extensions["EXT_mesh_gpu_instancing"]["attributes"]
        lists = [self.rows(held[name]) for name in ("TRANSLATION", "ROTATION", "SCALE")]
        mesh = self.json["meshes"][self.json["nodes"][node]["mesh"]]
        world = self.world(node, animation, time)
        corners = []
        for place in zip(*lists, strict=True):
            matrix = multiply(world, compose(*place))
            corners += self._corners(
                mesh,
                lambda one, matrix=matrix: [
                    apply(matrix, row) for row in self.rows(one["attributes"]["POSITION"])
                ],
            )
        return corners

    def _corners(self, mesh, place):
        """The corners of all triangles of a mesh, whose primitives are placed."""
        corners = []
        for primitive in mesh["primitives"]:
            points = place(primitive)
            order = range(len(points))
            if "indices" in primitive:
                order = [int(k) for (k,) in self.rows(primitive["indices"])]
            corners += [points[k] for k in unroll(list(order), primitive.get("mode", 4))]
        return corners

    def points(self, node, primitive, time, animation):
        held = self.json["nodes"][node]
        mesh = self.json["meshes"][held["mesh"]]
        points = [list(row) for row in self.rows(primitive["attributes"]["POSITION"])]
        targets = primitive.get("targets", [])
        rest = held.get("weights", mesh.get("weights", [0.0] * len(targets)))
        weights = self.value(animation, node, "weights", time, rest)
        for target, weight in zip(targets, weights, strict=True):
            for point, move in zip(points, self.rows(target["POSITION"]), strict=True):
                for i in range(3):
                    point[i] += weight * move[i]
        if "skin" not in held:
            world = self.world(node, animation, time)
            return [apply(world, point) for point in points]
        skin = self.json["skins"][held["skin"]]
        binds = [IDENTITY] * len(skin["joints"])
        if "inverseBindMatrices" in skin:
            binds = [
                [[row[4 * j + i] for j in range(4)] for i in range(4)]
                for row in self.rows(skin["inverseBindMatrices"])
            ]
        moves = [
            multiply(self.world(joint, animation, time), bind)
            for joint, bind in zip(skin["joints"], binds, strict=False)
        ]
        sets = [name[7:] for name in primitive["attributes"] if name.startswith("JOINTS_")]
        found = [[0.0, 0.0, 0.0] for _ in points]
        for each in sets:
            joints = self.rows(primitive["attributes"][f"JOINTS_{each}"])
            shares = self.rows(primitive["attributes"][f"WEIGHTS_{each}"])
            for k, (names, parts) in enumerate(zip(joints, shares, strict=True)):
                for name, part in zip(names, parts, strict=True):
                    for i in range(3):
                        found[k][i] += part * apply(moves[int(name)], points[k])[i]
        return found


def compose(move, turn, scale):
    """The matrix that scales, turns and moves."""
    length = math.sqrt(sum(q * q for q in turn))
    x, y, z, w = (q / length for q in turn)
    turned = [
        [1 - 2 * y * y - 2 * z * z, 2 * x * y - 2 * z * w, 2 * x * z + 2 * y * w],
        [2 * x * y + 2 * z * w, 1 - 2 * x * x - 2 * z * z, 2 * y * z - 2 * x * w],
        [2 * x * z - 2 * y * w, 2 * y * z + 2 * x * w, 1 - 2 * x * x - 2 * y * y],
    ]
    rows = [[turned[i][j] * scale[j] for j in range(3)] + [move[i]] for i in range(3)]
    return [*rows, [0.0, 0.0, 0.0, 1.0]]


def multiply(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(4)) for j in range(4)] for i in range(4)]


def apply(matrix, point):
    return [sum(matrix[i][k] * (*point, 1.0)[k] for k in range(4)) for i in range(3)]


def unroll(order, mode):
    """The corners of triangles, of strips (5) and of fans (6), one triangle after the other."""
    if mode == 4:
        return order
    triples = [
        (order[k], order[k + 1 + k % 2], order[k + 2 - k % 2])
        if mode == 5
        else (order[k + 1], order[k + 2], order[0])
        for k in range(len(order) - 2)
    ]
    return reduce(lambda found, triple: [*found, *triple], triples, [])
