"""Alembic in and out: polygon meshes, below transforms, that have samples in time.

UVs, normals and materials are those of the first sample; other programs know materials as face
sets. Needs alembic3d.
"""

from cageik_cli.formats.alembic.paths import name_parts, place_meshes
from cageik_cli.formats.alembic.reader import PARAMETERS, Reader
from cageik_cli.formats.alembic.writer import Writer

__all__ = ["PARAMETERS", "Reader", "Writer", "name_parts", "place_meshes"]
