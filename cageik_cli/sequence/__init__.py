"""Mesh animations in: every reader gives the same lazily read `MeshSequence`."""

from cageik_cli.sequence.clip import (
    Block,
    ClipSettings,
    MeshSequence,
    ReadAhead,
    refuse_other_connectivity,
)
from cageik_cli.sequence.files import kind_of
from cageik_cli.sequence.mesh_file import LoadedMesh, load_mesh
from cageik_cli.sequence.opening import (
    clip_suffixes,
    files_read,
    in_natural_order,
    members_of,
    open_sequence,
    outline,
)
from cageik_cli.sequence.rest_pose import clip_and_rest
from cageik_cli.sequence.weights_file import load_vertex_weights

__all__ = [
    "Block",
    "ClipSettings",
    "LoadedMesh",
    "MeshSequence",
    "ReadAhead",
    "clip_and_rest",
    "clip_suffixes",
    "files_read",
    "in_natural_order",
    "kind_of",
    "load_mesh",
    "load_vertex_weights",
    "members_of",
    "open_sequence",
    "outline",
    "refuse_other_connectivity",
]
