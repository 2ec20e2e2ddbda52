"""A clip and its rest pose, which may say the faces of a clip that has none."""

from dataclasses import replace
from pathlib import Path

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.sequence.clip import ClipSettings, MeshSequence, refuse_other_connectivity
from cageik_cli.sequence.mesh_file import LoadedMesh, load_mesh
from cageik_cli.sequence.opening import open_sequence
from cageik_cli.util.errors import InputError, located


def clip_and_rest(
    frames: tuple[str, ...], how: ClipSettings, path: Path | None, index: int
) -> tuple[MeshSequence, LoadedMesh]:
    """A clip and its rest pose: that of a file, of the clip's connectivity, or a frame of it."""
    rest = load_mesh(path) if path is not None else None
    sequence = open_sequence(list(frames), how, rest)
    if rest is not None:
        with located(path):
            count, faces = len(rest.fanned.vertices), rest.fanned.faces
            refuse_other_connectivity(count, faces, sequence.fanned, "the first frame")
        # Polygons are cut alike in all frames: as in the first.
        return sequence, replace(rest, mesh=TriMesh(rest.mesh.vertices, sequence.first.faces))
    if not 0 <= index < len(sequence):
        raise InputError(
            f"--rest-frame {index}: the clip has {len(sequence)} frames, expected "
            f"0 to {len(sequence) - 1}"
        )
    frame = TriMesh(sequence.frame(index), sequence.first.faces)
    return sequence, LoadedMesh(frame, frame, {"name": sequence.names[index]})
