"""Wavefront OBJ: read frame by frame, and written with the text of the original file.

Start with `parse`; `tokens` finds the words of a text for reading and writing.
"""

from cageik_cli.formats.obj.frames import Reader
from cageik_cli.formats.obj.write import Writer

__all__ = ["Reader", "Writer"]
