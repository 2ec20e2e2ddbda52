"""The weights of vertices that a run is given: in a file, or by the area around each vertex."""

from pathlib import Path

from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.vertex_weights import load_vertex_weights
from cageik_cli.solver.area_weights import make_vertex_weights
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import error_context


def load_weights(
    given: Path | str | None, rest: LoadedMesh
) -> tuple[Floats | None, dict[str, dict[str, str]]]:
    """Load or compute the weights, of mean one; also name and digest of the file, if there is one.

    Raises
    ------
    InputError
        Naming the file that cannot be read or is not of the rest pose; or the rest pose.
    """
    if not isinstance(given, Path):
        with error_context(rest.source["name"]):
            return make_vertex_weights(given, rest.mesh), {}
    loaded, source = load_vertex_weights(given)
    with error_context(given):
        return make_vertex_weights(loaded, rest.mesh), {"vertex_weights": source}
