"""A clip shown beside the clip expected, and expectations that are wrong."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Clip:
    """Positions and faces.

    Attributes
    ----------
    frames : (F, m, 3)
        In the axes and units of the file.
    faces : (f, 3)
        Counter-clockwise seen from outside.
    diagonal : float
        Of the bounding box of the rest pose.
    """

    frames: np.ndarray
    faces: np.ndarray
    diagonal: float


def in_file_axes(points: np.ndarray, up_axis: str, metres_per_unit: float) -> np.ndarray:
    """Positions (..., 3) in Blender's space, metres with z up, as the file has them."""
    x, y, z = np.moveaxis(points / metres_per_unit, -1, 0)
    return np.stack([x, z, -y] if up_axis == "Y" else [x, y, z], axis=-1)


def furthest(found: Clip, expected: Clip) -> float:
    """Largest difference of a coordinate, relative to the diagonal."""
    return float(np.abs(found.frames - expected.frames).max() / expected.diagonal)


def have_same_faces(found: Clip, expected: Clip) -> bool:
    """Whether faces are the same, in order, whatever corner each begins with."""
    return np.array_equal(_turned(found.faces), _turned(expected.faces))


def _turned(faces: np.ndarray) -> np.ndarray:
    """The same faces, each from its smallest corner on."""
    start = faces.argmin(axis=1)[:, None]
    return np.take_along_axis(faces, (start + np.arange(3)) % 3, axis=1)


def wrong_clips(clip: Clip, shift: float) -> Iterator[tuple[str, Clip]]:
    """What a comparison must not pass, each with its name; `shift` is relative to the diagonal."""
    moved, swapped = clip.frames.copy(), clip.frames.copy()
    moved[-1, -1, 1] += shift * clip.diagonal
    swapped[:, [0, -1]] = swapped[:, [-1, 0]]
    yield "a vertex moved", replace(clip, frames=moved)
    yield "two vertices swapped", replace(clip, frames=swapped)
    yield "a frame late", replace(clip, frames=np.roll(clip.frames, 1, axis=0))
    yield "mirrored", replace(clip, frames=clip.frames * [-1, 1, 1])
    yield "faces turned", replace(clip, faces=clip.faces[:, ::-1])
