"""Animations far from the origin: enough digits, or a note with the remedy."""

import json
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.obj.frames import count_digits
from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.formats.settings import ClipSettings, Scene
from cageik_cli.formats.write import Output, write_animation
from cageik_cli.geometry.attributes import SurfaceAttributes, number_normal_fans
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import OutputError
from cageik_cli.util.progress import ProgressListener
from tests.shapes import ball, changed

FAR = np.array([5e5, 4e6, 0.0])
REST = ball(1, 0.5)
SINGLE = ["out.pc2", "out.mdd", "out.usdc", "out.abc", "out.glb"]
EXACT = ["out.npz", "out_obj/f_####.obj", "out_ply/f_####.ply"]


class Notes(ProgressListener):
    def __init__(self):
        super().__init__()
        self.texts = []

    def note(self, label, text):
        self.texts.append(text)


@pytest.fixture(autouse=True)
def _folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def write(path, offset, attributes=None, **options):
    """Write three frames; return them, the notes, and the frames that are read back."""
    frames = np.stack([REST.vertices * (1 + 0.1 * k) + offset for k in range(3)])
    rest = TriMesh(frames[0], REST.faces, attributes)
    animation, notes = Animation(rest, 3, Scene(), "mesh"), Notes()
    write_animation(Output(Path(path), **options), animation, iter([frames[:2], frames[2:]]), notes)
    return frames, notes.texts


def read(path):
    names = [str(Path(path).parent)] if "#" in path else [path]
    clip = open_sequence(names, ClipSettings())
    return np.stack([clip.read_frame(k) for k in range(3)])


def rounding_notes(texts):
    return [text for text in map(str, texts) if "are rounded by" in text]


@pytest.mark.parametrize("path", SINGLE)
def test_single_precision_far_away_is_noted_with_the_remedy(path):
    """Numbers up to 4e6 are rounded by up to an eighth."""
    _, notes = write(path, FAR)
    (note,) = rounding_notes(notes)
    rounding = 100 * 0.125 / changed(REST).diagonal
    assert note.startswith(
        f"{path}: coordinates of up to 4e+06 are rounded by up to 0.12, {rounding:.2g} % of the"
    )
    assert "`recentre=True`" in note
    assert not Path(f"{path}.offset.json").exists()


@pytest.mark.parametrize("path", SINGLE)
def test_single_precision_near_the_origin_is_not_noted(path):
    assert rounding_notes(write(path, [100, 0, 0])[1]) == []


@pytest.mark.parametrize("path", EXACT)
def test_other_formats_keep_their_digits(path):
    frames, notes = write(path, FAR)
    assert rounding_notes(notes) == []
    assert np.abs(read(path) - frames).max() <= 5e-8 * REST.diagonal


def test_obj_files_with_a_surface_keep_their_digits():
    corners = REST.faces.ravel()
    library = SurfaceAttributes(
        np.full(len(REST.faces), 3),
        corners,
        material_library="100%.9g",
        normal_fans=number_normal_fans(corners, corners),
    )
    frames, _ = write("out/f_####.obj", FAR, library)
    assert np.abs(read("out/f_####.obj") - frames).max() <= 5e-8 * REST.diagonal
    text = Path("out/f_0001.obj").read_bytes()
    assert text.startswith(b"mtllib 100%.9g\nv 500000.5 4000000 0\n")


@pytest.mark.parametrize("path", ["out.pc2", "out.mdd", "out.usdc", "out.abc", *EXACT])
def test_a_recentred_animation_is_near_the_origin_and_its_offset_beside(path):
    frames, notes = write(path, FAR, recentre=True)
    target = Path(path).parent if "#" in path else Path(path)
    beside = target.with_name(f"{target.name}.offset.json")
    offset = json.loads(beside.read_text())["offset"]
    assert rounding_notes(notes) == []
    assert any(str(beside) in note for note in notes)
    if path.endswith(("pc2", "mdd")):
        (tmp := Path("faces.obj")).write_bytes(
            b"v 0 0 0\n" * len(REST.vertices)
            + b"".join(b"f %d %d %d\n" % tuple(face) for face in (REST.faces + 1).tolist())
        )
        clip = open_sequence([path], ClipSettings(), load_mesh(tmp))
        found = np.stack([clip.read_frame(k) for k in range(3)])
    else:
        found = read(path)
    assert np.abs(found).max() < 2
    np.testing.assert_allclose(found + offset, frames, rtol=0, atol=1e-6 * REST.diagonal)


def test_an_offset_file_is_not_replaced_without_overwrite():
    Path("out.npz.offset.json").write_text("mine")
    with pytest.raises(OutputError, match=r"offset\.json"):
        Output(Path("out.npz"), recentre=True).check_writable()
    Output(Path("out.npz"), recentre=True, overwrite=True).check_writable()
    assert Output(Path("out.npz"), recentre=True).list_paths() == [
        Path("out.npz"),
        Path("out.npz.offset.json"),
    ]
    assert Output(Path("out.npz")).list_paths() == [Path("out.npz")]


def test_offsets_are_round_numbers():
    rest = changed(REST, vertices=0.01 * REST.vertices + np.array([0.123456, -7.654321, 0]))
    moved = Animation(rest, 1, Scene(), "mesh").recentre()
    np.testing.assert_allclose(moved.origin, (0.12, -7.65, 0.0), atol=1e-15)
    assert np.abs(moved.rest.vertices).max() < rest.diagonal


@pytest.mark.parametrize(
    ("largest", "diagonal", "digits"),
    [(1, 1, 9), (9.9, 1, 9), (101, 1, 11), (1e30, 1, 17), (1, 0, 9)],
)
def test_digits_grow_with_the_distance(largest, diagonal, digits):
    assert count_digits(np.array([[0, -largest, 0]]), diagonal) == digits
