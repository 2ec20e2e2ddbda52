"""The file of an entry: what is read is what was packed, or nothing."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.store.cache import WEIGHTS, CorruptEntry
from tests.store.entries import entry, same

KEY, OTHER = "1" * 64, "2" * 64


@pytest.fixture
def path(tmp_path):
    return tmp_path / "entry"


def test_what_is_packed_is_read(path):
    path.write_bytes(b"".join(WEIGHTS.pack(KEY, entry())))
    assert same(WEIGHTS.read(path, KEY), entry())


def test_arrays_are_packed_in_row_order():
    columns = entry() | {"weights": np.asfortranarray(entry()["weights"])}
    assert not columns["weights"].flags.c_contiguous
    assert b"".join(WEIGHTS.pack(KEY, columns)) == b"".join(WEIGHTS.pack(KEY, entry()))


def test_any_flipped_bit_is_detected(path):
    """Those of the start each, of header and arrays every seventh."""
    data = b"".join(WEIGHTS.pack(KEY, entry()))
    for place in [*range(57), *range(57, len(data), 7), len(data) - 1]:
        other = bytearray(data)
        other[place] ^= 1 << place % 8
        path.write_bytes(other)
        with pytest.raises(CorruptEntry, match="is damaged"):
            WEIGHTS.read(path, KEY)


def test_the_entry_of_another_key_is_refused(path):
    path.write_bytes(b"".join(WEIGHTS.pack(OTHER, entry())))
    with pytest.raises(CorruptEntry, match="is the entry of another key"):
        WEIGHTS.read(path, KEY)


def test_an_entry_with_other_fields_is_refused(path):
    """As another version of the program may have written it, under the same key."""
    other = replace(WEIGHTS, values=dict(list(WEIGHTS.values.items())[1:]))
    path.write_bytes(b"".join(other.pack(KEY, entry())))
    with pytest.raises(CorruptEntry, match="is the entry of another version"):
        WEIGHTS.read(path, KEY)


def test_a_folder_is_not_an_entry(tmp_path):
    with pytest.raises(CorruptEntry, match="is not a plain file"):
        WEIGHTS.read(tmp_path, KEY)


def test_a_missing_entry_cannot_be_read(path):
    with pytest.raises(FileNotFoundError):
        WEIGHTS.read(path, KEY)


def test_the_header_is_plain_json():
    """Nothing in an entry is run when it is read."""
    data = b"".join(WEIGHTS.pack(KEY, entry()))
    assert data.startswith(b"cageik weights 2\n")
    length = int.from_bytes(data[49:57], "little")
    header = json.loads(data[57 : 57 + length])
    assert header["weights"] == [5, 8]
    assert len(data) == 57 + length + 8 * (12 * 3 + 5 * 8)
    weights = np.frombuffer(data[-8 * 5 * 8 :], "<f8").reshape(5, 8)
    np.testing.assert_array_equal(weights, entry()["weights"])
