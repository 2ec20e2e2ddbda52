"""Wavefront OBJ: parsed by words, frame by frame, and written with the text it came from."""

from cageik_cli.formats.obj.frames import Reader
from cageik_cli.formats.obj.write import Writer

__all__ = ["Reader", "Writer"]
