"""Meshes as they are read from files: polygons are cut into triangles, connectivities compared."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.ear_clipping import replace_folded_fans
from cageik_cli.formats.settings import SceneHints
from cageik_cli.geometry.attributes import (
    LAYERS,
    SurfaceAttributes,
    check_corner_counts,
    fan_triangulate,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import ConnectivityError, FormatError
from cageik_cli.util.messages import Note, say
from cageik_cli.util.text import format_count

LayerReaders = dict[str, Callable[[SurfaceAttributes], SurfaceAttributes]]
"""What adds each layer to the attributes before it, by its name in a note: "its normals"."""


@dataclass(frozen=True, slots=True, eq=False)
class FileMesh:
    """The content of a mesh file, not yet checked.

    Attributes
    ----------
    vertices : (n, 3) float64
        Each value is `float(text)` to the bit; may not be finite.
    corners : (c,) int64
        The vertices of the faces, from 0, one face after the other.
    corner_counts : (p,) int64
        How many corners each face has.
    attributes : SurfaceAttributes, optional
        What else the file says of the surface; its polygons alone if absent.
    left_out : tuple of str
        What of that cannot be used, or was changed, one sentence each.
    """

    vertices: Floats
    corners: Integers
    corner_counts: Integers
    attributes: SurfaceAttributes | None = None
    left_out: tuple[str, ...] = ()

    @staticmethod
    def from_polygons(vertices: Floats, polygons: Sequence[Sequence[int] | Integers]) -> "FileMesh":
        """Return the mesh of polygons, each given by its vertices."""
        counts = np.array([len(polygon) for polygon in polygons], np.int64)
        corners = np.fromiter(chain.from_iterable(polygons), np.int64, counts.sum())
        return FileMesh(vertices, corners, counts)

    @property
    def fans(self) -> Integers:
        """The faces cut into triangles (f, 3), as fans around their first corners."""
        return fan_triangulate(self.corners, self.corner_counts)

    @property
    def polygon_count(self) -> int:
        """Number of faces with more than three corners."""
        return int(np.count_nonzero(self.corner_counts > 3))

    def read_layers(self, layers: LayerReaders) -> "FileMesh":
        """Return it with all that its file says of the surface; a damaged layer is left out."""
        check_corner_counts(self.corner_counts)
        attributes, left_out = SurfaceAttributes(self.corner_counts, self.corners), []
        for noun, read in layers.items():
            try:
                attributes = read(attributes)
            except (FormatError, ValueError) as error:
                left_out.append(f"{noun} left out ({error})")
        return replace(self, attributes=attributes, left_out=tuple(left_out))

    def turn_faces(self) -> "FileMesh":
        """Return it with faces and attributes that turn the other way round."""
        assert self.attributes is not None
        turned = self.attributes.reverse(keeps_first=False)
        return replace(self, corners=turned.corners, attributes=turned)

    def make_mesh(self) -> TriMesh:
        """Return the checked mesh: polygons are fans, or ears where a fan would fold over."""
        mesh = TriMesh(self.vertices, self.fans)
        attributes = self.attributes
        if attributes is None and self.polygon_count:
            attributes = SurfaceAttributes(self.corner_counts, self.corners)
        if attributes is None or attributes.is_plain:
            return mesh
        return replace_folded_fans(replace(mesh, attributes=attributes))

    @property
    def notes(self) -> tuple[str, ...]:
        """What was changed, one sentence each."""
        if not self.polygon_count:
            return self.left_out
        return (describe_cut(self.polygon_count), *self.left_out)


def describe_cut(polygon_count: int) -> str:
    """Return a note on polygons with more than three corners."""
    return f"{format_count(polygon_count, 'polygon')} cut into triangles to compute with"


def list_layer_readers(
    names: Iterable[str], read: Callable[[str, SurfaceAttributes], SurfaceAttributes]
) -> LayerReaders:
    """Return what reads layers of numbers, with a function of the name of the layer."""
    return {f"its {LAYERS[name].noun}": partial(read, name) for name in names}


def check_not_points(vertex_count: int, face_count: int) -> None:
    """Refuse points without faces."""
    if vertex_count and not face_count:
        raise FormatError(
            f"is a point cloud: {vertex_count} points and no faces, expected a mesh; "
            "reconstruct its surface, or export the mesh with its faces; "
            + say("deform (`mesh=`) and pose take points as .ply")
        )


@dataclass(frozen=True, slots=True, eq=False)
class LoadedMesh:
    """A mesh and where it came from.

    Attributes
    ----------
    source : dict
        `name` and `sha256` of the file; the name alone of a frame of the clip.
    notes : tuple of Note
        What was changed.
    path : Path, optional
        The mesh file; None of a mesh that is in no file, or in one of many frames.
    scene : SceneHints
        Unit and up axis, as far as the file states them.
    is_welded : bool
        Whether its file holds corners alone, so that the numbers of its vertices mean nothing.
    """

    mesh: TriMesh
    source: dict[str, str]
    notes: tuple[Note, ...] = ()
    path: Path | None = None
    scene: SceneHints = field(default_factory=SceneHints)
    is_welded: bool = False


def check_connectivity(count: int, faces: Integers, expected: TriMesh, expected_name: str) -> None:
    """Refuse a mesh whose counts or `faces` differ from the expected ones."""
    for noun, found, wanted in (
        ("vertices", count, len(expected.vertices)),
        ("triangles", len(faces), len(expected.faces)),
    ):
        if found != wanted:
            cut = "; if it is cut off, export it again" * (found < wanted)
            raise ConnectivityError(
                f"{found} {noun}, {expected_name} has {wanted}; "
                f"all must share one connectivity{cut}"
            )
    if faces is expected.faces:
        return
    differs = np.flatnonzero((faces != expected.faces).any(axis=1))
    if len(differs):
        k = differs[0]
        raise ConnectivityError(
            f"triangle {k} joins vertices {_format_corners(faces[k])}, in {expected_name} "
            f"{_format_corners(expected.faces[k])} (counted from 0; {len(differs)} triangles "
            "differ); all must share one connectivity"
        )


def _format_corners(corners: Integers) -> str:
    return "-".join(map(str, corners))


def check_vertex_order(first: TriMesh, expected: TriMesh, expected_name: str) -> None:
    """Refuse a clip whose faces do not join the vertices that those of `expected` join.

    Other programs write faces in another order, from another corner or reversed, and cut quads
    along the other diagonal: the vertices keep their numbers, so that is accepted.
    """
    found = first.fan_triangulated
    counts = [(len(mesh.vertices), len(mesh.faces)) for mesh in (found, expected)]
    if counts[0] == counts[1]:
        if any(_has_same_edges(mesh, expected) for mesh in (found, first)):
            return
        if np.array_equal(_sorted_valences(found), _sorted_valences(expected)):
            raise ConnectivityError(
                f"as many vertices and triangles as {expected_name}, in another order; export it "
                "again from the mesh that cageik export wrote, and keep the vertex order"
            )
    check_connectivity(len(found.vertices), found.faces, expected, expected_name)


def _has_same_edges(mesh: TriMesh, expected: TriMesh) -> bool:
    """Return whether both have the same edges, apart from the diagonals of quads."""
    ours, theirs = mesh.edges.ends, expected.edges.ends
    new, lost = ~_rows_in(ours, theirs), ~_rows_in(theirs, ours)
    face, corner = np.nonzero(new[mesh.edges.side_edges])
    # The other diagonal joins the two corners opposite a new edge.
    edge = mesh.edges.side_edges[face, corner]
    facing = mesh.faces[face, corner][np.argsort(edge, kind="stable")]
    if (mesh.edges.face_counts[new] != 2).any():
        return False
    others = np.sort(facing.reshape(-1, 2), axis=1)
    return len(others) == np.count_nonzero(lost) and bool(_rows_in(theirs[lost], others).all())


def _sorted_valences(mesh: TriMesh) -> Integers:
    """Return the number of faces at each vertex, sorted."""
    return np.sort(np.bincount(mesh.faces.ravel()))


def _rows_in(pairs: Integers, others: Integers) -> np.ndarray:
    """Return which rows of `pairs` (a, 2) are rows of `others` (b, 2)."""
    base = int(max(pairs.max(initial=0), others.max(initial=0))) + 1
    return np.isin(pairs @ [base, 1], others @ [base, 1])
