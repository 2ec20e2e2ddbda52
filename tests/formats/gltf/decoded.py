"""GLB files decoded by their own accessors, for tests."""

import json
import struct

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

KINDS = {5126: "<f4", 5125: "<u4", 5123: "<u2", 5122: "<i2", 5121: "u1", 5120: "i1"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Glb:
    """What the chunks of a file hold."""

    def __init__(self, path):
        data = path.read_bytes()
        magic, version, length = struct.unpack("<4sII", data[:12])
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack("<I4s", data[12:20])
        assert (kind, size % 4) == (b"JSON", 0)
        self.json = json.loads(data[20 : 20 + size])
        binary, kind = struct.unpack("<I4s", data[20 + size : 28 + size])
        assert (kind, binary % 4) == (b"BIN\0", 0)
        self.binary = data[28 + size :]
        assert len(self.binary) == binary == self.json["buffers"][0]["byteLength"]

    def array(self, index):
        """The rows (k, width) of an accessor, whose bounds are checked."""
        accessor = self.json["accessors"][index]
        view = self.json["bufferViews"][accessor["bufferView"]]
        width, kind = WIDTHS[accessor["type"]], np.dtype(KINDS[accessor["componentType"]])
        size = kind.itemsize * width
        stride, offset = view.get("byteStride", size), accessor.get("byteOffset", 0)
        assert stride >= size
        assert (stride % 4 == 0) or "byteStride" not in view
        assert offset + stride * (accessor["count"] - 1) + size <= view["byteLength"]
        start = view.get("byteOffset", 0) + offset
        assert start % kind.itemsize == 0
        shape, steps = (accessor["count"], width), (stride, kind.itemsize)
        found = np.ndarray(shape, kind, self.binary, start, steps)
        for name, bound in (("min", found.min(axis=0)), ("max", found.max(axis=0))):
            if name in accessor:
                np.testing.assert_array_equal(np.array(accessor[name], kind), bound)
        if accessor.get("normalized"):
            return np.maximum(found.astype(float) / np.iinfo(kind).max, -1)
        return found

    @property
    def primitives(self):
        return self.json["meshes"][0]["primitives"]

    def attribute(self, name, primitive=0):
        return self.array(self.primitives[primitive]["attributes"][name])

    def faces(self, primitive=0):
        return self.array(self.primitives[primitive]["indices"]).reshape(-1, 3)

    def targets(self, name, primitive=0):
        """Targets (K, m, 3) of an attribute."""
        targets = self.primitives[primitive]["targets"]
        return np.array([self.array(target[name]) for target in targets], float)

    def track(self):
        """Times (F,) and weights (F, K)."""
        (animation,) = self.json["animations"]
        (channel,) = animation["channels"]
        assert channel["target"] == {"node": 0, "path": "weights"}
        sampler = animation["samplers"][channel["sampler"]]
        assert sampler.get("interpolation", "LINEAR") == "LINEAR"
        times = self.array(sampler["input"])[:, 0]
        return times, self.array(sampler["output"]).reshape(len(times), -1)

    def morph(self, name, primitive=0):
        """An attribute (F, m, 3) at each time, in the file's own space."""
        _, weights = self.track()
        base = self.attribute(name, primitive).astype(float)
        return base + np.einsum("ft,tmx->fmx", weights, self.targets(name, primitive))

    def frames(self):
        """Morphed positions at each time, in the file's own space: the times, and (F, m, 3)."""
        return self.track()[0], self.morph("POSITION")

    # --- skins

    def local_matrices(self, moment):
        """Each node's own transform (4, 4) at a key of the animation."""
        nodes = [dict(node) for node in self.json["nodes"]]
        (animation,) = self.json["animations"]
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            value = self.value(sampler, moment, channel["target"]["path"] == "rotation")
            nodes[channel["target"]["node"]][channel["target"]["path"]] = value
        return [make_matrix(node) for node in nodes]

    def value(self, sampler, moment, turns):
        """What a sampler gives at a frame, by lines or even turns between its keys."""
        (animation,) = self.json["animations"]
        own = self.array(sampler["input"])[:, 0].astype(float)
        values = self.array(sampler["output"]).astype(float)
        if len(own) == 1:
            return values[0]
        ((fps, step, _),) = animation["extras"].values()
        time = np.clip(np.float32(moment * step / fps), own[0], own[-1])
        if turns:
            return Slerp(own, Rotation.from_quat(values))(time).as_quat()
        return np.array([np.interp(time, own, column) for column in values.T])

    def skinned(self, moment, name="POSITION"):
        """Vertices (m, 3) in the space of the scene, at a key of the animation; or their normals.

        Normals are turned and scaled, and not of length 1.
        """
        local, nodes = self.local_matrices(moment), self.json["nodes"]
        world = [None] * len(nodes)

        def place(number, above):
            world[number] = above @ local[number]
            for child in nodes[number].get("children", []):
                place(child, world[number])

        for number in self.json["scenes"][0]["nodes"]:
            place(number, np.eye(4))
        (skin,) = self.json["skins"]
        inverse = self.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
        moves = np.array([world[k] for k in skin["joints"]]) @ inverse
        points = np.insert(self.attribute(name).astype(float), 3, name == "POSITION", axis=1)
        found = np.zeros((len(points), 3))
        for joints, weights in self.influences():
            for j, w in zip(joints.T, weights.T, strict=True):
                found += w[:, None] * np.einsum("mab,mb->ma", moves[j], points)[:, :3]
        return found

    def influences(self):
        """Joints (m, 4) and weights (m, 4) of each set."""
        sets = [name for name in self.primitives[0]["attributes"] if name.startswith("JOINTS_")]
        for k in range(len(sets)):
            yield self.attribute(f"JOINTS_{k}"), self.attribute(f"WEIGHTS_{k}").astype(float)


def make_matrix(node):
    """The transform (4, 4) of a node."""
    matrix = np.eye(4)
    turn = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
    matrix[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]))
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix
