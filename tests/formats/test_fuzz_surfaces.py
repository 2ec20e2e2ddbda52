"""Damaged surfaces: a sentence, or a mesh that is written again; never a traceback."""

import h5py
import numpy as np
import pytest

from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.write import write_mesh
from cageik_cli.store.binding_file import StoredBinding, read_binding, write_binding
from cageik_cli.util.errors import InputError
from tests.assets import asset_text
from tests.formats.clips import written
from tests.store.test_attributes import BINDING, GROUP, SOURCES
from tests.surfaces import ASSET
from tests.texts import texts

COUNT = 80

CHARACTERS = b"0123456789-/. \n#\\%gvnstfu\x00\xff[](),e"


def write_obj(path):
    path.write_text(asset_text())


def write_ply(path):
    write_mesh(path, ASSET, ASSET.vertices, overwrite=False)


def write_usda(path):
    written(path, ASSET.vertices[None], ASSET)


KINDS = {"obj": write_obj, "ply": write_ply, "usda": write_usda}


def damage(data, rng):
    """Some bytes behind the positions changed, moved or missing."""
    data = bytearray(data)
    begin = max(0, data.find(b"vt ") if b"vt " in data else 0)
    for _ in range(rng.integers(1, 6)):
        place = int(rng.integers(begin, len(data)))
        how = rng.integers(4)
        if how == 0:
            data[place] = int(rng.choice(list(CHARACTERS)))
        elif how == 1:
            del data[place : place + int(rng.integers(1, 30))]
        elif how == 2:
            data[place:place] = bytes(rng.choice(list(CHARACTERS), 3).tolist())
        else:
            other = int(rng.integers(begin, len(data)))
            data[place : place + 12] = data[other : other + 12]
    return bytes(data)


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_surface_is_a_sentence_or_harmless(tmp_path, kind):
    source = tmp_path / f"sound.{kind}"
    KINDS[kind](source)
    sound, rng, left_out = source.read_bytes(), np.random.default_rng(4), 0
    sentences = []
    for number in range(COUNT):
        path = tmp_path / f"{number}.{kind}"
        path.write_bytes(damage(sound, rng))
        try:
            sequence = open_sequence([str(path)])
        except InputError as error:
            sentences.append(str(error))
            continue
        left_out += any("left out" in note for note in texts(sequence.notes))
        mesh = sequence.first
        if mesh.attributes is not None:
            mesh.attributes.check_cut(mesh.faces)
        for suffix in ("obj", "ply"):
            write_mesh(tmp_path / f"again.{suffix}", mesh, mesh.vertices, overwrite=True)
        assert len(open_sequence([str(tmp_path / "again.obj")]).first.faces) == len(mesh.faces)
    assert 0 < len(sentences) < COUNT
    assert not any("\n" in sentence for sentence in sentences)
    assert left_out > 0 or kind == "ply"


def scramble(dataset, rng):
    """Change some numbers of a dataset, or its shape, or its type."""
    values = dataset[()]
    parent, name = dataset.parent, dataset.name.rpartition("/")[2]
    how = rng.integers(4)
    if how == 0 and values.dtype.kind in "if":
        place = rng.integers(values.size)
        values.flat[place] = rng.choice([-1, 0, 1, 7, 1e6, 2**31 - 1, -(2**31)])
        dataset[()] = values
        return
    del parent[name]
    if how == 1:
        parent[name] = values[: rng.integers(len(values) + 1)]
    elif how == 2:
        parent[name] = rng.integers(-1, 9, (3, 2))
    elif how == 3 and values.dtype.kind in "if":
        parent[name] = values.astype("f4" if values.dtype.kind == "i" else "i4")


def test_a_damaged_group_of_attributes_is_a_sentence(tmp_path):
    write_binding(tmp_path / "sound.h5", StoredBinding(BINDING, SOURCES), overwrite=False)
    sound, rng = (tmp_path / "sound.h5").read_bytes(), np.random.default_rng(5)
    with h5py.File(tmp_path / "sound.h5") as file:
        names = []
        file[GROUP].visititems(
            lambda name, item: names.append(name) if hasattr(item, "shape") else 0
        )
    sentences = []
    for number in range(COUNT):
        path = tmp_path / f"{number}.h5"
        path.write_bytes(sound)
        with h5py.File(path, "r+") as file:
            scramble(file[f"{GROUP}/{rng.choice(names)}"], rng)
        try:
            read_binding(path)
        except InputError as error:
            sentences.append(str(error))
    assert len(sentences) > 0.9 * COUNT
    assert all(".h5: `attributes/rest" in text and "; " in text for text in sentences)
    assert not any("\n" in text for text in sentences)
