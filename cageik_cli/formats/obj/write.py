"""OBJ files: positions of each frame, and all that is known of the surface."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.writer import Animation, FrameFileWriter
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.normals import compute_fan_normals
from cageik_cli.geometry.surface_attributes import SurfaceAttributes
from cageik_cli.geometry.surface_parts import NONE, FaceLabels
from cageik_cli.util.arrays import Floats, Integers

MIN_DIGITS = 9
"""Digits of coordinates, which distinguish all float32 values."""

MAX_DIGITS = 17
"""More than enough for all float64 values."""


class Writer(FrameFileWriter):
    """Writes vertices with nine digits, and with more where they are far from the origin.

    Polygons, UVs, names of faces and colours are those of the mesh. Normals are recomputed where
    it has some.
    """

    suffixes = (".obj",)

    def __init__(self, target: Path, animation: Animation) -> None:
        super().__init__(target, animation)
        self._rest, self._digits, self._template = animation.rest, 0, b""
        attributes = animation.rest.attributes
        has_normals = attributes is not None and attributes.normal_fans is not None
        self._shaded = attributes if has_normals else None

    def encode_frame(self, positions: Floats) -> bytes:
        """Return the text of one frame."""
        digits = count_digits(positions, self._rest.diagonal)
        if digits != self._digits:
            # One format of the whole file is several times as fast as one per line.
            self._digits, self._template = digits, make_obj_template(self._rest, digits)
        numbers = positions.ravel().tolist()
        if self._shaded is not None:
            numbers += compute_fan_normals(self._shaded, positions).ravel().tolist()
        return self._template % tuple(numbers)


def count_digits(positions: Floats, diagonal: float) -> int:
    """Return the digits with which positions are rounded by at most 5e-8 of the diagonal."""
    largest = float(np.abs(positions).max())
    if not largest > diagonal > 0:
        return MIN_DIGITS
    return min(MIN_DIGITS + int(np.log10(largest / diagonal)), MAX_DIGITS)


def make_obj_template(mesh: TriMesh, digits: int = MIN_DIGITS) -> bytes:
    """Return a format of the text of a mesh: it takes 3n positions, then 3u normals.

    `digits` are the significant digits of positions.
    """
    vertex = "v " + " ".join([f"%.{digits}g"] * 3)
    attributes = mesh.attributes
    if attributes is None:
        return f"{vertex}\n".encode() * len(mesh.vertices) + encode_faces(mesh.faces)
    library = _clean_name(attributes.material_library).replace("%", "%%")
    head = f"mtllib {library}\n" if library else ""
    head += "".join(_write_vertices(vertex, len(mesh.vertices), attributes.colours))
    if attributes.uvs is not None:
        head += "".join(f"vt {u!r} {v!r}\n" for u, v in attributes.uvs.values.tolist())
    if attributes.normal_fans is not None:
        head += "vn %.6g %.6g %.6g\n" * (int(attributes.normal_fans.max()) + 1)
    lines = _write_polygons(attributes)
    return head.encode() + "".join(lines).replace("%", "%%").encode()


def encode_faces(faces: Integers) -> bytes:
    """Return the lines of triangles (f, 3)."""
    return b"f %d %d %d\n" * len(faces) % tuple((faces + 1).ravel().tolist())


def encode_exact_obj(vertices: Floats, polygons: Iterable[Integers]) -> bytes:
    """Return the OBJ text of polygons whose vertices are read back to the last bit."""
    lines = b"v %r %r %r\n" * len(vertices) % tuple(vertices.ravel().tolist())
    faces = (" ".join(map(str, (ring + 1).tolist())) for ring in polygons)
    return lines + "".join(f"f {face}\n" for face in faces).encode()


def _write_vertices(vertex: str, count: int, colours: Floats | None) -> list[str]:
    """Return formats of the lines of vertices, with their colours."""
    if colours is None:
        return [f"{vertex}\n"] * count
    texts = (" ".join(map(repr, colour)) for colour in colours.tolist())
    return [f"{vertex} {text}\n" for text in texts]


def _write_polygons(attributes: SurfaceAttributes) -> Iterator[str]:
    """Yield the lines of the polygons, and before them those of names that change."""
    words = list(_write_corners(attributes))
    changes = _write_label_changes(attributes)
    starts = attributes.starts.tolist()
    for number, (start, count) in enumerate(
        zip(starts, attributes.corner_counts.tolist(), strict=True)
    ):
        yield from changes.get(number, ())
        yield f"f {' '.join(words[start : start + count])}\n"


def _write_corners(attributes: SurfaceAttributes) -> Iterator[str]:
    """Yield each corner as `v`, `v/vt`, `v//vn` or `v/vt/vn`, counted from 1."""
    absent = np.full(len(attributes.corners), NONE)
    uvs = absent if attributes.uvs is None else attributes.uvs.indices
    normals = absent if attributes.normal_fans is None else attributes.normal_fans
    columns = ((indices + 1).tolist() for indices in (attributes.corners, uvs, normals))
    for vertex, uv, normal in zip(*columns, strict=True):
        if normal:
            yield f"{vertex}/{uv or ''}/{normal}"
        else:
            yield f"{vertex}/{uv}" if uv else str(vertex)


def _write_label_changes(attributes: SurfaceAttributes) -> dict[int, list[str]]:
    """Return the lines of names before the polygons at which they change, by its number."""
    found: dict[int, list[str]] = {}
    for labels, keyword, none in (
        (attributes.objects, "o", "default"),
        (attributes.groups, "g", "default"),
        (attributes.materials, "usemtl", "default"),
        (attributes.smoothing, "s", "off"),
    ):
        for number, name in _find_changes(labels) if labels is not None else ():
            found.setdefault(number, []).append(f"{keyword} {_clean_name(name) or none}\n")
    return found


def _find_changes(labels: FaceLabels) -> Iterator[tuple[int, str]]:
    """Yield the polygons whose name is another than that of the one before, with the name."""
    changed = np.flatnonzero(np.diff(labels.indices, prepend=NONE))
    for number in changed.tolist():
        index = int(labels.indices[number])
        yield number, "" if index == NONE else labels.names[index]


def _clean_name(name: str) -> str:
    """Return a name without what OBJ takes for a comment, or for a line that continues."""
    name = name.replace("#", "_")
    return name[:-1] + "_" if name.endswith("\\") else name
