"""glTF in and out: skins, morph targets and moving nodes are evaluated here; needs pygltflib."""

from cageik_cli.formats.gltf.morphs import Writer
from cageik_cli.formats.gltf.reader import Reader

__all__ = ["Reader", "Writer"]
