"""Vertices of files that hold the corners of triangles alone: equal ones are welded, once."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import ConnectivityError
from cageik_cli.util.messages import say
from cageik_cli.util.text import format_count

ROUNDING = float(np.finfo(np.float32).eps)
"""Corners of one vertex differ by this share of the largest coordinate at most: by their rounding
to single precision."""


def weld_corners(corners: Floats, solids: Integers) -> tuple[Floats, Integers]:
    """Return the different positions among corners, and the number of each corner's.

    They are numbered as they come. A corner that is not a number is equal to none.

    Parameters
    ----------
    corners : (c, 3)
    solids : (c,)
        The solid of each corner, ascending; corners of two solids are never welded.

    Returns
    -------
    vertices : (n, 3)
    numbers : (c,)
    """
    order = np.lexsort((*corners.T, solids))  # stable: equal corners stay in their order
    ordered, owners = corners[order], solids[order]
    differs = (ordered[1:] != ordered[:-1]).any(axis=1) | (owners[1:] != owners[:-1])
    is_new = np.concatenate([[True], differs])
    firsts = order[is_new]
    by_place = np.argsort(firsts)
    ranks = np.empty(len(firsts), np.int64)
    ranks[by_place] = np.arange(len(firsts))
    numbers = np.empty(len(corners), np.int64)
    numbers[order] = ranks[np.cumsum(is_new) - 1]
    return corners[firsts[by_place]], numbers


@dataclass(frozen=True, eq=False)
class CornerMap:
    """Which vertex each corner of a mesh is, for files of the same triangles in the same order.

    Attributes
    ----------
    numbers : (c,) int64
        Numbers of vertices, three for each triangle.
    vertex_count : int
    """

    numbers: Integers
    vertex_count: int

    @cached_property
    def _first_corners(self) -> Integers:
        """A corner of each vertex that has one, (n,)."""
        return np.asarray(np.unique(self.numbers, return_index=True)[1])

    def find_positions(self, corners: Floats) -> Floats:
        """Return the position of each vertex, (n, 3), of the positions of corners (c, 3).

        Raises
        ------
        ConnectivityError
            When there are more or fewer triangles, corners of a vertex are at several places, or
            some vertices are in no triangle.
        """
        if len(corners) != len(self.numbers):
            found, wanted = len(corners) // 3, len(self.numbers) // 3
            cut = "; if it is cut off, export it again" * (found < wanted)
            raise ConnectivityError(
                f"{found} triangles, the rest pose has {wanted}; all must share one "
                f"connectivity{cut}"
            )
        if len(self._first_corners) != self.vertex_count:
            lone = format_count(self.vertex_count - len(self._first_corners), "vertex")
            raise ConnectivityError(f"lacks {lone} of the rest pose, which no triangle has")
        vertices = corners[self._first_corners]
        own = vertices[self.numbers]
        largest = np.abs(corners[np.isfinite(corners)]).max(initial=0)
        is_near = np.isclose(corners, own, rtol=0, atol=ROUNDING * largest, equal_nan=True)
        apart = np.flatnonzero(~is_near.all(axis=1))
        if len(apart):
            self._refuse_split_corners(corners, int(apart[0]), len(apart))
        return vertices

    def _refuse_split_corners(self, corners: Floats, corner: int, count: int) -> None:
        vertex = int(self.numbers[corner])
        first = int(self._first_corners[vertex])
        here, there = ("({:g}, {:g}, {:g})".format(*corners[k]) for k in (first, corner))
        raise ConnectivityError(
            f"triangles {first // 3} and {corner // 3} (counted from 0) share vertex "
            f"{vertex} of the rest pose, but have it at {here} and {there} "
            f"({format_count(count, 'corner')} differ so); all frames must have the "
            "triangles in one order, and the format has no vertices, only corners: "
            + say(
                "export the frames as .obj or .ply, or give the mesh whose triangles they "
                "are by `rest=`, as .obj or .ply"
            )
        )


def number_as_rest(mesh: FileMesh, rest: TriMesh) -> FileMesh:
    """Return a mesh of welded corners with the vertices of the rest pose; itself if it has others.

    The rest pose keeps apart what is at one place, such as closed lips.
    """
    faces = rest.fan_triangulated.faces
    corner_map = CornerMap(faces.ravel(), len(rest.vertices))
    try:
        vertices = corner_map.find_positions(mesh.vertices[mesh.corners])
    except ConnectivityError:
        return mesh  # the rest pose is compared with the clip after that
    return replace(
        mesh,
        vertices=vertices,
        corners=corner_map.numbers,
        attributes=None,
        left_out=("vertices numbered as in the rest pose",),
    )


def number_as_clip(rest: TriMesh, first: TriMesh) -> TriMesh:
    """Return a rest pose of welded corners with the vertices of a clip; itself if it has others."""
    faces = first.fan_triangulated.faces
    if np.array_equal(rest.faces, faces):
        return rest
    corner_map = CornerMap(faces.ravel(), len(first.vertices))
    try:
        return TriMesh(corner_map.find_positions(rest.vertices[rest.faces.ravel()]), faces)
    except ConnectivityError:
        return rest  # it is compared with the clip after that
