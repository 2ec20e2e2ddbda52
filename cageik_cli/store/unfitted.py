"""What a result of fitted weights keeps of the weights before the fit, so that both are compared.

Receivers of fitted weights do not have the others, and computing them takes longer than a report.
"""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from cageik_cli.formats.base.hdf5 import get_dataset, open_checked, read_array
from cageik_cli.solver.metrics import are_lengths
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError

GROUP = "unfitted"

MAX_STORED_ERROR = float(np.finfo(np.float32).max)


@dataclass(frozen=True, slots=True, eq=False)
class UnfittedErrors:
    """The error of some frames with the weights before the fit.

    Attributes
    ----------
    frames : (k,) int64
        Their numbers in the clip; ascending.
    rms : (k,) float64
        In file units.
    """

    frames: Integers
    rms: Floats


@dataclass(frozen=True, slots=True, eq=False)
class UnfittedShapes:
    """What is drawn of the weights before the fit.

    Attributes
    ----------
    misses : (3 or 4, m, 3) float64
        v − v̂ of the frames that are kept in full, in diagonals of the rest model.
    cage_vertex : int
        The cage vertex whose weights the fit changed most.
    influence : (m,) float64
        Its weights before the fit.
    """

    misses: Floats
    cage_vertex: int
    influence: Floats


@dataclass(frozen=True, slots=True, eq=False)
class UnfittedClip:
    """A clip with the weights before the fit: errors, and what is drawn."""

    errors: UnfittedErrors
    shapes: UnfittedShapes


def write_unfitted(file: h5py.File, clip: UnfittedClip) -> None:
    """Write what is kept of the weights before the fit."""
    errors, shapes = clip.errors, clip.shapes
    misses = np.clip(shapes.misses, -MAX_STORED_ERROR, MAX_STORED_ERROR)
    file.create_dataset(f"{GROUP}/frame", data=errors.frames, dtype="i8")
    file.create_dataset(f"{GROUP}/rms", data=errors.rms, dtype="f8")
    file.create_dataset(f"{GROUP}/misses", data=misses, dtype="f4")
    file.create_dataset(f"{GROUP}/cage_vertex", data=[shapes.cage_vertex], dtype="i8")
    file.create_dataset(f"{GROUP}/influence", data=shapes.influence, dtype="f8")


def read_unfitted_errors(
    path: Path, frames: int, skipped: Collection[int]
) -> UnfittedErrors | None:
    """Read the errors of a clip of `frames` frames; None if the result keeps none.

    Raises
    ------
    InputError
        When they are damaged, or not of frames of the clip that were solved.
    """
    with open_checked(path) as file:
        if GROUP not in file:
            return None
        numbers = read_array(file, f"{GROUP}/frame", "iu", (None,)).astype(np.int64)
        rms = read_array(file, f"{GROUP}/rms", "f", numbers.shape).astype(np.float64)
        inside = ((numbers >= 0) & (numbers < frames)).all()
        ascends = (np.diff(numbers) > 0).all()
        if not inside or not ascends or np.isin(numbers, list(skipped)).any():
            raise FormatError(
                f"`{GROUP}/frame` are not ascending numbers of frames that were solved ({frames} "
                "frames); extract it again"
            )
        if not are_lengths(rms).all():
            raise FormatError(f"`{GROUP}/rms` is not a length everywhere; extract it again")
    return UnfittedErrors(numbers, rms)


def read_unfitted_shapes(path: Path, m: int, n: int) -> UnfittedShapes | None:
    """Read what is drawn; None if the result keeps none.

    Parameters
    ----------
    m, n : int
        Vertices of the model and of the cage.

    Raises
    ------
    InputError
        When it is damaged, or does not fit the meshes.
    """
    with open_checked(path) as file:
        if GROUP not in file:
            return None
        count = len(get_dataset(file, "poses/frame", "iu", (None,)))
        misses = read_array(file, f"{GROUP}/misses", "f", (count, m, 3)).astype(np.float64)
        vertex = int(read_array(file, f"{GROUP}/cage_vertex", "iu", (1,))[0])
        influence = read_array(file, f"{GROUP}/influence", "f", (m,)).astype(np.float64)
        for name, values in (("misses", misses), ("influence", influence)):
            if not are_lengths(np.abs(values)).all():
                raise FormatError(
                    f"`{GROUP}/{name}` are not finite, or too large; extract it again"
                )
        if not 0 <= vertex < n:
            raise FormatError(
                f"`{GROUP}/cage_vertex` is {vertex}, expected a vertex of the cage ({n} vertices); "
                "extract it again"
            )
    return UnfittedShapes(misses, vertex, influence)
