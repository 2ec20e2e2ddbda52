"""What the script of a page computes from its data, in Python."""

import base64
import json
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.view.player.compression import PACKED_TYPES


def unpack_arrays(text: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Unpack what `pack_arrays` packed: the header, and the arrays by name."""
    content = zlib.decompress(base64.b64decode(text, validate=True), wbits=31)
    (length,) = struct.unpack_from("<I", content)
    header, start = json.loads(content[4 : 4 + length]), 4 + length
    arrays = {}
    for one in header.pop("arrays"):
        dtype = np.dtype(PACKED_TYPES[one["type"]])
        count = int(np.prod(one["shape"]))
        planes = np.frombuffer(content, np.uint8, count * dtype.itemsize, start)
        numbers = np.ascontiguousarray(planes.reshape(dtype.itemsize, count).T).view(dtype)
        arrays[one["name"]] = numbers.reshape(one["shape"])
        start += count * dtype.itemsize
    return header, arrays


def unpack_payload(text: str) -> tuple[dict, dict[str, np.ndarray]]:
    """Return the header, and the arrays as they were before they were made small."""
    header, arrays = unpack_arrays(text)
    for name in header["predicted"]:
        arrays[name] = add_predictions(arrays[name], arrays["faces"])
    return header, arrays


def add_predictions(encoded: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Undo the prediction of numbers from those of vertices before, one vertex after the other."""
    codes = encoded.view(np.uint16).astype(int)
    values = np.where(codes & 1, -(codes >> 1) - 1, codes >> 1)
    before = [[] for _ in range(values.shape[-1])]
    for face in faces.astype(int).tolist():
        for vertex in face:
            before[vertex] += [other for other in face if other < vertex]
    lack = np.zeros_like(values)
    for vertex, near in enumerate(before):
        average = {}
        for name, one in (("values", values), ("lack", lack)):
            if near:
                average[name] = one[..., near].sum(axis=-1) // len(near)
            else:
                average[name] = one[..., vertex - 1] if vertex else 0
        # As 16 bits: sums that are too large begin again.
        lack[..., vertex] = wrap(values[..., vertex] + average["lack"] // 2)
        values[..., vertex] = wrap(average["values"] + lack[..., vertex])
    return values.astype(np.int16)


def wrap(numbers: np.ndarray) -> np.ndarray:
    return (numbers + 32768) % 65536 - 32768


def rebuild_frame(text: str, frame: int) -> np.ndarray:
    """Return the positions of a frame, (m, 3), file units."""
    header, arrays = unpack_payload(text)
    turn = arrays["rotations"][frame].astype(float)
    moves = arrays["cages"][:, :, frame].T - arrays["cage"] @ turn
    weights = arrays["weights"].T / header["levels"]
    weights += header["restStep"] * arrays["rests"].T.astype(float) @ arrays["smooth"]
    base = weights @ arrays["cage"] + header["lackStep"] * arrays["lack"].T
    mesh = base @ turn + weights @ moves
    return mesh * header["diagonal"] + header["origin"]
