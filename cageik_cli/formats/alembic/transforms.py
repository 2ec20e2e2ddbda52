"""The transforms above an object of an archive, at any time."""

from typing import Any

import numpy as np

from cageik_cli.formats.base.scene_graph import blend_transforms
from cageik_cli.util.arrays import Floats

SAME_TIME_TOL = 1e-6
"""Times that differ by less than this share of a step are one: seconds of other rates round."""


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
    """Return a transform at a time between two samples.

    Its operations, such as a rotation by an angle, are interpolated linearly, as programs do.
    Matrices are taken apart for that, also those of rotations about changing axes: a turn stays a
    turn.
    """
    from alembic3d.Abc import ISampleSelector

    if transform.getNumSamples() == 0:
        return np.eye(4)
    start, stop, part = locate_samples(transform, time)
    before, after = (
        # By its time: a selector would take an index for seconds, too.
        transform.getValue(ISampleSelector(at))
        for at in map(transform.getTimeSampling().getSampleTime, (start, stop))
    )
    if part == 0:
        return _to_matrix(before)
    if before.isTopologyEqual(after):
        operations = [[each.getOp(k) for k in range(each.getNumOps())] for each in (before, after)]
        if all(map(_blends_by_channel, *operations)):
            return _blend_operations(before, after, part)
    return blend_transforms(_to_matrix(before), _to_matrix(after), part)


def _blends_by_channel(before: Any, after: Any) -> bool:
    """Return whether an operation between two of its kind has the numbers between theirs."""
    if before.isRotateOp():
        return bool(before.getAxis() == after.getAxis())
    return not before.isMatrixOp()


def _to_matrix(sample: Any) -> Floats:
    return np.array([list(row) for row in sample.getMatrix()])


def _blend_operations(before: Any, after: Any, part: float) -> Floats:
    """Return the matrix of a sample between two that have the same operations."""
    from alembic3d.AbcGeom import XformSample

    blend = XformSample()
    for k in range(before.getNumOps()):
        operation, other = before.getOp(k), after.getOp(k)
        for channel in range(operation.getNumChannels()):
            start, stop = (each.getChannelValue(channel) for each in (operation, other))
            operation.setChannelValue(channel, start + part * (stop - start))
        blend.addOp(operation)
    return _to_matrix(blend)


def is_still(thing: Any) -> bool:
    """Return whether no transform places an object, at second 0."""
    moves = [interpolate_matrix(each, 0.0) for each in find_transforms(thing)]
    return all(np.array_equal(matrix, np.eye(4)) for matrix in moves)
