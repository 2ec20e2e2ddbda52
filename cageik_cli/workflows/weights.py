"""The weights of vertices that a run is given: one per vertex, or one per frame and vertex."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.file_data import hash_file
from cageik_cli.formats.vertex_weights import (
    FrameWeightsFile,
    load_vertex_weights,
    open_frame_weights,
)
from cageik_cli.solver.dual_laplacian import normalize_weights
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import error_context
from cageik_cli.util.text import to_unicode


@dataclass(frozen=True, slots=True, eq=False)
class LoadedWeights:
    """Weights of vertices, and where they came from.

    Attributes
    ----------
    vertices : (m,) float64
        Of mean one; all are equal if each frame has its own.
    frames : FrameWeightsFile, optional
        What these are multiplied by in each frame.
    source : dict
        `name` and `sha256` of the file.
    """

    vertices: Floats
    frames: FrameWeightsFile | None
    source: dict[str, str]


def load_weights(path: Path, frames: int, vertices: int) -> LoadedWeights:
    """Load the weights in a file, for so many frames and vertices.

    Raises
    ------
    InputError
        Naming the file, when it cannot be read, or its numbers are no weights of the clip.
    """
    rows = open_frame_weights(path, frames, vertices)
    if rows is not None:
        source = {"name": to_unicode(path.name), "sha256": hash_file(path).hex()}
        return LoadedWeights(np.full(vertices, rows.largest / rows.mean), rows, source)
    loaded, source = load_vertex_weights(path)
    with error_context(path):
        return LoadedWeights(normalize_weights(loaded, vertices), None, source)
