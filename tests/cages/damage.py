"""A fit cage damaged in twelve ways, each reproducible."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import merged


def turn_faces(cage, generator):
    """Every third face the wrong way round."""
    faces = cage.faces.copy()
    faces[::3] = faces[::3, ::-1]
    return TriMesh(cage.vertices, faces)


def turn_inward(cage, generator):
    """All faces the wrong way round."""
    return cage.flip()


def separate_faces(cage, generator):
    """Each face with vertices of its own."""
    return TriMesh(
        cage.vertices[cage.faces].reshape(-1, 3), np.arange(3 * len(cage.faces)).reshape(-1, 3)
    )


def repeat_faces(cage, generator):
    """Faces twice, some seen from their other side, a loose face and unreferenced vertices."""
    count = len(cage.vertices)
    far = cage.vertices.max(axis=0) + cage.diagonal * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    faces = [cage.faces, cage.faces[5:9], cage.faces[20:22, ::-1], [[count, count + 1, count + 2]]]
    vertices = np.concatenate([cage.vertices, far, far.mean(axis=0, keepdims=True)])
    return TriMesh(vertices, np.concatenate(faces))


def open_holes(cage, generator):
    """Without the faces around one vertex, and without one face elsewhere."""
    hub = int(generator.integers(len(cage.vertices)))
    around = (cage.faces == hub).any(axis=1)
    apart = ~np.isin(cage.faces, cage.faces[around]).any(axis=1)
    gone = around.copy()
    gone[np.flatnonzero(apart)[generator.integers(apart.sum())]] = True
    return TriMesh(cage.vertices, cage.faces[~gone])


def add_inner_shell(cage, generator):
    """A small copy of itself inside."""
    return merged(cage, _scale(cage, 0.05))


def shrink(cage, generator):
    """Smaller by 5 %, so that it is not inflated."""
    return _scale(cage, 0.95)


def dent(cage, generator):
    """Three vertices moved by 5 % of the diagonal."""
    return _move(cage, generator, 3, 0.05)


def spike(cage, generator):
    """One vertex moved by 20 % of the diagonal."""
    return _move(cage, generator, 1, 0.2)


def shake(cage, generator):
    """Every vertex moved by 1 % of the diagonal."""
    return _move(cage, generator, len(cage.vertices), 0.01)


def swap(cage, generator):
    """Two neighbours each at the other's place."""
    vertices = cage.vertices.copy()
    ends = cage.edges.ends[generator.integers(len(cage.edges.ends))]
    vertices[ends] = vertices[ends[::-1]]
    return TriMesh(vertices, cage.faces)


def change_axes_and_unit(cage, generator):
    """In centimetres instead of metres, with z up instead of y up."""
    x, y, z = cage.vertices.T
    return TriMesh(100 * np.column_stack([x, -z, y]), cage.faces)


DAMAGES = (
    turn_faces,
    turn_inward,
    separate_faces,
    repeat_faces,
    open_holes,
    add_inner_shell,
    shrink,
    dent,
    spike,
    shake,
    swap,
    change_axes_and_unit,
)


def _scale(cage, factor):
    centre = cage.vertices.mean(axis=0)
    return TriMesh(centre + factor * (cage.vertices - centre), cage.faces)


def _move(cage, generator, count, share):
    chosen = generator.choice(len(cage.vertices), count, replace=False)
    direction = generator.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    vertices = cage.vertices.copy()
    vertices[chosen] += share * cage.diagonal * direction
    return TriMesh(vertices, cage.faces)
