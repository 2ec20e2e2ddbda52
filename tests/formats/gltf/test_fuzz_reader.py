"""Rigs in glTF whose bytes or values were changed: sound frames or a sentence, in bounded memory.

Run as a module, it reads as many of them as are asked for, and says how many were refused and
taken, the most bytes, and the longest time in seconds.
"""

import json
import struct
import sys
import time
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.util.errors import InputError
from tests.formats.gltf.built import make_glb
from tests.formats.gltf.rigs import INTERPOLATIONS, RIGS
from tests.formats.gltf.test_reader import make_box

FEW, MANY = 25, 2000
MOST = 64 << 20
"""Bytes that a file of a few KiB may make the reader take."""

VALUES = (-1, 0, 1, 2, 3, 7, 255, 10**9, 2**31 - 1, 2**63, 10**30, 0.5, -1e30, 1e300, True)
VALUES += (None, "", "Run", "LINEAR", "MAT4", 5120, 5123, 5126, [], [0], [0] * 16, {}, {"": 0})


def list_places(value, steps=()):
    """Yield the steps to all values of a document."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for step, inner in items:
        yield (*steps, step)
        if isinstance(inner, dict | list):
            yield from list_places(inner, (*steps, step))


def copy(value):
    return json.loads(json.dumps(value))


def change_values(document, rng):
    """The document with one to three values replaced, removed, or by those of other places."""
    document = copy(document)
    for _ in range(rng.integers(1, 4)):
        places = list(list_places(document))
        *above, last = places[rng.integers(len(places))]
        holder = document
        for step in above:
            holder = holder[step]
        how = rng.integers(4)
        if how == 0:
            del holder[last]
        elif how == 1 and isinstance(holder[last], int):
            holder[last] += int(rng.integers(-2, 3))
        elif how == 2 and isinstance(holder, list):
            holder.append(copy(holder[last]))
        else:
            holder[last] = copy(VALUES[rng.integers(len(VALUES))])
    return document


def change_bytes(data, rng):
    """Bytes with some of them changed, numbers that are not, or an end missing."""
    data = bytearray(data)
    how = rng.integers(4)
    for _ in range(rng.integers(1, 6)):
        place = int(rng.integers(len(data)))
        if how == 0:
            data[place] ^= 1 << rng.integers(8)
        elif how == 1:
            odd = rng.choice([np.nan, np.inf, -1.0, 1e38, 0.0])
            data[place & ~3 : (place & ~3) + 4] = struct.pack("<f", odd)
        elif how == 2:
            data[place : place + 4] = struct.pack("<i", rng.choice([-1, 0, 2**31 - 1, 3]))
        else:
            return bytes(data[:place])
    return bytes(data)


def list_sound():
    """Documents and buffers of rigs of every kind."""
    for name, make in RIGS.items():
        for interpolation in INTERPOLATIONS:
            file, _ = make(interpolation)
            yield name, file
    yield "box", make_box()


def repeat_values(document, rng):
    """The document with an attribute under many names, or many copies of an object in a list."""
    document = copy(document)
    primitives = [each for mesh in document["meshes"] for each in mesh["primitives"]]
    count = int(10 ** rng.uniform(1, 2.7))
    if rng.integers(2):
        attributes = primitives[rng.integers(len(primitives))]["attributes"]
        stem = rng.choice(["JOINTS", "WEIGHTS", "TEXCOORD", "COLOR", "_HEAT"])
        for name, value in [*attributes.items()]:
            if name.startswith(("JOINTS", "WEIGHTS")) or rng.integers(3) == 0:
                kept = name.partition("_")[0] if rng.integers(4) else stem
                for k in range(count):
                    attributes.setdefault(f"{kept}_{k}", value)
        return document
    lists = [each["primitives"] for each in document["meshes"]]
    lists += [each["targets"] for each in primitives if "targets" in each]
    lists += [document[name] for name in ("nodes", "skins", "animations") if name in document]
    values = lists[rng.integers(len(lists))]
    copies = [copy(values[rng.integers(len(values))]) for _ in range(count)]
    for k, each in enumerate(copies):
        if "attributes" in each and rng.integers(2):
            each["attributes"][f"_{k}"] = each["attributes"]["POSITION"]  # vertices of its own
    values += copies
    return document


def damage(file, rng):
    """A .glb file of a rig that was changed in its values, its buffer, or anywhere."""
    document = file.json | {"buffers": [{"byteLength": len(file.blob)}]}
    how = rng.integers(4)
    if how == 3:
        return make_glb(json.dumps(repeat_values(document, rng)).encode(), file.blob)
    if how == 0:
        return make_glb(json.dumps(change_values(document, rng)).encode(), file.blob)
    if how == 1:
        return make_glb(json.dumps(document).encode(), change_bytes(file.blob, rng))
    return change_bytes(make_glb(json.dumps(document).encode(), file.blob), rng)


def try_many(folder, count):
    """How many files were refused and taken, the most bytes, and the longest time in seconds."""
    sound, rng = list(list_sound()), np.random.default_rng(count)
    refused, most, longest = 0, 0, 0.0
    for number in range(count):
        name, file = sound[number % len(sound)]
        path = folder / f"{number}_{name}.glb"
        path.write_bytes(damage(file, rng))
        tracemalloc.start()
        begin = time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                clip = open_sequence([str(path)], ClipSettings(fps=6))
                frames = [clip.read_frame(k) for k in {0, len(clip) // 2, len(clip) - 1}]
        except InputError as error:
            refused += 1
            place, _, sentence = str(error).partition(": ")
            assert path.name in place
            assert sentence
            assert "\n" not in sentence
        else:
            assert np.isfinite(frames).all()
        longest = max(longest, time.perf_counter() - begin)
        most = max(most, tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        path.unlink()
    return refused, count - refused, most, longest


def check(refused, taken, most, _):
    assert refused > (refused + taken) / 4
    assert taken > 0
    assert most < MOST


def test_damage_is_a_sentence_or_harmless(tmp_path):
    check(*try_many(tmp_path, FEW))


@pytest.mark.slow
def test_much_damage_in_one_process_is_a_sentence_or_harmless(tmp_path):
    check(*try_many(tmp_path, MANY))


if __name__ == "__main__":
    print(*try_many(Path(sys.argv[1]), int(sys.argv[2])))
