"""Animations through writers, for tests."""

import numpy as np

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.write import Output


def write(path, mesh, frames, size=2, scene=None, name="thing", overwrite=False):
    """Write `frames` (F, m, 3) of the shape of `mesh` in blocks of `size`."""
    animation = Animation(mesh, len(frames), scene or Scene(), name)
    with Output(path, overwrite=overwrite).open_writer(animation) as writer:
        for start in range(0, len(frames), size):
            writer.append(frames[start : start + size])
    return path


def bytes_under(path):
    """The bytes of a file, or of every file of a folder by name."""
    if path.is_dir():
        return {file.name: file.read_bytes() for file in sorted(path.iterdir())}
    return path.read_bytes()


def single(frames):
    """Values as a file of float32 has them, as float64."""
    return np.asarray(frames, np.float32).astype(np.float64)
