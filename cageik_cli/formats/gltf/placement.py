"""Where an animation is in a glTF scene: its times, its axes and its unit."""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.writer import Animation
from cageik_cli.formats.scene import Scene
from cageik_cli.util.errors import OutputError

_Z_TO_Y = [-sqrt(0.5), 0.0, 0.0, sqrt(0.5)]
"""The quaternion (x, y, z, w) of −90° about x: from z up to y up, which glTF has."""


def check_start(scene: Scene) -> tuple[str, ...]:
    """Return a note on a late first frame.

    Raises
    ------
    OutputError
        When the first frame is before time 0.
    """
    if scene.start < 0:
        raise OutputError(
            f"the number of the first frame is {scene.start:.10g}, and glTF has no "
            "time before 0; give another with --start, or write .usdc or .abc"
        )
    seconds = scene.start / scene.fps
    if seconds <= 1:
        return ()
    return (
        f"the first frame is at {seconds:.4g} s, as its number says, and players wait "
        "until then; --start 0 begins at once",
    )


def compute_times(animation: Animation) -> NDArray[np.float32]:
    """Return the time of each frame, (F,), seconds."""
    scene = animation.scene
    numbers = scene.start + scene.frame_step * np.arange(animation.frame_count)
    return np.asarray(numbers / scene.fps, np.float32)


def make_node_transform(scene: Scene) -> dict[str, list[float]]:
    """Return a node's transform into metres and y up; empty if the scene has these."""
    placement = {}
    if scene.up_axis == "Z":
        placement["rotation"] = _Z_TO_Y
    if scene.metres_per_unit != 1:
        placement["scale"] = [scene.metres_per_unit] * 3
    return placement
