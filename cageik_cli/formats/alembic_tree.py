"""Where the parts of a model are in an Alembic archive, in which only transforms move meshes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
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

    Programs call an object by the transform above its mesh. So a part is a transform of its name
    with the mesh below, unless it is alone below a transform whose name its own begins with, as
    in archives of such programs. A part at the top that nothing moves has no transform.
    """
    paths = [f"/{part.name.strip('/')}" for part in parts]
    folders = [path.rpartition("/")[0] for path in paths]
    crowd = Counter(folders)
    uppers = {upper for path in paths for upper in accumulate(path.split("/")[:-1], "{}/{}".format)}
    placed = []
    for part, path, folder in zip(parts, paths, folders, strict=True):
        name, above = path.rpartition("/")[2], folder.rpartition("/")[2]
        is_shape = crowd[folder] == 1 and name.startswith(above) and folder not in paths
        is_still = np.array_equal(part.transform, np.eye(4))
        if path not in uppers and (is_shape if folder else is_still):
            placed.append(PlacedPart(part, folder, name))
        else:
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
