"""Objects of the JSON of a glTF file, whose values are checked when they are asked for."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from cageik_cli.geometry.mesh import MAX_COORDINATE
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.util.json_files import format_value
from cageik_cli.util.text import single_line


@dataclass(frozen=True, slots=True)
class Item:
    """An object of the file.

    Attributes
    ----------
    values : dict
        As the file has them, unchecked.
    place : str
        Where it is, for messages: `nodes[3]`; empty for the whole file.
    """

    values: Any
    place: str

    def __post_init__(self) -> None:
        if not isinstance(self.values, dict):
            raise self.make_error("", self.values, "an object")

    def make_error(self, name: str, found: Any, expected: str) -> FormatError:
        """Return the error of a value that is not what was expected."""
        place = self.locate(name) if name else self.place or "the file"
        return FormatError(
            f"{place} is {format_value(found)}, expected {expected}; export the file again"
        )

    def locate(self, name: str) -> str:
        """Return the place of a value, by its key."""
        return f"{self.place}.{name}" if self.place else name

    def has(self, name: str) -> bool:
        """Return whether there is a value."""
        return self.values.get(name) is not None

    def find_whole(self, name: str, below: int | None = None, lowest: int = 0) -> int | None:
        """Return a whole number from `lowest` to below a bound; None if it is absent."""
        value = self.values.get(name)
        return None if value is None else self._check_whole(name, value, below, lowest)

    def read_whole(self, name: str, below: int | None = None, lowest: int = 0) -> int:
        """Return a whole number, which must be there."""
        return self._check_whole(name, self.values.get(name), below, lowest)

    def list_wholes(self, name: str, below: int) -> Integers:
        """Return a list of whole numbers from 0 to below a bound, (k,); empty if it is absent."""
        values = self._read_list(name)
        for k, value in enumerate(values):
            self._check_whole(f"{name}[{k}]", value, below, 0)
        return np.array(values, np.int64)

    def find_numbers(self, name: str, count: int | None) -> Floats | None:
        """Return a list of so many numbers, (count,); None if it is absent."""
        if not self.has(name):
            return None
        values = self._read_list(name)
        if count is not None and len(values) != count:
            raise self.make_error(name, values, f"{count} numbers")
        for k, value in enumerate(values):
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if not is_number or abs(value) > MAX_COORDINATE:
                raise self.make_error(f"{name}[{k}]", value, f"a number up to {MAX_COORDINATE:g}")
        return np.array(values, np.float64)

    def find_item(self, name: str) -> "Item | None":
        """Return an object; None if it is absent."""
        return Item(self.values[name], self.locate(name)) if self.has(name) else None

    def list_items(self, name: str) -> list["Item"]:
        """Return a list of objects; empty if it is absent."""
        found = enumerate(self._read_list(name))
        return [Item(value, f"{self.locate(name)}[{k}]") for k, value in found]

    def list_texts(self, name: str) -> list[str]:
        """Return a list of texts; empty if it is absent."""
        values = self._read_list(name)
        for k, value in enumerate(values):
            if not isinstance(value, str):
                raise self.make_error(f"{name}[{k}]", value, "a text")
        return values

    def read_text(self, name: str) -> str:
        """Return a text, as it is; empty if it is absent."""
        value = self.values.get(name)
        if value is not None and not isinstance(value, str):
            raise self.make_error(name, value, "a text")
        return value or ""

    def read_name(self) -> str:
        """Return the name on one line; empty if it has none."""
        return single_line(self.read_text("name")).strip()

    def find_extension(self, name: str) -> "Item | None":
        """Return the object of an extension; None if it is absent."""
        extensions = self.find_item("extensions")
        return None if extensions is None else extensions.find_item(name)

    def _read_list(self, name: str) -> list[Any]:
        value = self.values.get(name)
        if value is not None and not isinstance(value, list):
            raise self.make_error(name, value, "a list")
        return value or []

    def _check_whole(self, name: str, value: Any, below: int | None, lowest: int) -> int:
        """Return a value if it is a whole number within its bounds."""
        is_whole = isinstance(value, int) and not isinstance(value, bool)
        if not is_whole or value < lowest or (below is not None and value >= below):
            if below is None:
                expected = f"a whole number from {lowest} on"
            else:
                expected = (
                    f"{lowest} to {below - 1}" if below > lowest else "none, as there is none"
                )
            raise self.make_error(name, value, expected)
        return int(value)
