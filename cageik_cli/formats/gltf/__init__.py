"""glTF in and out: skins, morph targets and moving nodes are evaluated here; needs pygltflib.

A file is a `document` of `nodes`, whose meshes have a `geometry` and a `surface`; the `reader`
moves them. Writers fill a `file` with the same nodes and surfaces: `morphs` and `skeleton`.
"""

from cageik_cli.formats.gltf.morphs import Writer
from cageik_cli.formats.gltf.reader import Reader

__all__ = ["Reader", "Writer"]
