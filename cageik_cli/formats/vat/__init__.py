"""Vertex animation textures: a mesh at rest, and images that move its vertices in a shader.

The layout is that of OpenVAT, which engines have shaders for. `layout` puts vertices and frames
into an image, `images` encodes it, and the `writer` fills it.
"""

from cageik_cli.formats.vat.writer import Writer

__all__ = ["Writer"]
