"""Clips in HDF5: SPLOCS' scale undone, D-FAUST's clips chosen, strangers' files distrusted."""

import hashlib

import h5py
import numpy as np
import pytest

from cageik_cli.errors import InputError
from cageik_cli.sequence import ClipSettings, open_sequence, runs
from cageik_cli.sequence.readers import hdf5_clips
from tests.clips import frames_of

FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
FRAMES = np.arange(3 * 4 * 3, dtype=float).reshape(3, 4, 3) ** 2
SCALE, MEAN = 2.5, np.array([1.0, -2.0, 3.0])


@pytest.fixture
def path(tmp_path):
    """A sound file, to be damaged."""
    path = tmp_path / "clip.h5"
    with h5py.File(path, "w") as file:
        file["verts"], file["tris"] = FRAMES, FACES
    return path


def test_frames_faces_and_digest(path):
    sequence = open_sequence([str(path)])
    assert sequence.names == ("clip.h5[0]", "clip.h5[1]", "clip.h5[2]")
    np.testing.assert_array_equal(sequence.first.vertices, FRAMES[0])
    np.testing.assert_array_equal(sequence.first.faces, FACES)
    np.testing.assert_array_equal(frames_of(open_sequence([str(path)])), FRAMES)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert sequence.source() == {"name": "clip.h5", "sha256": digest}


@pytest.mark.parametrize("on_dataset", [False, True])
@pytest.mark.parametrize(
    "attributes",
    [
        {"scale": SCALE},
        {"mean": MEAN},
        {"scale": SCALE, "mean": MEAN.reshape(1, 3)},
        {"scale": [SCALE], "mean": 7},
    ],
)
def test_scale_and_mean_are_undone(path, attributes, on_dataset):
    with h5py.File(path, "r+") as file:
        scaled = (FRAMES - attributes.get("mean", 0)) / attributes.get("scale", 1)
        file["verts"][:] = scaled
        (file["verts"] if on_dataset else file).attrs.update(attributes)
    np.testing.assert_allclose(
        frames_of(open_sequence([str(path)])), FRAMES, rtol=1e-14, atol=1e-12
    )


def test_single_precision_and_compression_are_read(path):
    with h5py.File(path, "r+") as file:
        del file["verts"]
        file.create_dataset("verts", data=FRAMES.astype("f4"), compression="gzip", shuffle=True)
    np.testing.assert_array_equal(frames_of(open_sequence([str(path)])), FRAMES)


class Counting:
    """A dataset that remembers what was read of it."""

    def __init__(self, frames):
        self._frames, self.reads = frames, []

    def __getitem__(self, run):
        self.reads.append(run)
        return self._frames[run]


@pytest.mark.parametrize(
    ("chunks", "bound", "count"),
    [
        ((1, 4, 3), 1 << 26, 10),
        ((4, 4, 3), 1 << 26, 3),
        ((4, 2, 1), 1 << 26, 3),
        ((10, 4, 3), 1 << 26, 1),
        ((10, 4, 3), 5 * 4 * 3 * 8, 2),
        ((10, 4, 3), 1, 10),
        (None, 1 << 26, 10),
    ],
)
def test_chunks_are_read_once_and_the_file_stays_open(path, monkeypatch, chunks, bound, count):
    frames = np.random.default_rng(0).normal(size=(10, 4, 3))
    with h5py.File(path, "r+") as file:
        compression = "gzip" if chunks else None
        _replace(file, "verts", data=frames, chunks=chunks, compression=compression)
    monkeypatch.setattr(runs, "LARGEST_RUN", bound)
    sequence = open_sequence([str(path)])
    monkeypatch.setattr(hdf5_clips, "open_file", lambda path: pytest.fail("opened again"))
    counting = sequence._frames._stored = Counting(sequence._frames._stored)
    sequence._frames._runs._kept.clear()
    np.testing.assert_array_equal(frames_of(sequence, 3, 1), frames)
    assert len(counting.reads) == count
    np.testing.assert_array_equal(frames_of(sequence, 3, 4), frames)


def test_a_chunk_that_is_damaged_is_an_error_of_the_file(path):
    with h5py.File(path, "r+") as file:
        _replace(file, "verts", data=FRAMES, chunks=(1, 4, 3), compression="gzip")
        place = file["verts"].id.get_chunk_info(2)
    with path.open("r+b") as stream:
        stream.seek(place.byte_offset)
        stream.write(b"\xff" * place.size)
    with pytest.raises(InputError, match=r"clip\.h5: is not a sound HDF5 file"):
        frames_of(open_sequence([str(path)]))


def _replace(file, name, **how):
    del file[name]
    file.create_dataset(name, **how)


def _link_out(file, name):
    other = file.filename + ".other"
    with h5py.File(other, "w") as target:
        target[name] = FRAMES
    del file[name]
    file[name] = h5py.ExternalLink(other, name)


def _soft_link(file, name):
    file.move(name, "elsewhere")
    file[name] = h5py.SoftLink("/elsewhere")


def _virtual(file, name):
    layout = h5py.VirtualLayout(FRAMES.shape, "f8")
    layout[:] = h5py.VirtualSource("other.h5", name, FRAMES.shape)
    del file[name]
    file.create_virtual_dataset(name, layout)


def _external(file, name):
    _replace(file, name, shape=FRAMES.shape, dtype="f8", external=[("raw.bin", 0, 1 << 20)])


def _group(file, name):
    del file[name]
    file.create_group(f"{name}/inner")


def _components(file, name):
    del file[name]
    file["default"] = FRAMES[0]


DAMAGES = {
    "no verts": (lambda f: f.__delitem__("verts"), "holds no clip; expected datasets `verts` and"),
    "no tris": (lambda f: f.__delitem__("tris"), "has no dataset `tris`"),
    "components": (lambda f: _components(f, "verts"), "holds components of a model, not a clip"),
    "link out of the file": (lambda f: _link_out(f, "verts"), "has no dataset `verts`"),
    "soft link": (lambda f: _soft_link(f, "verts"), "has no dataset `verts`"),
    "virtual": (lambda f: _virtual(f, "verts"), "`verts` is not a dataset held in this file"),
    "external": (lambda f: _external(f, "verts"), "`verts` is not a dataset held in this file"),
    "group": (lambda f: _group(f, "verts"), "`verts` is not a dataset held in this file"),
    "huge claim": (
        lambda f: _replace(f, "verts", shape=(10**6, 10**6, 3), dtype="f8", chunks=(1, 99, 3)),
        "`verts` claims 24000000000000 bytes and holds next to none",
    ),
    "integers": (
        lambda f: _replace(f, "verts", data=FRAMES.astype(int)),
        "`verts` holds int64 values",
    ),
    "text": (lambda f: _replace(f, "verts", data="text"), "`verts` holds object values"),
    "one frame's shape": (
        lambda f: _replace(f, "verts", data=FRAMES[0]),
        "`verts` has shape (4, 3), expected any x any x 3",
    ),
    "frames last": (
        lambda f: _replace(f, "verts", data=FRAMES[:2].transpose(1, 2, 0)),
        "`verts` has shape (4, 3, 2)",
    ),
    "no frames": (lambda f: _replace(f, "verts", data=FRAMES[:0]), "has shape (0, 4, 3)"),
    "empty": (lambda f: _replace(f, "verts", data=h5py.Empty("f8")), "`verts` has shape None"),
    "quads": (lambda f: _replace(f, "tris", data=np.zeros((2, 4), int)), "expected any x 3"),
    "other vertices": (
        lambda f: f["tris"].write_direct(FACES + 2),
        "face 0 names vertices 2, 3, 4 (counted from 0), but there are 4",
    ),
    "counted from 1": (
        lambda f: f["tris"].write_direct(FACES + 1),
        "faces name vertices 1 to 4 of 4, so they are counted from 1; take 1 off them",
    ),
    "first frame not finite": (
        lambda f: f["verts"].__setitem__((0, 1, 2), np.nan),
        "vertex 1 is (9, 16, nan)",
    ),
    "scale of text": (lambda f: f.attrs.update(scale="big"), "attribute `scale` is 'big'"),
    "scale of two": (lambda f: f.attrs.update(scale=[1.0, 2.0]), "attribute `scale` is array"),
    "mean a matrix": (lambda f: f.attrs.update(mean=np.eye(3)), "attribute `mean` is array"),
    "scale that overflows": (
        lambda f: (f.attrs.update(scale=1e308), f["verts"].__setitem__((0, 0, 0), 1e308)),
        "vertex 0 is (inf,",
    ),
    "mean not finite": (lambda f: f.attrs.update(mean=np.inf), "vertex 0 is (inf, inf, inf)"),
}


@pytest.mark.parametrize(("damage", "says"), DAMAGES.values(), ids=DAMAGES)
def test_what_is_no_sound_clip_is_refused(path, damage, says):
    with h5py.File(path, "r+") as file:
        damage(file)
    with pytest.raises(InputError) as caught:
        open_sequence([str(path)])
    assert str(caught.value).startswith(f"{path}: ")
    assert says in str(caught.value)


def test_a_later_frame_that_is_not_finite_is_named(path):
    with h5py.File(path, "r+") as file:
        file["verts"][2, 3, 1] = np.nan
    with pytest.raises(InputError, match=r"clip\.h5\[2\]: vertex 3 is"):
        frames_of(open_sequence([str(path)]))
