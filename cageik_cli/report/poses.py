"""The poses that a page draws: the rest pose, the worst, the median and the best frame."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.store.result import Result, read_posed_frames, read_weights
from cageik_cli.util.arrays import Floats, Integers

LABELS = ("worst", "median", "best")


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A model as it was given, as its cage rebuilds it, and the cage.

    Attributes
    ----------
    label : str
        "rest", "worst", "median" or "best".
    name : str
        The frame's; "rest pose" for the rest pose.
    given, rebuilt : (m, 3) float64
    cage : (n, 3) float64
    deviation : (m,) float64
        |v̂ − v|, percent of the diagonal.
    """

    label: str
    name: str
    given: Floats
    rebuilt: Floats
    cage: Floats
    deviation: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """What a page draws.

    Attributes
    ----------
    faces, cage_faces : (t, 3) and (f, 3) int64
    poses : tuple of Pose
        The rest pose first.
    vertex_rms : (m,) float64
        Of each vertex over the frames, percent of the diagonal; nan for missing data.
    up_axis : str
        "Y" or "Z".
    """

    faces: Integers
    cage_faces: Integers
    poses: tuple[Pose, ...]
    vertex_rms: Floats
    up_axis: str


def poses_of(result: Result) -> Poses | None:
    """The poses of a result; None if it was written without its weights.

    Raises
    ------
    InputError
        When the file is damaged.
    """
    weights = read_weights(result)
    if weights is None:
        return None
    rest, cage, diagonal = result.rest, result.cage, result.rest.diagonal
    rebuilt = weights @ cage.vertices
    missed = _percent((rebuilt - rest.vertices) / diagonal)
    poses = [Pose("rest", "rest pose", rest.vertices, rebuilt, cage.vertices, missed)]
    held = read_posed_frames(result, weights)
    for k, label in enumerate(LABELS):
        name, rebuilt, misses = result.frames[held.frames[k]], held.rebuilt[k], held.misses[k]
        given = rebuilt + diagonal * misses
        poses.append(Pose(label, name, given, rebuilt, held.cages[k], _percent(misses)))
    vertex_rms = 100 * result.vertex_rms / diagonal
    return Poses(rest.faces, cage.faces, tuple(poses), vertex_rms, result.scene.up_axis)


def _percent(misses: Floats) -> Floats:
    return np.asarray(100 * np.linalg.norm(misses, axis=1))
