"""Where meshes are in an Alembic archive: their paths, and the transforms above them."""

from collections import Counter
from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import numpy as np

from cageik_cli.util.arrays import Floats

SHAPE_SUFFIX = "Shape"
"""What is added to the name of a mesh that is below a transform of its own name."""

SAME_TIME_TOL = 1e-6
"""Times that differ by less than this share of a step are one: seconds of other rates round."""


def place_meshes(parts: Sequence[str], are_still: Sequence[bool]) -> list[str]:
    """Return the paths of the meshes of parts, which are at these paths.

    Programs call an object by the transform above its mesh. So a part is a transform of its name
    with the mesh below, unless it is alone below a transform whose name its own begins with, as
    in archives of such programs. A part at the top that nothing moves has no transform.
    """
    folders = [path.rpartition("/")[0] for path in parts]
    crowd = Counter(folders)
    uppers = {upper for path in parts for upper in accumulate(path.split("/")[:-1], "{}/{}".format)}
    taken, placed = set(parts), []
    for path, folder, is_still in zip(parts, folders, are_still, strict=True):
        name, above = path.rpartition("/")[2], folder.rpartition("/")[2]
        is_shape = crowd[folder] == 1 and name.startswith(above) and folder not in taken
        if path not in uppers and (is_shape if folder else is_still):
            placed.append(path)
        else:
            placed.append(f"{path}/{name}{SHAPE_SUFFIX}")
    return placed


def name_parts(meshes: Sequence[str], are_still: Sequence[bool]) -> list[str]:
    """Return the paths of parts whose meshes are at these paths.

    A mesh `NAME/NAMEShape` is the part `NAME`, where `place_meshes` puts that part there again.
    """
    parts = list(meshes)
    for k, path in enumerate(meshes):
        folder = path.rpartition("/")[0]
        if folder and path == f"{folder}/{folder.rpartition('/')[2]}{SHAPE_SUFFIX}":
            parts[k] = folder
    while True:
        placed, counts = place_meshes(parts, are_still), Counter(parts)
        lost = [
            k
            for k, path in enumerate(meshes)
            if parts[k] != path and (placed[k] != path or counts[parts[k]] > 1)
        ]
        if not lost:
            return parts
        for k in lost:
            parts[k] = meshes[k]


def find_transforms(thing: Any) -> list[Any]:
    """Return the transforms that move an object, its own first."""
    from alembic3d.Abc import WrapExistingFlag
    from alembic3d.AbcGeom import IXform

    found = []
    while thing.getParent().valid():
        if IXform.matches(thing.getHeader()):
            found.append(IXform(thing, WrapExistingFlag.kWrapExisting).getSchema())
            if not found[-1].getInheritsXforms():
                break
        thing = thing.getParent()
    return found


def locate_samples(sampled: Any, time: float) -> tuple[int, int, float]:
    """Return the samples before and after a time, and the part of the way between them.

    At a sample, to rounding of its time, they are the same.
    """
    count, sampling = sampled.getNumSamples(), sampled.getTimeSampling()
    start, stop = sampling.getFloorIndex(time, count), sampling.getCeilIndex(time, count)
    begin, end = sampling.getSampleTime(start), sampling.getSampleTime(stop)
    part = (time - begin) / (end - begin) if end > begin else 0.0
    if part < SAME_TIME_TOL:
        return start, start, 0.0
    return (stop, stop, 0.0) if part > 1 - SAME_TIME_TOL else (start, stop, part)


def interpolate_matrix(transform: Any, time: float) -> Floats:
    """Return a transform at a time, interpolated linearly between two samples."""
    from alembic3d.Abc import ISampleSelector

    if transform.getNumSamples() == 0:
        return np.eye(4)
    start, stop, part = locate_samples(transform, time)
    before, after = (
        # By its time: a selector would take an index for seconds, too.
        np.array([list(row) for row in transform.getValue(ISampleSelector(at)).getMatrix()])
        for at in map(transform.getTimeSampling().getSampleTime, (start, stop))
    )
    return np.asarray(before + part * (after - before))


def is_still(thing: Any) -> bool:
    """Return whether no transform places an object, at second 0."""
    moves = [interpolate_matrix(each, 0.0) for each in find_transforms(thing)]
    return all(np.array_equal(matrix, np.eye(4)) for matrix in moves)


class TransformTree:
    """The transforms above meshes, which are written as they are needed.

    Parameters
    ----------
    top : OObject
        The top of the archive.
    matrices : dict
        The transforms (4, 4) into the scene that some of them have, by their paths.
    """

    def __init__(self, top: Any, matrices: dict[str, Floats]) -> None:
        self._objects: dict[str, Any] = {"": top}
        self._matrices = {**matrices, "": np.eye(4)}

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
