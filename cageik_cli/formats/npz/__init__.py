"""NumPy arrays: `.npz` and `.npy` files of any sensible layout."""

from cageik_cli.formats.npz.reader import Reader
from cageik_cli.formats.npz.writer import Writer

__all__ = ["Reader", "Writer"]
