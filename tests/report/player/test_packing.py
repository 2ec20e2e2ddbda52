"""Arrays and a header in one text."""

import base64
import gzip
import json

import numpy as np
import pytest

from cageik_cli.report.player.packing import GZIP_HEADER, TYPES, pack_arrays, unpack_arrays

ARRAYS = {
    "small": np.array([[-3, 2], [32767, -32768]], "<i2"),
    "real": np.linspace(-1e9, 1e-9, 7, dtype="<f4"),
    "none": np.empty((0, 3), "<u4"),
    "levels": np.array([0, 65535], "<u2"),
}
HEADER = {"names": ["a", "</script>", "\u00e9\n"], "number": 0.1}


def test_what_is_packed_is_unpacked():
    header, arrays = unpack_arrays(pack_arrays(HEADER, ARRAYS))
    assert header == HEADER
    assert list(arrays) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(arrays[name], array)


def test_the_same_arguments_give_the_same_text():
    text = pack_arrays(HEADER, ARRAYS)
    assert pack_arrays(dict(HEADER), {k: v.copy() for k, v in ARRAYS.items()}) == text
    assert base64.b64decode(text).startswith(GZIP_HEADER)


def test_other_programs_unpack_it():
    content = gzip.decompress(base64.b64decode(pack_arrays(HEADER, ARRAYS)))
    length = int.from_bytes(content[:4], "little")
    listed = json.loads(content[4 : 4 + length])["arrays"]
    assert [one["name"] for one in listed] == list(ARRAYS)
    planes = content[4 + length : 4 + length + 8]
    low, high = np.frombuffer(planes, np.uint8).reshape(2, 4).astype(int)
    np.testing.assert_array_equal((low + 256 * high).astype("<u2"), [65533, 2, 32767, 32768])


def test_no_text_of_a_user_ends_the_element():
    assert not set(pack_arrays(HEADER, ARRAYS)) & set("<>&\"'")


def test_arrays_of_other_types_and_numbers_that_are_not_finite_are_refused():
    with pytest.raises(StopIteration):
        pack_arrays({}, {"x": np.zeros(2)})
    with pytest.raises(ValueError, match="JSON"):
        pack_arrays({"x": float("nan")}, {})
    assert "<f8" not in TYPES.values()
