"""How a clip is read: the choices and their defaults. This module imports no numerics."""

from dataclasses import dataclass, field
from typing import Final, Literal

LAYOUTS = ("fvx", "vxf", "fxv")
"""Orders of an array's axes: f frames, v vertices, x coordinates."""

AUTO: Final = "auto"
"""As the number of the rest pose: the frame in which the least of the surface touches."""

Gaps = Literal["refuse", "keep", "close"]
"""What is done with missing numbers of files: refused, kept in time, or closed."""

RestFrame = int | Literal["auto"]
"""Which frame is the rest pose: its number from 0, or `AUTO`."""


@dataclass(frozen=True, slots=True)
class ClipSettings:
    """Which frames of a clip to take, and how to read them.

    Attributes
    ----------
    selection : slice
        Which of its frames, as Python slices; the step is above zero.
    layout : str, optional
        The order of an array's axes, one of `LAYOUTS`; found from their lengths if absent.
    gaps : {"refuse", "keep", "close"}
        What is done when numbers of files are missing. They are refused; or kept, as frames
        without files; or closed, so that the frames follow one another.
    missing : bool
        Take vertices whose position is not a number as missing.
    """

    selection: slice = field(default_factory=lambda: slice(None))
    layout: str | None = None
    gaps: Gaps = "refuse"
    missing: bool = False


DEFAULT_MORPHS = 60
"""Morph targets at most, where neither their number nor a tolerance is given."""

MAX_MORPHS = 256
"""Morph targets at most: all that WebGL 2 guarantees room for, as layers of a texture."""


@dataclass(frozen=True, slots=True)
class MorphSettings:
    """How a file of morph targets follows the frames.

    Attributes
    ----------
    count : int, optional
        Targets at most; `MAX_MORPHS` with a tolerance, else `DEFAULT_MORPHS`, if absent.
    tolerance : float, optional
        Largest distance of a vertex from its place in a frame, percent of the diagonal of the rest
        pose.
    has_normals : bool
        Write normals, which morph too.
    """

    count: int | None = None
    tolerance: float | None = None
    has_normals: bool = False

    @property
    def limit(self) -> int:
        """Targets at most."""
        if self.count is not None:
            return self.count
        return DEFAULT_MORPHS if self.tolerance is None else MAX_MORPHS
