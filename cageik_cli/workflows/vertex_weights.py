"""The weights of vertices that a run is given: in a file, or by the area around each vertex."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.files import hash_file
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.vertex_weights import (
    FrameWeightsFile,
    open_frame_weights,
    read_vertex_weights,
)
from cageik_cli.solver.vertex_weights import make_vertex_weights
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import error_context
from cageik_cli.util.text import to_unicode


@dataclass(frozen=True, slots=True, eq=False)
class VertexWeights:
    """Weights of vertices, and where they came from.

    Attributes
    ----------
    vertices : (m,) float64, optional
        Of mean one; all are equal if each frame has its own. None if all vertices count alike.
    frames : FrameWeightsFile, optional
        What these are multiplied by in each frame.
    sources : dict
        Under `vertex_weights`, `name` and `sha256` of the file; empty if there is none.
    """

    vertices: Floats | None
    frames: FrameWeightsFile | None = None
    sources: dict[str, dict[str, str]] = field(default_factory=dict)


def load_vertex_weights(
    given: Path | str | None, rest: LoadedMesh, frames: int | None = None
) -> VertexWeights:
    """Load or compute weights for the vertices of a rest pose.

    Parameters
    ----------
    given : Path or "area", optional
    frames : int, optional
        How many frames there are; then the file may also hold weights of each frame.

    Raises
    ------
    InputError
        Naming the file that cannot be read, or is not of the clip; or the rest pose.
    """
    if not isinstance(given, Path):
        with error_context(rest.source["name"]):
            return VertexWeights(make_vertex_weights(given, rest.mesh))
    count = len(rest.mesh.vertices)
    rows = None if frames is None else open_frame_weights(given, frames, count)
    if rows is not None:
        source = {"name": to_unicode(given.name), "sha256": hash_file(given).hex()}
        every = np.full(count, rows.largest / rows.mean)
        return VertexWeights(every, rows, {"vertex_weights": source})
    values, source = read_vertex_weights(given)
    with error_context(given):
        return VertexWeights(
            make_vertex_weights(values, rest.mesh), sources={"vertex_weights": source}
        )
