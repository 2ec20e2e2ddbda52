"""glTF as it comes from other programs: skins, morph targets and moving nodes, evaluated here."""

from cageik_cli.formats.gltf_reader.reader import Reader

__all__ = ["Reader"]
