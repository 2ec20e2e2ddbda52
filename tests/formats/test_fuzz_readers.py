"""Damaged files of every kind that holds a clip: sound frames or a sentence, in bounded memory.

HDF5's own library may end the process on damaged metadata, so those files are read in another one.
"""

import struct
import sys
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cageik_cli.formats.base.hdf5 import HDF5_SUFFIXES
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.usd.library import USD_SUFFIXES
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import InputError
from tests.clips import frames_of
from tests.formats.kinds import FACES, FRAMES, KINDS

COUNT = 120
MOST = 64 << 20
"""Bytes that a file of a few KiB may make a reader take."""

REST = LoadedMesh(TriMesh(FRAMES[0], FACES), {"name": "rest.obj"})


def write_deflated(path, frames):
    np.savez_compressed(path, verts=frames, faces=FACES, up_axis="Z")


def write_ply(path, frames):
    path.write_bytes(trimesh.Trimesh(frames[0], FACES, process=False).export(file_type="ply"))


def write_stl(path, frames, kind="stl"):
    mesh = trimesh.Trimesh(frames[0], FACES, process=False)
    data = mesh.export(file_type=kind)
    path.write_bytes(data if kind == "stl" else data.encode())


def write_text_stl(path, frames):
    write_stl(path, frames, "stl_ascii")


HDF5 = {name: write for name, write in KINDS.items() if Path(name).suffix in HDF5_SUFFIXES}
OWN = {
    name: write
    for name, write in KINDS.items()
    if Path(name).suffix not in (*HDF5_SUFFIXES, *USD_SUFFIXES, ".abc")
}
"""Files that no library of another reads."""

IN_PROCESS = OWN | {
    "deflated_clip.npz": write_deflated,
    "clip.ply": write_ply,
    "clip.stl": write_stl,
    "text_clip.stl": write_text_stl,
}


def damaged(data, rng):
    """The file with a few bytes changed, an integer made huge, or an end or a middle missing."""
    data = bytearray(data)
    # The front, where headers are, as often as all the rest; a zip has its directory at the end.
    places = rng.choice([len(data), min(len(data), 160), -min(len(data), 160)])
    how = rng.integers(5)
    for _ in range(rng.integers(1, 4)):
        place = (
            int(rng.integers(places)) if places > 0 else len(data) - 1 - int(rng.integers(-places))
        )
        if how == 0:
            data[place] ^= 1 << rng.integers(8)
        elif how == 1:
            data[place] = rng.integers(256)
        elif how == 2:
            huge = rng.choice([-1, 0, 2**31 - 1, -(2**31), 2**28, 3])
            data[place : place + 4] = struct.pack(rng.choice(["<i", ">i"]), huge)
        elif how == 3:
            return data[: int(rng.integers(len(data)))]
        else:
            del data[place : place + int(rng.integers(1, 40))]
    return data


def outcomes(folder, kind):
    """What each damaged file came to: the shape of its frames, or the sentence."""
    path = Path(folder) / kind
    (IN_PROCESS | HDF5)[kind](path, FRAMES)
    sound = path.read_bytes()
    rng = np.random.default_rng(len(sound))
    for number in range(COUNT):
        # HDF5 has what it knows of a file from the last time, if it is still open somewhere.
        path.unlink()
        path = path.with_name(f"{number}.{kind}")
        path.write_bytes(damaged(sound, rng))
        try:
            frames = frames_of(open_sequence([str(path)], None, REST))
        except InputError as error:
            yield str(error)
        else:
            assert np.isfinite(frames).all()
            yield frames.shape


def refused_and_taken(folder, kind):
    """Both counts, after every outcome has been looked at; and the bytes that it took."""
    tracemalloc.start()
    found = list(outcomes(folder, kind))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    sentences = [text for text in found if isinstance(text, str)]
    assert all("clip." in text and "\n" not in text for text in sentences)
    return len(sentences), len(found) - len(sentences), most


@pytest.mark.parametrize("kind", IN_PROCESS)
def test_damage_is_a_sentence_or_harmless(tmp_path, kind):
    refused, taken, most = refused_and_taken(tmp_path, kind)
    assert refused > COUNT / 4
    assert taken > 0
    assert most < MOST


@pytest.mark.slow
@pytest.mark.parametrize("kind", HDF5)
def test_damage_of_hdf5_is_a_sentence_or_harmless(tmp_path, run_process, kind):
    outcome = run_process("-m", "tests.formats.test_fuzz_readers", tmp_path, kind)
    assert (outcome.code, outcome.err) == (0, "")
    refused, taken, most = map(int, outcome.out.split())
    assert refused > COUNT / 4
    assert taken > 0
    assert most < MOST


if __name__ == "__main__":
    warnings.simplefilter("error")
    print(*refused_and_taken(*sys.argv[1:]))
