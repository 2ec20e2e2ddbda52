"""glTF files under construction, packed number by number."""

import base64
import json
import struct

import numpy as np

CODES = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125, "f": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Built:
    """A document to which arrays, nodes and meshes are added."""

    def __init__(self):
        self.json = {"asset": {"version": "2.0"}, "nodes": [], "meshes": []}
        self.json |= {"accessors": [], "bufferViews": [], "buffers": []}
        self.blob = b""

    def add(self, kind, value):
        """Add an object to a list of the document, and return its number."""
        self.json.setdefault(kind, []).append(value)
        return len(self.json[kind]) - 1

    def view(self, data, **more):
        """Add bytes as a buffer view, behind a few that nothing uses."""
        self.blob += bytes(4 + -len(self.blob) % 4)
        start = len(self.blob)
        self.blob += data
        place = {"buffer": 0, "byteOffset": start, "byteLength": len(data)}
        return self.add("bufferViews", place | more)

    def array(self, rows, letter="f", scale=None, stride=None, sparse=None, is_dense=True):
        """Add an accessor.

        `scale` makes fractions of integers: the largest stands for 1. `sparse` are rows that
        replace others, by number. Without `is_dense` the others are zeros, and not in the file.
        """
        rows = np.atleast_2d(np.asarray(rows, float).T).T
        raw = np.rint(rows * scale) if scale else rows
        width = rows.shape[1]
        held = {"componentType": CODES[letter], "count": len(rows), "type": TYPES[width]}
        if scale:
            held["normalized"] = True
        if is_dense:
            size = struct.calcsize(f"<{width}{letter}")
            gap = bytes((stride or size) - size)
            data = b"".join(pack(row, letter) + gap for row in raw)
            more = {"byteStride": stride} if stride else {}
            held["bufferView"] = self.view(data, **more)
        if sparse:
            changed = np.array([raw[k] if value is None else value for k, value in sparse.items()])
            held["sparse"] = {
                "count": len(sparse),
                "indices": {
                    "bufferView": self.view(pack(np.array(list(sparse)), "H")),
                    "componentType": CODES["H"],
                },
                "values": {"bufferView": self.view(pack(changed.ravel(), letter))},
            }
        return self.add("accessors", held)

    def animate(self, name, *channels):
        """Add an animation of channels (node, path, keys, values, interpolation)."""
        animation = {"name": name, "channels": [], "samplers": []}
        for node, path, keys, values, interpolation in channels:
            sampler = {"input": self.array(keys), "output": self.array(values)}
            animation["samplers"].append(sampler | {"interpolation": interpolation})
            target = {"node": node, "path": path}
            number = len(animation["channels"])
            animation["channels"].append({"sampler": number, "target": target})
        return self.add("animations", animation)

    def save(self, path):
        """Write a .glb, or a .gltf with its buffer beside it, or inside without `blob` in it."""
        document = self.json | {"buffers": [{"byteLength": len(self.blob)}]}
        if "scenes" not in document:
            below = {child for node in self.json["nodes"] for child in node.get("children", ())}
            tops = [k for k in range(len(self.json["nodes"])) if k not in below]
            document |= {"scene": 0, "scenes": [{"nodes": tops}]}
        document = {key: value for key, value in document.items() if value != []}
        if path.suffix == ".gltf":
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.blob).decode()
            if "blob" in path.name:
                uri = f"{path.stem} data.bin".replace(" ", "%20")
                (path.parent / f"{path.stem} data.bin").write_bytes(self.blob)
            document["buffers"][0]["uri"] = uri
            path.write_text(json.dumps(document))
            return path
        path.write_bytes(make_glb(json.dumps(document).encode(), self.blob))
        return path


def make_glb(text, blob):
    """The bytes of a .glb file."""
    text += b" " * (-len(text) % 4)
    blob += bytes(-len(blob) % 4)
    size = 28 + len(text) + len(blob)
    header = struct.pack("<4sIII4s", b"glTF", 2, size, len(text), b"JSON")
    return header + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob


def pack(values, letter):
    values = np.asarray(values).ravel().tolist()
    return struct.pack(f"<{len(values)}{letter}", *(values if letter == "f" else map(int, values)))
