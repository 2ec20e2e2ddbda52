"""OBJ text parsed line by line: slow, obvious, and nothing shared with the package's parser."""

from itertools import pairwise

import numpy as np


def parse_by_lines(data):
    """Vertices (n, 3) and polygons of a text, or None if it holds no mesh."""
    vertices, polygons = [], []
    for line in logical_lines(data):
        words = line.split(b"#", 1)[0].split()
        try:
            if words[:1] == [b"v"]:
                if b"_" in b"".join(words[1:4]):
                    return None
                x, y, z = map(float, words[1:4])
                vertices.append((x, y, z))
            elif words[:1] == [b"f"]:
                indices = [int(word.split(b"/", 1)[0]) for word in words[1:]]
                corners = [k - 1 if k > 0 else k + len(vertices) for k in indices]
                if len(corners) < 3 or 0 in indices or min(corners) < 0:
                    return None
                polygons.append(corners)
        except ValueError:
            return None
    if not vertices or not polygons or max(map(max, polygons)) >= len(vertices):
        return None
    return np.array(vertices), polygons


def logical_lines(data):
    """Lines; one that ends in a backslash goes on in the next."""
    lines = iter(data.splitlines())
    for line in lines:
        while line.endswith(b"\\") and b"#" not in line:
            line = line[:-1] + b" " + next(lines, b"")
        yield line


def fans(polygons):
    """Triangles of polygons, at their first corners."""
    return [[first, b, c] for first, *others in polygons for b, c in pairwise(others)]
