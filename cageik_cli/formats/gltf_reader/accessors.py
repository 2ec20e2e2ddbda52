"""Arrays of a glTF file: strided, sparse, and of small integers that stand for fractions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.gltf_reader.document import Document
from cageik_cli.formats.gltf_reader.items import Item
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""Types of numbers, by their codes."""

WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
"""Numbers of an element, by its type."""


@dataclass(frozen=True, slots=True, eq=False)
class SparseRows:
    """Rows (count, width) that are zero but for some.

    Attributes
    ----------
    indices : (s,) int64
        Numbers of the others, ascending.
    values : (s, width)
    """

    count: int
    indices: Integers
    values: NDArray[Any]

    def to_dense(self) -> NDArray[Any]:
        """Return all rows."""
        rows = np.zeros((self.count, self.values.shape[1]), self.values.dtype)
        rows[self.indices] = self.values
        return rows


Rows = NDArray[Any] | SparseRows


def read_floats(
    document: Document, number: int, widths: tuple[int, ...], needs_float: bool = False
) -> Floats | NDArray[np.float32]:
    """Read an accessor as floats, (count, width).

    Parameters
    ----------
    needs_float : bool
        Refuse integers.

    Raises
    ------
    FormatError
        Naming the accessor.
    """
    rows = read_rows(document, number, widths, needs_float)
    if isinstance(rows, SparseRows):
        document.claim(rows.count * rows.values.shape[1] * rows.values.itemsize)
        return rows.to_dense()
    return rows


def read_rows(
    document: Document, number: int, widths: tuple[int, ...], needs_float: bool = False
) -> Rows:
    """Read an accessor as floats; one whose elements are zero but for some is not expanded."""
    item = document.accessors[number]
    code = _read_code(item)
    is_fraction = item.values.get("normalized") is True

    def convert(raw: NDArray[Any]) -> NDArray[Any]:
        if raw.dtype.kind == "f":
            return raw
        if needs_float:
            raise item.make_error("componentType", code, "5126, single precision")
        exact = raw.astype(np.float64)
        if not is_fraction:
            return exact
        return np.maximum(exact / np.iinfo(raw.dtype).max, -1.0)

    found = _read_raw(document, item, widths)
    if isinstance(found, SparseRows):
        return SparseRows(found.count, found.indices, convert(found.values))
    if found.dtype.kind != "f":
        document.claim(8 * found.size)
    return convert(found)


def read_wholes(document: Document, number: int, width: int) -> Integers:
    """Read an accessor as whole numbers, (count, width), which are not below 0."""
    item = document.accessors[number]
    if COMPONENTS[_read_code(item)][1] != "u":
        found = item.values["componentType"]
        raise item.make_error("componentType", found, "5121, 5123 or 5125, which count from 0")
    rows = _read_raw(document, item, (width,))
    count = rows.count if isinstance(rows, SparseRows) else len(rows)
    document.claim(8 * count * width)
    return (rows.to_dense() if isinstance(rows, SparseRows) else rows).astype(np.int64)


def count_rows(document: Document, number: int) -> int:
    """Return how many elements an accessor states."""
    return document.accessors[number].read_whole("count", lowest=1)


def _read_code(item: Item) -> int:
    code = item.read_whole("componentType")
    if code not in COMPONENTS:
        raise item.make_error("componentType", code, f"one of {', '.join(map(str, COMPONENTS))}")
    return code


def _read_raw(document: Document, item: Item, widths: tuple[int, ...]) -> Rows:
    """Return the rows as the file has them; those of no bytes are zeros."""
    kind = np.dtype(COMPONENTS[_read_code(item)])
    name = item.read_text("type")
    width = WIDTHS.get(name, 0)
    if width not in widths:
        wanted = [name for name, each in WIDTHS.items() if each in widths]
        raise item.make_error("type", name, " or ".join(wanted))
    count = item.read_whole("count", lowest=1)
    view = item.find_whole("bufferView", document.view_count)
    sparse = item.find_item("sparse")
    indices, values = np.zeros(0, np.int64), np.zeros((0, width), kind)
    if sparse is not None:
        indices, values = _read_sparse(document, sparse, (count, width), kind)
    if view is None:
        return SparseRows(count, indices, values)
    rows = _view_rows(document, item, view, (count, width), kind)
    if sparse is None:
        return rows
    document.claim(rows.size * kind.itemsize)
    rows = rows.copy()
    rows[indices] = values
    return rows


def _read_sparse(
    document: Document, sparse: Item, shape: tuple[int, int], kind: np.dtype[Any]
) -> tuple[Integers, NDArray[Any]]:
    """Return the numbers of the rows that differ, ascending, and these rows."""
    count = sparse.read_whole("count", shape[0] + 1, lowest=1)
    parts = []
    for name, row_width in (("indices", 1), ("values", shape[1])):
        part = sparse.find_item(name)
        if part is None:
            raise sparse.make_error(name, None, "an object")
        held = kind if name == "values" else np.dtype(COMPONENTS[_read_code(part)])
        view = part.read_whole("bufferView", document.view_count)
        parts.append(_view_rows(document, part, view, (count, row_width), held))
    indices = parts[0][:, 0].astype(np.int64)
    if indices[0] < 0 or indices[-1] >= shape[0] or (np.diff(indices) <= 0).any():
        raise FormatError(
            f"{sparse.place}.indices are not ascending numbers below {shape[0]}; export the file "
            "again"
        )
    return indices, parts[1]


def _view_rows(
    document: Document, item: Item, view: int, shape: tuple[int, int], kind: np.dtype[Any]
) -> NDArray[Any]:
    """Return rows in the bytes of a view, which are not copied."""
    data, stride = document.read_view(view)
    width = shape[1] * kind.itemsize
    step = stride or width
    start = item.find_whole("byteOffset") or 0
    stop = start + step * (shape[0] - 1) + width
    if step < width or stop > len(data):
        raise FormatError(
            f"{item.place}: {shape[0]} elements of {width} bytes, {step} apart, end at byte {stop} "
            f"of a view of {len(data)}; export the file again"
        )
    return np.ndarray(shape, kind, data, start, (step, kind.itemsize))
