"""Names without a letter inside files: each file is read by usable names, or refused in words."""

import io
import json
import zipfile

import h5py
import numpy as np
import pytest

import cageik_cli
from cageik_cli.formats.write import Output, split_output
from cageik_cli.geometry.parts import split_parts
from cageik_cli.util.errors import FormatError, SettingError
from tests.refusals import refused

MESH = cageik_cli.TriMesh(
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)
FRAMES = np.stack([MESH.vertices, MESH.vertices + 1])


@pytest.fixture(params=["", "  "])
def blank(request):
    return request.param


def write_npz(path, arrays):
    with zipfile.ZipFile(path, "w") as file:
        for name, array in arrays.items():
            data = io.BytesIO()
            np.save(data, array)
            file.writestr(f"{name}.npy", data.getvalue())


def test_an_array_of_a_blank_name_in_npz_is_left_alone(tmp_path, blank):
    path = tmp_path / "a.npz"
    write_npz(path, {blank: FRAMES, "vertices": FRAMES, "faces": MESH.faces})
    assert len(cageik_cli.load_clip(path)) == 2
    write_npz(path, {blank: FRAMES, "faces": MESH.faces})
    with refused(FormatError, "holds none of the arrays vertices", at=path):
        cageik_cli.load_clip(path)


def test_a_clip_of_a_blank_name_in_hdf5_is_the_only_one_or_not_chosen(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["faces"], file["  "] = MESH.faces, np.moveaxis(FRAMES, 0, 2)
    assert len(cageik_cli.load_clip(path)) == 2
    with h5py.File(path, "r+") as file:
        file["walk"] = np.moveaxis(FRAMES, 0, 2)
    with refused(SettingError, "holds 2 clips: '  ', walk; choose one, as in FILE::walk"):
        cageik_cli.load_clip(path)
    assert len(cageik_cli.load_clip(f"{path}::walk")) == 2
    with h5py.File(path, "r+") as file:
        del file["walk"]
        file[" "] = np.moveaxis(FRAMES, 0, 2)
    with refused(SettingError, "holds 2 clips: ' ', '  '; give them names"):
        cageik_cli.load_clip(path)


def test_a_prim_of_a_blank_name_is_no_usd(tmp_path):
    path = tmp_path / "a.usda"
    mesh = "point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]\nint[] faceVertexCounts = [3]\n"
    mesh += "int[] faceVertexIndices = [0, 1, 2]"
    path.write_text(f'#usda 1.0\ndef Mesh " " {{\n{mesh}\n}}\n')
    pytest.importorskip("pxr")
    with refused(FormatError, "is not a sound USD file", at=path):
        cageik_cli.load_clip(path)


def test_objects_of_a_blank_name_in_alembic_are_parts_with_files(tmp_path):
    abc, imath = pytest.importorskip("alembic3d"), pytest.importorskip("imath")
    path = tmp_path / "a.abc"
    archive = abc.Abc.OArchive(str(path))
    for name in (" ", "b"):
        mesh = abc.AbcGeom.OPolyMesh(archive.getTop(), name)
        points = imath.V3fArray(4)
        corners, counts = imath.IntArray(12), imath.IntArray(4)
        for k, vertex in enumerate(MESH.vertices):
            points[k] = imath.V3f(*vertex)
        for k, corner in enumerate(MESH.faces.ravel()):
            corners[k] = int(corner)
        for k in range(4):
            counts[k] = 3
        mesh.getSchema().set(abc.AbcGeom.OPolyMeshSchemaSample(points, corners, counts))
    del mesh, archive
    model = cageik_cli.load_mesh(path)
    assert len(split_parts(model)) == 2
    outputs = split_output(Output(tmp_path / "{part}.npz"), model, "a")
    assert len({one.path for one in outputs}) == 2
    assert all(one.path.stem.strip() for one in outputs)


def test_nodes_of_a_blank_name_in_gltf_are_numbered(tmp_path, blank):
    pytest.importorskip("pygltflib")
    path = tmp_path / "a.gltf"
    positions = MESH.vertices.astype("<f4").tobytes()
    corners = MESH.faces.astype("<u2").tobytes()
    (tmp_path / "a.bin").write_bytes(positions + corners)
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 72, "uri": "a.bin"}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 24},
        ],
        "accessors": [
            {
                "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
                "min": MESH.vertices.min(axis=0).tolist(),
                "max": MESH.vertices.max(axis=0).tolist(),
            },
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "meshes": [
            {"name": blank, "primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}
        ],
        "nodes": [{"mesh": 0, "name": blank}, {"mesh": 0, "name": blank}],
        "scenes": [{"nodes": [0, 1]}],
        "scene": 0,
    }  # fmt: skip
    path.write_text(json.dumps(document))
    names = [part.name for part in split_parts(cageik_cli.load_mesh(path))]
    assert names == ["/node_0", "/node_1"]
