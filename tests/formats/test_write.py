"""Names of outputs: what they mean, and which are refused before any work; one mesh out."""

import resource
import struct
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest
import trimesh

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.usd.library import USD_SUFFIXES
from cageik_cli.formats.write import Output, _find_writers, check_mesh_output, write_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import InputError, MissingLibraryError, OutputError, SettingError
from tests.formats.written import bytes_under, single, write
from tests.shapes import ball
from tests.texts import texts


@pytest.mark.parametrize(
    ("name", "kind", "place"),
    [
        ("x/cage.npz", None, "x/cage.npz"),
        ("x/cage.PC2", None, "x/cage.PC2"),
        ("x/cage_####.obj", None, "x"),
        ("x/cage_####.obj", "obj", "x"),
        ("x.y/cage.$F4.ply", None, "x.y"),
        ("x/cage", None, "x/cage"),
        ("x/cage/", "ply", "x/cage"),
        ("x/cage.v2", "ply", "x/cage.v2"),
        ("x#/cage", None, "x#/cage"),
    ],
)
def test_what_is_written(name, kind, place):
    assert Output(Path(name), kind).target_path == Path(place)


@pytest.mark.parametrize(("kind", "files"), [(None, "obj"), ("obj", "obj"), ("ply", "ply")])
def test_a_folder_alone_gives_its_files_its_name(tmp_path, animation, kind, files):
    described = Animation(animation.rest, 5, Scene(start=0), "a")
    with Output(tmp_path / "v1.walk", kind or "obj").open_writer(described) as writer:
        writer.append(animation.frames)
    found = sorted(item.name for item in (tmp_path / "v1.walk").iterdir())
    assert found == [f"v1.walk_{k:04d}.{files}" for k in range(5)]


@pytest.mark.parametrize(
    ("name", "kind", "says"),
    [
        ("a.gif", None, "a.gif: `.gif`"),
        ("v1.walk", None, "v1.walk: `.walk`"),
        ("a_####", None, "a_####: the names of the files have no suffix"),
        ("a.obj", None, "a.obj: a `.obj` file holds one frame"),
        ("x/a_##.npz", None, "x/a_##.npz: a `.npz` file holds all frames"),
        ("x/a_##_##.obj", None, "x/a_##_##.obj: a_##_##.obj has 2"),
        ("x/a_##.ply", "obj", "x/a_##.ply: has another suffix than `file_format=obj`"),
        ("a.glb", "obj", "a.glb: has another suffix than `file_format=obj`"),
        ("a_####.obj", None, ".: is the current folder"),
        ("../a_####.obj", None, "..: is the current folder"),
        (".", None, ".: is the current folder"),
        ("no/where/a_#.obj", None, "no/where: the folder no does not exist; create it first"),
        ("there.txt/a_#.obj", None, "there.txt: is a file, expected the name of a folder"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_before_any_work(tmp_path, monkeypatch, name, kind, says):
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    Path("there.txt").write_text("")
    with pytest.raises(InputError) as caught:
        Output(Path(name), kind, True).check_writable()
    assert str(caught.value).startswith(says)
    assert [item.name for item in Path().iterdir()] == ["there.txt"]


@pytest.mark.parametrize(
    ("module", "name", "says"),
    [
        (
            "pygltflib",
            "a.glb",
            "a.glb: writing .glb needs pygltflib, which is not installed: pip install pygltflib",
        ),
        (
            "pxr",
            "a.usdc",
            "a.usdc: writing USD needs usd-core, which is not installed: pip install usd-core",
        ),
        (
            "alembic3d",
            "a.abc",
            "a.abc: writing .abc needs alembic3d, which is not installed: pip install alembic3d",
        ),
    ],
)
def test_a_library_that_is_missing_is_named_before_any_work(monkeypatch, module, name, says):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingLibraryError) as caught:
        Output(Path(name)).check_writable()
    assert str(caught.value) == says
    Output(Path("a.pc2")).check_writable()


def test_nothing_is_left_of_preparing(tmp_path):
    for name in ("a.glb", "a/a_#.obj", "b"):
        Output(tmp_path / name).check_writable()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "wrong", [{"start": -1.0}, {"start": 0.5}, {"frame_step": 0.5}, {"frame_step": 2.5}]
)
def test_files_are_numbered_by_whole_numbers(tmp_path, animation, wrong):
    ((name, value),) = wrong.items()
    with pytest.raises(SettingError, match=rf" {value:g}, .*`{name}=`"):
        write(tmp_path / "a/a_#.obj", animation.rest, animation.frames, scene=Scene(**wrong))
    assert not list(tmp_path.iterdir())


MESH = ball(levels=1)
MOVED = 2 * MESH.vertices + 1


@pytest.mark.parametrize("name", ["posed.obj", "posed.ply", "POSED.OBJ"])
def test_trimesh_reads_it(tmp_path, name):
    write_mesh(tmp_path / name, MESH, MOVED, overwrite=False)
    kind = name[-3:].lower()
    read = trimesh.load(tmp_path / name, file_type=kind, process=False, maintain_order=True)
    np.testing.assert_allclose(read.vertices, MOVED, rtol=1e-6, atol=0)
    np.testing.assert_array_equal(read.faces, MESH.faces)
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["posed.npz", "posed.abc", "posed", "posed.fbx"])
def test_files_that_hold_no_single_mesh_are_refused(tmp_path, name):
    with pytest.raises(OutputError, match=rf"{name}: .*expected \.obj, \.ply"):
        check_mesh_output(tmp_path / name, overwrite=False)


def test_what_is_there_is_kept(tmp_path):
    (tmp_path / "posed.obj").write_text("mine")
    for refused in (
        check_mesh_output,
        lambda path, overwrite: write_mesh(path, MESH, MOVED, overwrite),
    ):
        with pytest.raises(OutputError, match="exists already"):
            refused(tmp_path / "posed.obj", overwrite=False)
    assert (tmp_path / "posed.obj").read_text() == "mine"


OWN = ("a.npz", "a.pc2", "a.mdd", "a.glb", "a.vat", "a/a_####.obj", "a/a_%04d.ply")
"""Without the library of another, which has its own words for a full disk, or ends the process."""

OUTPUTS = (*OWN, "a.abc", *(f"a{suffix}" for suffix in USD_SUFFIXES))


@pytest.fixture
def scene():
    return Scene(fps=30.0, start=7.0, up_axis="Z", metres_per_unit=0.01)


def place(path):
    return Output(path).target_path


def test_no_format_is_left_out():
    assert {Path(name).suffix for name in OUTPUTS} == set(_find_writers())


@pytest.mark.parametrize("name", OUTPUTS)
def test_neither_blocks_nor_time_change_the_bytes(tmp_path, animation, name):
    found = []
    for size in (1, 2, 3, 5, 2):
        path = write(tmp_path / name, animation.rest, animation.frames, size, overwrite=True)
        found.append(bytes_under(place(path)))
    assert all(other == found[0] for other in found)


@pytest.mark.parametrize("name", OUTPUTS)
def test_frames_in_any_order_of_memory_are_the_same(tmp_path, animation, name):
    """A product's frames lie across each other."""
    before = bytes_under(place(write(tmp_path / name, animation.rest, animation.frames)))
    across = np.asfortranarray(animation.frames)
    after = bytes_under(place(write(tmp_path / name, animation.rest, across, overwrite=True)))
    assert before == after


@pytest.mark.parametrize("name", OUTPUTS)
@pytest.mark.parametrize("appended", [0, 3])
def test_what_fails_leaves_nothing(tmp_path, animation, name, appended):
    def fail():
        with Output(tmp_path / name).open_writer(
            Animation(animation.rest, 5, Scene(), "a")
        ) as writer:
            writer.append(animation.frames[:appended])
            raise RuntimeError("the frames end here")

    with pytest.raises(RuntimeError, match="the frames end here"):
        fail()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", OWN)
def test_a_full_disk_is_said_and_what_was_there_stays(tmp_path, animation, name):
    """As a limit on the size of a file, which the system enforces; long before its end."""
    path = write(tmp_path / name, animation.rest, animation.frames)
    before = bytes_under(place(path))
    many = trimesh.creation.icosphere(4)
    mesh = TriMesh(many.vertices, many.faces)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 12, hard))
    try:
        with pytest.raises(OutputError, match=r"a(\.\w+)?: cannot be written \(File too large\)"):
            write(path, mesh, np.stack([mesh.vertices] * 3), overwrite=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert bytes_under(place(path)) == before
    assert [item.name for item in tmp_path.iterdir()] == [place(path).name]


def measure_largest_file(path):
    return max(file.stat().st_size for file in (path.iterdir() if path.is_dir() else [path]))


@pytest.mark.parametrize("name", [name for name in OUTPUTS if name != "a.abc"])
def test_a_disk_that_is_full_anywhere_is_said(tmp_path, animation, name):
    """At the last bytes, too, which are written when the file is closed."""
    path = write(tmp_path / name, animation.rest, animation.frames)
    before, size = bytes_under(place(path)), measure_largest_file(place(path))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    for room in {0, 1, *range(0, size, size // 20), *range(size - 200, size, 20), size - 1}:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
        try:
            with pytest.raises(OutputError, match=r"a(\.\w+)?: cannot be written \("):
                write(path, animation.rest, animation.frames, overwrite=True)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert bytes_under(place(path)) == before
        assert [item.name for item in tmp_path.iterdir()] == [place(path).name]


@pytest.mark.parametrize("name", ["a.pc2", "a.mdd", "a.glb", "a.vat", "a.abc", "a.usda", "a.usdz"])
@pytest.mark.parametrize("size", [1e39, -1e39])
def test_what_float32_does_not_hold_is_refused(tmp_path, animation, name, size):
    with pytest.raises(OutputError, match=r"e\+39 is too large"):
        write(tmp_path / name, animation.rest, size * animation.frames)
    assert not list(tmp_path.iterdir())


def test_the_largest_float32_is_written(tmp_path, animation):
    largest = float(np.finfo(np.float32).max)
    frames = animation.frames / np.abs(animation.frames).max() * largest
    data = write(tmp_path / "a.pc2", animation.rest, frames).read_bytes()
    assert np.abs(np.frombuffer(data, "<f4", offset=32)).max() == np.float32(largest)


# --- read back by others


@pytest.mark.parametrize(
    ("pattern", "tolerance"),
    [("a_####.obj", {"rtol": 1e-8, "atol": 1e-9}), ("a_$F4.ply", {"rtol": 0})],
)
def test_frames_in_trimesh_and_meshio(tmp_path, animation, scene, pattern, tolerance):
    write(tmp_path / "a" / pattern, animation.rest, animation.frames, scene=scene)
    paths = sorted((tmp_path / "a").iterdir())
    assert [path.stem for path in paths] == [f"a_{k:04d}" for k in range(7, 12)]
    for path, frame in zip(paths, animation.frames, strict=True):
        loaded = trimesh.load(path, process=False, maintain_order=True)
        np.testing.assert_allclose(loaded.vertices, frame, **tolerance)
        np.testing.assert_array_equal(loaded.faces, animation.rest.faces)
        other = meshio.read(path)
        np.testing.assert_allclose(other.points, frame, **tolerance)
        np.testing.assert_array_equal(other.cells_dict["triangle"], animation.rest.faces)


def test_obj_text_tells_float32_apart(tmp_path, animation):
    """Nine digits do; eight do not."""
    close = np.float32(1) + np.arange(18, dtype=np.float32) * np.finfo(np.float32).eps
    frames = np.repeat(close[:, None], 3, axis=1)[None].astype(float) * 1.7
    write(tmp_path / "a" / "a_#.obj", animation.rest, single(frames))
    lines = (tmp_path / "a" / "a_1.obj").read_text().splitlines()
    found = np.array([line.split()[1:] for line in lines if line.startswith("v ")], np.float32)
    np.testing.assert_array_equal(found, frames[0].astype(np.float32))


def test_npz_in_numpy(tmp_path, animation, scene):
    path = write(tmp_path / "a.npz", animation.rest, animation.frames, scene=scene)
    with np.load(path, allow_pickle=False) as file:
        np.testing.assert_array_equal(file["vertices"], animation.frames)
        np.testing.assert_array_equal(file["faces"], animation.rest.faces)
        assert (file["fps"], file["start"]) == (30, 7)
        assert (file["up_axis"], file["metres_per_unit"]) == ("Z", 0.01)


def test_pc2_as_it_is_described(tmp_path, animation, scene):
    path = write(tmp_path / "a.pc2", animation.rest, animation.frames, scene=scene)
    data = path.read_bytes()
    assert data[:12] == b"POINTCACHE2\0"
    assert struct.unpack("<ii", data[12:20]) == (1, 18)
    assert struct.unpack("<ff", data[20:28]) == (7.0, 1.0)
    assert struct.unpack("<i", data[28:32]) == (5,)
    found = np.frombuffer(data, "<f4", offset=32).reshape(5, 18, 3)
    np.testing.assert_array_equal(found, animation.frames.astype(np.float32))


def test_mdd_as_it_is_described(tmp_path, animation, scene):
    path = write(tmp_path / "a.mdd", animation.rest, animation.frames, scene=scene)
    data = path.read_bytes()
    assert struct.unpack(">ii", data[:8]) == (5, 18)
    times = np.frombuffer(data, ">f4", 5, offset=8)
    np.testing.assert_allclose(times * 30, [7, 8, 9, 10, 11], rtol=1e-6)
    found = np.frombuffer(data, ">f4", offset=28).reshape(5, 18, 3)
    np.testing.assert_array_equal(found, animation.frames.astype(np.float32))


@pytest.mark.parametrize("name", ["a.pc2", "a.mdd"])
@pytest.mark.parametrize(
    ("scene", "ends"),
    [
        (Scene(start=0.0), []),
        (Scene(start=1001.5), ["set its Frame Start to 1001.5"]),
        (Scene(start=0.0, frame_step=2), ["set its Frame Scale to 0.5"]),
    ],
)
def test_where_blender_puts_the_frames_is_said(tmp_path, animation, name, scene, ends):
    described = Animation(animation.rest, 5, scene, "a")
    with Output(tmp_path / name).open_writer(described) as writer:
        writer.append(animation.frames)
    assert len(texts(writer.notes)) == len(ends)
    assert all(map(str.endswith, texts(writer.notes), ends))
