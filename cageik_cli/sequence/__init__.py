"""Mesh animations in: every reader gives the same lazily read `MeshSequence`."""

from cageik_cli.sequence.clip import (
    Block,
    ClipSettings,
    MeshSequence,
    ReadAhead,
    refuse_other_connectivity,
)
from cageik_cli.sequence.mesh_file import LoadedMesh, load_mesh
from cageik_cli.sequence.opening import files_read, open_sequence, outline
from cageik_cli.sequence.rest_pose import clip_and_rest
from cageik_cli.sequence.weights_file import load_vertex_weights

__all__ = [
    "Block",
    "ClipSettings",
    "LoadedMesh",
    "MeshSequence",
    "ReadAhead",
    "clip_and_rest",
    "files_read",
    "load_mesh",
    "load_vertex_weights",
    "open_sequence",
    "outline",
    "refuse_other_connectivity",
]
