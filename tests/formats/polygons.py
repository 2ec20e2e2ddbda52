"""Polygons in every format of mesh files, for tests."""

import numpy as np

MESH_KINDS = ("obj", "off", "ply", "binary.ply")
PLY_HEADER = """ply
format {} 1.0
element vertex {}
property float x
property float y
property float z
element face {}
property list uchar int vertex_indices
end_header
"""


def encode_polygons(kind, points, polygons):
    """The content of a file of one of `MESH_KINDS`; a binary one is in single precision."""
    rows = ["{} {} {}".format(*point) for point in np.asarray(points).tolist()]
    if kind == "obj":
        faces = [" ".join(str(corner + 1) for corner in ring) for ring in polygons]
        return "".join(
            [*(f"v {row}\n" for row in rows), *(f"f {ring}\n" for ring in faces)]
        ).encode()
    rings = [" ".join(map(str, [len(ring), *ring])) for ring in polygons]
    if kind == "binary.ply":
        head = PLY_HEADER.format("binary_little_endian", len(rows), len(rings)).encode()
        lists = [bytes([len(ring)]) + np.array(ring, "<i4").tobytes() for ring in polygons]
        return head + np.asarray(points, "<f4").tobytes() + b"".join(lists)
    head = f"OFF\n{len(rows)} {len(rings)} 0\n"
    if kind == "ply":
        head = PLY_HEADER.format("ascii", len(rows), len(rings))
    return (head + "\n".join([*rows, *rings, ""])).encode()
