"""A format is one module: a toy format, found by nothing but its place in the package."""

import gzip
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import cageik_cli.formats
from cageik_cli.formats.base.files import discover_plugins
from cageik_cli.formats.find_files import clip_suffixes, mesh_suffixes
from cageik_cli.formats.open import load_mesh, open_sequence
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
def toy_format(package_folder):
    (package_folder / "toy_mesh.py").write_text(TOY_MESH)


MESH = octahedron()
FRAMES = MESH.vertices + np.random.default_rng(7).normal(0, 0.1, (5, 6, 3))


@pytest.mark.usefixtures("toy_format")
def test_suffixes_of_a_new_format_are_listed():
    assert {".toymesh", ".toymesh.gz"} <= {*mesh_suffixes()} & {*clip_suffixes()}


def test_a_new_format_is_gone_without_its_module():
    assert ".toymesh" not in {*clip_suffixes(), *discover_plugins("Writer")}


@pytest.mark.usefixtures("toy_format")
def test_animations_are_read_back(tmp_path):
    path = write(tmp_path / "frames/f_####.toymesh", MESH, FRAMES)
    sequence = open_sequence([str(path.parent)])
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)
    np.testing.assert_array_equal(sequence.first.faces, MESH.faces)


@pytest.mark.usefixtures("toy_format")
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


@pytest.mark.usefixtures("toy_format")
def test_a_new_format_works_from_the_command_line(folder, run, animation):
    """Frames and a cage out of toy files give what they give out of OBJ files."""
    Path("toys").mkdir()
    write(folder / "toys/f_####.toymesh", animation.rest, animation.frames)
    write_mesh(folder / "cage.toymesh", animation.cage, animation.cage.vertices, overwrite=False)
    assert run("extract", "frames", "--cage", "cage.obj", "-o", "obj.h5", "-q").code == 0
    assert run("extract", "toys", "--cage", "cage.toymesh", "-o", "toy.h5", "-q").code == 0
    expected = read_cages("obj.h5")
    np.testing.assert_array_equal(read_cages("toy.h5"), expected)
    assert run("export", "toy.h5", "cages/c_##.toymesh").code == 0
    assert run("export", "toy.h5", "folder", "--format", "toymesh").code == 0
    for source in ("cages", "folder"):
        np.testing.assert_array_equal(frames_of(open_sequence([source])), expected)


@pytest.mark.usefixtures("toy_format")
def test_a_suffix_has_one_format(package_folder):
    (package_folder / "toy_mesh_again.py").write_text(SECOND_TOY_MESH)
    with pytest.raises(ValueError, match=r"\.toymesh: .*toy_mesh .*toy_mesh_again"):
        discover_plugins("Reader")
