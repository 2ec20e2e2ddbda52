"""Clips in HDF5: SPLOCS' scale undone, D-FAUST's clips chosen, strangers' files distrusted."""

import h5py
import numpy as np
import pytest

from cageik_cli.formats import hdf5
from cageik_cli.formats.open import describe_contents, open_sequence
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.util.errors import FormatError, SettingError
from tests.clips import frames_of
from tests.refusals import refused
from tests.texts import texts

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


class Counting:
    """A dataset that remembers what was read of it."""

    def __init__(self, frames):
        self._frames, self.reads = frames, []

    def __getitem__(self, run):
        self.reads.append(run)
        return self._frames[run]


WHOLE = 1 << 26
"""Bytes that hold any clip here."""


@pytest.mark.parametrize(
    ("is_dfaust", "chunks", "bound", "count"),
    [
        (False, (1, 4, 3), WHOLE, 10),
        (False, (4, 4, 3), WHOLE, 3),
        (False, (4, 2, 1), WHOLE, 3),
        (False, (10, 4, 3), WHOLE, 1),
        (False, (10, 4, 3), 5 * 4 * 3 * 8, 2),
        (False, (10, 4, 3), 1, 10),
        (False, None, WHOLE, 10),
        (True, None, WHOLE, 1),
        (True, None, 3 * 4 * 3 * 8, 4),
        (True, (4, 3, 5), WHOLE, 2),
        (True, (2, 1, 5), WHOLE, 2),
        (True, (4, 3, 1), WHOLE, 10),
        (True, (4, 3, 10), 1, 10),
    ],
)
def test_chunks_are_read_once_and_the_file_stays_open(
    path, monkeypatch, is_dfaust, chunks, bound, count
):
    frames = np.random.default_rng(0).normal(size=(10, 4, 3))
    with h5py.File(path, "r+") as file:
        if is_dfaust:
            _dfaust(file)
        name, data = ("a", frames.transpose(1, 2, 0)) if is_dfaust else ("verts", frames)
        compression = "gzip" if chunks else None
        _replace(file, name, data=data, chunks=chunks, compression=compression)
    monkeypatch.setattr("cageik_cli.formats.base.readers.MAX_CHUNK_BYTES", bound)
    sequence = open_sequence([str(path)])
    monkeypatch.setattr(hdf5, "open_file", lambda path: pytest.fail("opened again"))
    counting = sequence._frames._stored = Counting(sequence._frames._stored)
    sequence._frames._cached_chunks.clear()
    np.testing.assert_array_equal(frames_of(sequence, 3, 1), frames)
    assert len(counting.reads) == count
    np.testing.assert_array_equal(frames_of(sequence, 3, 4), frames)


def test_chunks_that_memory_cannot_hold_are_refused(path, monkeypatch):
    with h5py.File(path, "r+") as file:
        _replace(file, "verts", data=FRAMES, chunks=(3, 4, 3), compression="gzip")
    monkeypatch.setattr(hdf5, "MAX_HDF5_CHUNK_BYTES", 3 * 4 * 3 * 8)
    np.testing.assert_array_equal(frames_of(open_sequence([str(path)])), FRAMES)
    monkeypatch.setattr(hdf5, "MAX_HDF5_CHUNK_BYTES", 3 * 4 * 3 * 8 - 1)
    with pytest.raises(FormatError, match=r"clip\.h5: `verts` has chunks of 288 bytes"):
        open_sequence([str(path)])


def test_a_chunk_that_is_damaged_is_an_error_of_the_file(path):
    with h5py.File(path, "r+") as file:
        _replace(file, "verts", data=FRAMES, chunks=(1, 4, 3), compression="gzip")
        place = file["verts"].id.get_chunk_info(2)
    with path.open("r+b") as stream:
        stream.seek(place.byte_offset)
        stream.write(b"\xff" * place.size)
    with pytest.raises(FormatError, match=r"clip\.h5: is not a sound HDF5 file"):
        frames_of(open_sequence([str(path)]))


@pytest.fixture
def bodies(tmp_path):
    """A file of three clips in the layout of D-FAUST, and their frames."""
    rng = np.random.default_rng(0)
    names = {"50002_chicken_wings": 4, "50002_hips": 7, "50004_hips": 1}
    frames = {name: rng.normal(size=(count, 4, 3)).astype("f4") for name, count in names.items()}
    with h5py.File(tmp_path / "bodies.hdf5", "w") as file:
        file["faces"] = FACES.astype("u4")
        for name, clip in frames.items():
            file[name] = clip.transpose(1, 2, 0)
        file["betas"], file["about/more"] = np.zeros((3, 8)), np.zeros((4, 3, 5))
    return tmp_path / "bodies.hdf5", frames


def test_a_clip_is_chosen_by_its_name(bodies):
    path, clips = bodies
    for name, frames in clips.items():
        sequence = open_sequence([f"{path}::{name}"])
        assert sequence.names == tuple(f"bodies.hdf5::{name}[{k + 1}]" for k in range(len(frames)))
        np.testing.assert_array_equal(sequence.first.faces, FACES)
        np.testing.assert_array_equal(frames_of(sequence), frames)


@pytest.mark.parametrize(
    ("member", "says"),
    [
        ("", "holds 3 clips: 50002_chicken_wings, 50002_hips, 50004_hips; "),
        ("::50002_hip", "no clip `50002_hip`; the nearest names are 50002_hips, 50004_hips, 500"),
        ("::betas", "holds no clip `betas`; the nearest names are "),
        ("::about/more", "holds no clip `about/more`"),
        ("::", "given `::` without a name behind it"),
    ],
)
def test_no_name_or_a_wrong_one_is_refused_with_names(bodies, member, says):
    with refused(SettingError, says, at=bodies[0]):
        open_sequence([f"{bodies[0]}{member}"])


def test_more_entries_than_a_file_of_clips_has_are_refused(bodies, monkeypatch):
    """Each is opened, and a link to a clip takes 30 bytes."""
    path, clips = bodies
    monkeypatch.setattr(hdf5, "MAX_TOP_ENTRIES", len(clips) + 2)
    with pytest.raises(FormatError, match=r"has 6 datasets and groups at its top, expected at mos"):
        open_sequence([f"{path}::50002_hips"])
    monkeypatch.setattr(hdf5, "MAX_TOP_ENTRIES", len(clips) + 3)
    assert len(open_sequence([f"{path}::50002_hips"])) == 7


def test_faces_of_a_byte_per_corner_count_as_they_are_computed_with(tmp_path):
    path, faces = tmp_path / "clip.h5", np.zeros(3_000_000, np.int8)
    faces[:150_000] = np.random.default_rng(0).integers(0, 100, 150_000)
    with h5py.File(path, "w") as file:
        file["verts"] = np.random.default_rng(0).normal(size=(2, 100, 3))
        file.create_dataset("tris", data=faces.reshape(-1, 3), compression="gzip")
    with pytest.raises(FormatError, match="`tris`: takes at least 24000000 bytes, packed in 1"):
        open_sequence([str(path)])


def test_the_clips_are_listed(bodies):
    assert describe_contents([str(bodies[0])], ClipSettings()) == [
        ("holds", "3 clips; choose one as FILE::CLIP"),
        ("clip", "50002_chicken_wings, 4 frames of 4 vertices"),
        ("clip", "50002_hips, 7 frames of 4 vertices"),
        ("clip", "50004_hips, 1 frames of 4 vertices"),
    ]
    assert describe_contents([f"{bodies[0]}::50002_hips"], ClipSettings()) == []


def test_the_only_clip_needs_no_name(bodies):
    path, clips = bodies
    with h5py.File(path, "r+") as file:
        del file["50002_hips"], file["50004_hips"]
    for typed in (str(path), f"{path}::50002_chicken_wings"):
        found = frames_of(open_sequence([typed]))
        np.testing.assert_array_equal(found, clips["50002_chicken_wings"])
    assert describe_contents([str(path)], ClipSettings()) == []


def test_hints_of_the_scene_are_taken_if_they_are_sound(path):
    assert open_sequence([str(path)]).scene == SceneHints()
    with h5py.File(path, "r+") as file:
        file.attrs.update(fps=30.0, start=np.float32(5), up_axis="Z", metres_per_unit=-1)
    sequence = open_sequence([str(path)], ClipSettings(slice(1, None)))
    assert sequence.scene == SceneHints(30.0, 6.0, "Z")
    assert texts(sequence.notes) == (
        "clip.h5: ignored `metres_per_unit`: -1 metres per unit, expected a number above zero",
    )
    del sequence
    with h5py.File(path, "r+") as file:
        file.attrs.update(fps="fast", start=[1, 2], up_axis=3, metres_per_unit=h5py.Empty("f8"))
    assert open_sequence([str(path)]).scene == SceneHints()


def _dfaust(file):
    del file["verts"], file["tris"]
    file["faces"], file["a"] = FACES, FRAMES.transpose(1, 2, 0)


def _replace(file, name, **how):
    del file[name]
    file.create_dataset(name, **how)


def _link_out(file, name):
    other = file.filename + ".other"
    with h5py.File(other, "w") as target:
        target[name] = FRAMES
    del file[name]
    file[name] = h5py.ExternalLink(other, name)


def _virtual(file, name):
    layout = h5py.VirtualLayout(FRAMES.shape, "f8")
    layout[:] = h5py.VirtualSource("other.h5", name, FRAMES.shape)
    del file[name]
    file.create_virtual_dataset(name, layout)


def _external(file, name):
    _replace(file, name, shape=FRAMES.shape, dtype="f8", external=[("raw.bin", 0, 1 << 20)])


def _components(file, name):
    del file[name]
    file["default"] = FRAMES[0]


DAMAGES = {
    "no verts": (lambda f: f.__delitem__("verts"), "holds no clip; expected datasets `verts` and"),
    "clips without faces": (
        lambda f: (_dfaust(f), f.__delitem__("faces")),
        "holds no clip; expected datasets `verts` and `tris`",
    ),
    "faces without clips": (lambda f: (_dfaust(f), f.__delitem__("a")), "holds no clip"),
    "clip linked": (lambda f: (_dfaust(f), _link_out(f, "a")), "holds no clip"),
    "faces of D-FAUST from 1": (
        lambda f: (_dfaust(f), f["faces"].write_direct(FACES + 1)),
        "faces name vertices 1 to 4 of 4",
    ),
    "binding": (
        lambda f: f.attrs.update(format="cageik.binding"),
        "is a binding of cageik bind",
    ),
    "result cut short": (
        lambda f: f.attrs.update(format="cageik.result", complete=False),
        "is not complete",
    ),
    "no tris": (lambda f: f.__delitem__("tris"), "has no dataset `tris`"),
    "components": (lambda f: _components(f, "verts"), "components"),
    "link out of the file": (lambda f: _link_out(f, "verts"), "has no dataset `verts`"),
    "virtual": (lambda f: _virtual(f, "verts"), "`verts` is not a dataset"),
    "external": (lambda f: _external(f, "verts"), "`verts` is not a dataset"),
    "integers": (
        lambda f: _replace(f, "verts", data=FRAMES.astype(int)),
        "`verts` holds int64 values",
    ),
    "one frame's shape": (
        lambda f: _replace(f, "verts", data=FRAMES[0]),
        "`verts` has shape (4, 3), expected any x any x 3",
    ),
    "frames last": (
        lambda f: _replace(f, "verts", data=FRAMES[:2].transpose(1, 2, 0)),
        "`verts` has shape (4, 3, 2)",
    ),
    "empty": (lambda f: _replace(f, "verts", data=h5py.Empty("f8")), "`verts` has shape None"),
    "quads": (lambda f: _replace(f, "tris", data=np.zeros((2, 4), int)), "expected any x 3"),
    "other vertices": (
        lambda f: f["tris"].write_direct(FACES + 2),
        "face 0 names vertices 2, 3, 4 (counted from 0), but there are 4",
    ),
    "counted from 1": (
        lambda f: f["tris"].write_direct(FACES + 1),
        "faces name vertices 1 to 4 of 4",
    ),
    "scale of text": (lambda f: f.attrs.update(scale="big"), "attribute `scale` is 'big'"),
    "scale of two": (lambda f: f.attrs.update(scale=[1.0, 2.0]), "is float64 of shape (2,)"),
    "mean a matrix": (lambda f: f.attrs.update(mean=np.eye(3)), "is float64 of shape (3, 3)"),
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
    with refused(FormatError, says, at=path):
        open_sequence([str(path)])
