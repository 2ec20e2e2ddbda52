"""Universal Scene Description: meshes with time samples, and skeletons; needs usd-core."""

from cageik_cli.formats.usd.reader import Reader
from cageik_cli.formats.usd.writer import Writer

__all__ = ["Reader", "Writer"]
