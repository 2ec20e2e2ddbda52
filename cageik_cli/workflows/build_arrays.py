"""Build a cage around a mesh in memory, without files."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.cages import build as cage_builder
from cageik_cli.cages.build import BuildSettings, BuiltCage, Clip
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.geometry.mesh import TriMesh, validate_positions
from cageik_cli.util.errors import ConnectivityError
from cageik_cli.util.threads import count_processors
from cageik_cli.workflows.build_cage import list_warnings
from cageik_cli.workflows.measure_cage import make_measured_clip


def build_cage(
    mesh: TriMesh,
    *,
    vertices: int = BuildSettings().vertices,
    clearance: float = BuildSettings().clearance,
    frames: MeshSequence | ArrayLike | None = None,
    jobs: int | None = None,
) -> BuiltCage:
    """Build a cage around a mesh, as `cageik cage` does.

    The same input gives the same cage. It takes some 10 seconds, and with `frames` about a minute.

    Parameters
    ----------
    mesh : TriMesh
        The model at rest. It may be open, have several parts or cross itself.
    vertices : int
        Vertices of the cage, at most; it has at least 0.9 times as many.
    clearance : float
        Smallest distance between the cage and the surface, in diagonals of the mesh.
    frames : MeshSequence, or (F, m, 3) array, optional
        An animation of the mesh, in its units: the cage with the smallest error on it is chosen.
    jobs : int, optional
        Threads; as many as there are processors by default.

    Raises
    ------
    CageikError
        When the mesh is one point, a setting is impossible, or the frames have other vertices.

    Examples
    --------
    >>> from cageik_cli import bind, build_cage, load_mesh
    >>> rest = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> built = build_cage(rest, vertices=40)
    >>> built.cage
    <TriMesh: 40 vertices, 76 triangles>
    >>> built.notes
    ()
    >>> bind(rest, built.cage, accuracy="preview")
    <Binding: 1570 vertices in a cage of 40, harmonic, preview>
    """
    clip = None if frames is None else _read_clip(mesh, frames, jobs or count_processors())
    built = cage_builder.build_cage(mesh, BuildSettings(vertices, clearance), clip)
    return replace(built, notes=list_warnings(built))


def _read_clip(mesh: TriMesh, frames: MeshSequence | ArrayLike, jobs: int) -> Clip:
    """Read some of the frames.

    Raises
    ------
    ConnectivityError
        When they have other vertices than the mesh.
    """
    if isinstance(frames, MeshSequence):
        found: tuple[int, ...] = (len(frames), *frames.first.vertices.shape)
        read_frame = frames.read_frame
    else:
        positions = np.asarray(frames, np.float64)
        found = positions.shape

        def read_frame(index: int) -> np.ndarray:
            return validate_positions(positions[index])

    if found[1:] != mesh.vertices.shape or not found[0]:
        raise ConnectivityError(
            f"frames have shape {found}, expected (F, {len(mesh.vertices)}, 3) as the mesh has "
            f"{len(mesh.vertices)} vertices; give frames of this mesh"
        )
    return make_measured_clip(mesh, found[0], read_frame, jobs)
