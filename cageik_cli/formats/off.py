"""Object File Format (OFF): positions and polygons, in the file's order; read only."""

import re
from itertools import islice

import numpy as np

from cageik_cli.formats.base.files import with_gzip
from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.base.readers import FrameFileReader
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError


class Reader(FrameFileReader):
    """Frames from OFF files."""

    suffixes = with_gzip(".off")

    @classmethod
    def parse(cls, data: bytes) -> FileMesh:
        """Parse the content of an OFF file."""
        return FileMesh.from_polygons(*parse_off(data))


def parse_off(data: bytes) -> tuple[Floats, list[Integers]]:
    """Read the vertices (n, 3) and the corners of each face of an OFF text."""
    try:
        text = re.sub("#.*", "", data.decode()).strip()
        # The letters before are of texture coordinates, colours and normals.
        keyword = re.match(r"(?:ST)?C?N?OFF\b", text)
        if not keyword:
            raise ValueError("it does not begin with OFF")
        lines = filter(None, map(str.split, text[keyword.end() :].splitlines()))
        counts = next(lines, [])
        count, faces = map(int, counts[:2])
        vertices = np.array([words[:3] for words in islice(lines, count)], np.float64)
        polygons = []
        for words in islice(lines, faces):
            size = int(words[0])
            if len(words) <= size:
                raise ValueError(f"the face `{' '.join(words)}` lacks corners")
            polygons.append(np.array(words[1 : size + 1], np.int64))  # a colour may follow
        if (len(vertices), len(polygons)) != (count, faces):
            raise ValueError(
                f"it announces {count} vertices and {faces} faces, but holds {len(vertices)} and "
                f"{len(polygons)}"
            )
    except (ValueError, OverflowError) as error:
        raise FormatError(f"is not a sound OFF mesh ({error}); export it again") from error
    return vertices, polygons
