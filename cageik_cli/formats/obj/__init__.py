"""Wavefront OBJ: frames in and out, with UVs, normals and materials."""

from cageik_cli.formats.obj.frames import Reader, Writer

__all__ = ["Reader", "Writer"]
