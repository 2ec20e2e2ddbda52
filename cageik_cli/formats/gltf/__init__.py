"""glTF in one binary file: morph targets or a skin, with times; needs pygltflib."""

from cageik_cli.formats.gltf.writer import Writer

__all__ = ["Writer"]
