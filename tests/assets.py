"""A model as artists make it: quads, UV islands, materials, groups; and a reader of its own.

The reader shares nothing with the package: it goes line by line.
"""

from dataclasses import dataclass

import numpy as np

SIDES = 5
"""Quads of the tube along and around."""


@dataclass(frozen=True)
class Asset:
    """What a line by line reading of an OBJ text finds.

    Attributes
    ----------
    vertices : (n, 3)
    polygons : list of list of int
    corner_uvs, corner_normals : list of list
        For each corner its values, or None.
    names : list of (object, group, material, smoothing)
        Of each polygon.
    colours : list
    library : str
    """

    vertices: np.ndarray
    polygons: list
    corner_uvs: list
    corner_normals: list
    names: list
    colours: list
    library: str


def parse_asset(text):
    """Read an OBJ text without continued lines."""
    vertices, uvs, normals, colours, library = [], [], [], [], ""
    polygons, corner_uvs, corner_normals, names = [], [], [], []
    current = {"o": "", "g": "", "usemtl": "", "s": "off"}
    for words in (line.split("#")[0].split() for line in text.splitlines()):
        kind, rest = (words[0], words[1:]) if words else ("", [])
        if kind == "v":
            vertices.append([float(word) for word in rest[:3]])
            colours.append([float(word) for word in rest[3:]])
        elif kind == "vt":
            uvs.append(tuple(float(word) for word in rest[:2]))
        elif kind == "vn":
            normals.append(tuple(float(word) for word in rest))
        elif kind in current:
            current[kind] = " ".join(rest)
        elif kind == "mtllib":
            library = " ".join(rest)
        elif kind == "f":
            corners = [[int(part) if part else 0 for part in word.split("/")] for word in rest]
            tables = [
                [_pick(table, corner, k) for corner in corners]
                for k, table in ((1, uvs), (2, normals))
            ]
            polygons.append([k[0] - 1 if k[0] > 0 else len(vertices) + k[0] for k in corners])
            corner_uvs.append(tables[0])
            corner_normals.append(tables[1])
            names.append(tuple(current.values()))
    return Asset(np.array(vertices), polygons, corner_uvs, corner_normals, names, colours, library)


def _pick(table, corner, part):
    index = corner[part] if len(corner) > part else 0
    return table[index - 1 if index > 0 else index] if index else None


def asset_text(size=1.0, normals=True):
    """A closed tube of quads with two caps of five corners, two UV islands and three materials."""
    angles = 2 * np.pi * np.arange(SIDES) / SIDES
    heights = np.linspace(-0.4, 0.4, SIDES + 1)
    lines = ["mtllib skins/tube 1.mtl", "o tube"]
    for z in heights:
        lines += [f"v {0.4 * np.cos(a):.6f} {0.4 * np.sin(a):.6f} {z:.6f}" for a in angles]
    scaled = []
    for line in lines:
        words = line.split()
        if words[0] == "v":
            line = "v " + " ".join(f"{size * float(word):.6f}" for word in words[1:])
        scaled.append(line)
    lines = scaled
    # The island of the tube has a seam: one more column than there are sides.
    lines += [f"vt {k / 10:.4f} {j / 10:.4f}" for j in range(SIDES + 1) for k in range(SIDES + 1)]
    lines += [f"vt {0.8 + 0.1 * np.cos(a):.4f} {0.8 + 0.1 * np.sin(a):.4f}" for a in angles]
    lines += ["vn 0 0 -1", "vn 0 0 1"] * normals
    lines += [f"vn {np.cos(a):.4f} {np.sin(a):.4f} 0" for a in angles] * normals
    cap = (SIDES + 1) ** 2
    lines += ["g tube side", "usemtl cloth", "s 1"]
    for j in range(SIDES):
        if j == SIDES // 2:
            lines.append("usemtl gold%1")
        for k in range(SIDES):
            after = (k + 1) % SIDES
            corners = [
                (j * SIDES + k, j * (SIDES + 1) + k, k),
                (j * SIDES + after, j * (SIDES + 1) + k + 1, after),
                ((j + 1) * SIDES + after, (j + 1) * (SIDES + 1) + k + 1, after),
                ((j + 1) * SIDES + k, (j + 1) * (SIDES + 1) + k, k),
            ]
            words = [
                f"{v + 1}/{t + 1}/{n + 3}" if normals else f"{v + 1}/{t + 1}" for v, t, n in corners
            ]
            lines.append("f " + " ".join(words))
    for name, ring, normal in (
        ("bottom", range(SIDES)[::-1], 1),
        ("top", range(SIDES * SIDES, SIDES * SIDES + SIDES), 2),
    ):
        lines += [f"g {name}", "usemtl skin", "s off"]
        words = [f"{v + 1}/{cap + v % SIDES + 1}" + f"/{normal}" * normals for v in ring]
        lines.append("f " + " ".join(words))
    return "\n".join(lines) + "\n"
