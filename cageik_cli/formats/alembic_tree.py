"""Where the parts of a model are in an Alembic archive, in which only transforms move meshes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cageik_cli.geometry.parts import Part
from cageik_cli.util.arrays import Floats

SHAPE_SUFFIX = "Shape"
"""What is added to the name of a mesh that is below a transform of its own name."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPart:
    """A part, the name of its mesh, and the path of the transform above; empty for none."""

    part: Part
    above: str
    name: str


def place_parts(parts: Sequence[Part]) -> list[PlacedPart]:
    """Return where the meshes are, at the paths of their parts.

    The transform of parts that are alone above it moves that, as other programs do. A part
    beside others that are elsewhere is a transform of its name, with the mesh below.
    """
    paths = [f"/{part.name.strip('/')}" for part in parts]
    folders = [path.rpartition("/")[0] for path in paths]
    placed = []
    for part, path, folder in zip(parts, paths, folders, strict=True):
        beside = [other for other, above in zip(parts, folders, strict=True) if above == folder]
        is_alike = all(np.array_equal(other.transform, part.transform) for other in beside)
        is_above = any(other.startswith(f"{path}/") for other in paths)
        is_free = bool(folder) or np.array_equal(part.transform, np.eye(4))
        is_free &= folder not in paths  # whose transform is that of a part
        if is_alike and is_free and not is_above:
            placed.append(PlacedPart(part, folder, path.rpartition("/")[2]))
        else:
            name = path.rpartition("/")[2]
            placed.append(PlacedPart(part, path, f"{name}{SHAPE_SUFFIX}"))
    return placed


class TransformTree:
    """The transforms above meshes, which are written as they are needed.

    Parameters
    ----------
    top : OObject
        The top of the archive.
    """

    def __init__(self, top: Any, placed: Sequence[PlacedPart]) -> None:
        self._objects: dict[str, Any] = {"": top}
        self._matrices: dict[str, Floats] = {"": np.eye(4)}
        for place in placed:
            self._matrices.setdefault(place.above, place.part.transform)

    def define(self, path: str) -> Any:
        """Return the transform at a path; those above it are written first."""
        if path not in self._objects:
            from alembic3d.AbcGeom import OXform

            above, _, name = path.rpartition("/")
            parent = self.define(above)
            matrix = self._matrices.setdefault(path, self._matrices[above])
            local = matrix @ np.linalg.inv(self._matrices[above])
            transform = OXform(parent, name)
            if not np.array_equal(local, np.eye(4)):
                _set_matrix(transform.getSchema(), local)
            self._objects[path] = transform
        return self._objects[path]


def _set_matrix(schema: Any, matrix: Floats) -> None:
    import imath
    from alembic3d.AbcGeom import XformSample

    sample = XformSample()
    sample.setMatrix(imath.M44d(*matrix.ravel().tolist()))
    schema.set(sample)
