"""A format is one module: two toy formats, found by nothing but their place in the package."""

import gzip
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import cageik_cli.formats
from cageik_cli.formats.base.files import discover_plugins
from cageik_cli.formats.open import clip_suffixes, load_mesh, mesh_suffixes, open_sequence
from cageik_cli.formats.write import write_mesh
from tests.clips import frames_of
from tests.formats.written import write
from tests.shapes import octahedron

TOY_MESH = '''
"""A mesh per file, as JSON."""

import json

import numpy as np

from cageik_cli.formats.base.files import with_gzip
from cageik_cli.formats.base.readers import FrameFileReader
from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.formats.base.writers import FrameFileWriter
from cageik_cli.util.errors import FormatError


class Reader(FrameFileReader):
    suffixes = with_gzip(".toymesh")

    @classmethod
    def parse(cls, data):
        try:
            points, polygons = json.loads(data)
        except ValueError as error:
            raise FormatError(f"not a toy mesh: {error}") from error
        return FileMesh.from_polygons(np.array(points), polygons)


class Writer(FrameFileWriter):
    suffixes = (".toymesh",)

    def __init__(self, target, animation):
        super().__init__(target, animation)
        self._faces = animation.rest.faces.tolist()

    def encode_frame(self, positions):
        return json.dumps([positions.tolist(), self._faces]).encode()
'''

TOY_CLIP = '''
"""A clip per file, as JSON."""

import json

import numpy as np

from cageik_cli.formats.base.readers import ArrayClip, ArrayClipFile
from cageik_cli.formats.base.writers import AnimationWriter


class Frames:
    def __init__(self, frames):
        self._frames = np.array(frames)
        self.frame_count, self.vertex_count, _ = self._frames.shape

    def read_frame(self, index):
        return self._frames[index]


class Reader(ArrayClipFile):
    suffixes = (".toyclip",)

    @classmethod
    def open_clip(cls, request):
        frames, faces = json.loads(request.path.read_text())
        return ArrayClip(Frames(frames), np.array(faces))


class Writer(AnimationWriter):
    suffixes = (".toyclip",)

    def __init__(self, target, animation):
        self._target, self._faces, self._frames = target, animation.rest.faces.tolist(), []

    def append(self, frames):
        self._frames += frames.tolist()

    def complete(self):
        self._target.write_text(json.dumps([self._frames, self._faces]))
'''

SECOND_TOY_MESH = """
class Reader:
    suffixes = (".toymesh",)
"""


@pytest.fixture
def package_folder(tmp_path_factory, monkeypatch):
    """A folder whose modules are part of `cageik_cli.formats` during the test."""
    folder = tmp_path_factory.mktemp("formats")
    package = cageik_cli.formats
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    discover_plugins.cache_clear()
    yield folder
    discover_plugins.cache_clear()
    for module in [f"{package.__name__}.{path.stem}" for path in folder.glob("*.py")]:
        sys.modules.pop(module, None)


@pytest.fixture
def toy_formats(package_folder):
    (package_folder / "toy_mesh.py").write_text(TOY_MESH)
    (package_folder / "toy_clip.py").write_text(TOY_CLIP)


MESH = octahedron()
FRAMES = MESH.vertices + np.random.default_rng(7).normal(0, 0.1, (5, 6, 3))


@pytest.mark.usefixtures("toy_formats")
def test_suffixes_of_new_formats_are_listed():
    assert {".toymesh", ".toymesh.gz"} <= set(mesh_suffixes())
    assert {".toymesh", ".toymesh.gz", ".toyclip"} <= set(clip_suffixes())
    assert ".toyclip" not in mesh_suffixes()


def test_new_formats_are_gone_without_their_modules():
    assert not {".toymesh", ".toyclip"} & {*clip_suffixes(), *discover_plugins("Writer")}


@pytest.mark.usefixtures("toy_formats")
@pytest.mark.parametrize("target", ["frames/f_####.toymesh", "clip.toyclip"])
def test_animations_are_read_back(tmp_path, target):
    (tmp_path / "frames").mkdir()
    path = write(tmp_path / target, MESH, FRAMES)
    sequence = open_sequence([str(path if path.is_file() else path.parent)])
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)
    np.testing.assert_array_equal(sequence.first.faces, MESH.faces)


@pytest.mark.usefixtures("toy_formats")
def test_meshes_are_read_back_also_packed(tmp_path):
    path, packed = tmp_path / "a.toymesh", tmp_path / "a.toymesh.gz"
    write_mesh(path, MESH, FRAMES[0], overwrite=False)
    packed.write_bytes(gzip.compress(path.read_bytes()))
    for file in (path, packed):
        loaded = load_mesh(file)
        np.testing.assert_array_equal(loaded.mesh.vertices, FRAMES[0])
        np.testing.assert_array_equal(loaded.mesh.faces, MESH.faces)


def read_cages(path):
    with h5py.File(path) as file:
        return file["verts"][:]


@pytest.mark.usefixtures("toy_formats")
def test_new_formats_work_from_the_command_line(folder, run, animation):
    """Frames and a cage out of toy files give what they give out of OBJ files."""
    Path("toys").mkdir()
    write(folder / "toys/f_####.toymesh", animation.rest, animation.frames)
    write_mesh(folder / "cage.toymesh", animation.cage, animation.cage.vertices, overwrite=False)
    assert run("extract", "frames", "--cage", "cage.obj", "-o", "obj.h5", "-q").code == 0
    assert run("extract", "toys", "--cage", "cage.toymesh", "-o", "toy.h5", "-q").code == 0
    expected = read_cages("obj.h5")
    np.testing.assert_array_equal(read_cages("toy.h5"), expected)
    for target in ("cages.toyclip", "cages/c_##.toymesh"):
        assert run("export", "toy.h5", target).code == 0
    assert run("export", "toy.h5", "folder", "--format", "toymesh").code == 0
    for source in ("cages.toyclip", "cages", "folder"):
        np.testing.assert_array_equal(frames_of(open_sequence([source])), expected)
    info = run("info", "cages.toyclip")
    assert (info.code, "a clip" in info.out) == (0, True)


@pytest.mark.usefixtures("toy_formats")
def test_a_suffix_has_one_format(package_folder):
    (package_folder / "toy_mesh_again.py").write_text(SECOND_TOY_MESH)
    with pytest.raises(ValueError, match=r"\.toymesh: .*toy_mesh .*toy_mesh_again"):
        discover_plugins("Reader")
