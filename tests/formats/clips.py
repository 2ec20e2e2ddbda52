"""An animation to write, and what every writer of files must do with it."""

import numpy as np
from pxr import Usd, UsdValidation

from cageik_cli.formats.settings import Scene
from tests.formats.written import write
from tests.shapes import octahedron

SCENE = Scene(fps=30.0, start=11.0, up_axis="Z", metres_per_unit=0.01)
REST = octahedron()
FRAMES = REST.vertices + np.random.default_rng(5).normal(0, 0.1, (7, 6, 3))


def written(path, frames=FRAMES, rest=REST, scene=SCENE, size=3):
    """Write an animation, `size` frames at a time."""
    return write(path, rest, frames, size, scene, "hero", overwrite=True)


def faults_of(path):
    """What USD's own validators say of a file."""
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path)))
    return [error.GetErrorAsString() for error in found]
