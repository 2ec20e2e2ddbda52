"""Surfaces in Alembic: read by alembic3d alone, and read back as they were."""

import numpy as np
import pytest
from alembic3d.Abc import IArchive, OArchive
from alembic3d.AbcGeom import (
    GeometryScope,
    IPolyMesh,
    OFaceSetSchemaSample,
    ON3fGeomParamSample,
    OPolyMesh,
    OPolyMeshSchemaSample,
    OV2fGeomParamSample,
)
from imath import IntArrayFromBuffer, UnsignedIntArray, V2fArrayFromBuffer, V3fArrayFromBuffer

from cageik_cli.formats.open import open_sequence
from cageik_cli.geometry.attributes import FaceLabels, UvMap
from tests.assets import asset_text, parse_asset
from tests.formats.clips import written
from tests.shapes import QUADS, box
from tests.surfaces import ASSET, change
from tests.texts import texts

TEXT = parse_asset(asset_text())
FRAMES = np.stack([ASSET.vertices * (1, 1, 1 + k) for k in range(3)])


def test_alembic_reads_what_the_text_says_corner_by_corner(tmp_path):
    archive = IArchive(str(written(tmp_path / "a.abc", FRAMES, ASSET)))
    schema = IPolyMesh(archive.getTop(), "tube").getSchema()
    counts = np.array(schema.getFaceCountsProperty().getValue(0))
    ends = np.cumsum(counts)[:-1]
    polygons = np.split(np.array(schema.getFaceIndicesProperty().getValue(0)), ends)
    assert [polygon[::-1].tolist() for polygon in polygons] == TEXT.polygons
    uvs = np.split(np.array(schema.getUVsParam().getExpandedValue().getVals()), ends)
    for found, expected in zip(uvs, TEXT.corner_uvs, strict=True):
        np.testing.assert_allclose(found[::-1], expected, atol=1e-7)
    normals = np.array(schema.getNormalsParam().getExpandedValue().getVals())
    np.testing.assert_allclose(normals[-10:, 2], [-1] * 5 + [1] * 5, atol=1e-6)
    found = [""] * len(counts)
    for name in schema.getFaceSetNames():
        for face in schema.getFaceSet(name).getSchema().getValue().getFaces():
            found[face] = name
    assert found == [name[2] for name in TEXT.names]


def test_names_that_become_alike_stay_apart(tmp_path):
    mesh = change(ASSET, materials=FaceLabels(("a/b", "a_b"), np.arange(27) % 2))
    read = open_sequence([str(written(tmp_path / "a.abc", FRAMES, mesh))]).first.attributes
    assert read.materials.names == ("a_b", "a_b_")


def test_corners_without_uvs_are_at_zero(tmp_path):
    mesh = change(ASSET, uvs=UvMap(np.ones((1, 2)), np.arange(110) % 2 - 1))
    uvs = open_sequence([str(written(tmp_path / "a.abc", FRAMES, mesh))]).first.attributes.uvs
    np.testing.assert_array_equal(uvs.values[uvs.indices][:, 0], np.arange(110) % 2)


def make_archive(path, uvs=None, normals=None, faces=None):
    """A cube of quads, as another program writes it."""
    schema = OPolyMesh(OArchive(str(path)).getTop(), "hero").getSchema()
    rings = np.array(QUADS, np.int32)[:, ::-1].ravel()
    topology = IntArrayFromBuffer(rings), IntArrayFromBuffer(np.full(6, 4, np.int32))
    points = V3fArrayFromBuffer(box().vertices.astype("f4"))
    schema.set(
        OPolyMeshSchemaSample(
            points, *topology, uvs or OV2fGeomParamSample(), normals or ON3fGeomParamSample()
        )
    )
    if faces is not None:
        numbers = IntArrayFromBuffer(np.array(faces, np.int32))
        schema.createFaceSet("a").getSchema().set(OFaceSetSchemaSample(numbers))
    del schema
    return open_sequence([str(path)])


def make_uvs(count, scope, indices=None):
    values = V2fArrayFromBuffer(np.arange(2 * count, dtype="f4").reshape(-1, 2))
    if indices is None:
        return OV2fGeomParamSample(values, scope)
    numbers = UnsignedIntArray(len(indices))
    for place, index in enumerate(indices):
        numbers[place] = index
    return OV2fGeomParamSample(values, numbers, scope)


def test_uvs_of_vertices(tmp_path):
    sequence = make_archive(tmp_path / "a.abc", make_uvs(8, GeometryScope.kVertexScope))
    uvs = sequence.first.attributes.uvs
    assert uvs.indices[:4].tolist() == list(QUADS[0])


MISSTATED = {
    "corners, as constant": (24, GeometryScope.kConstantScope, None, "corner"),
    "corners, as vertices": (24, GeometryScope.kVertexScope, None, "corner"),
    "corners, as unknown": (24, GeometryScope.kUnknownScope, None, "corner"),
    "corners by an index, as constant": (
        4,
        GeometryScope.kConstantScope,
        [0, 1, 2, 3] * 6,
        "corner",
    ),
    "vertices, as corners": (8, GeometryScope.kFacevaryingScope, None, "vertex"),
    "vertices, as constant": (8, GeometryScope.kConstantScope, None, "vertex"),
    "faces, as constant": (6, GeometryScope.kConstantScope, None, "face"),
}


@pytest.mark.parametrize("given", MISSTATED.values(), ids=MISSTATED)
def test_uvs_whose_scope_is_stated_wrongly_go_by_their_count(tmp_path, given):
    *held, owner = given
    sequence = make_archive(tmp_path / "a.abc", make_uvs(*held))
    rings = np.array(QUADS)  # our faces turn as these
    owners = {
        "corner": np.arange(24).reshape(6, 4)[:, ::-1].ravel(),
        "vertex": rings.ravel(),
        "face": np.repeat(np.arange(6), 4),
    }[owner]
    numbers = np.arange(24) if held[2] is None else np.array(held[2])
    values = np.arange(2 * held[0]).reshape(-1, 2)
    uvs = sequence.first.attributes.uvs
    found, expected = uvs.values[uvs.indices].reshape(6, 4, 2), values[numbers[owners]]
    turned = expected.reshape(6, 4, 2)
    np.testing.assert_array_equal(np.sort(found, axis=1), np.sort(turned, axis=1))
    by_vertex = dict(
        zip(sequence.first.attributes.corners[:4].tolist(), found[0].tolist(), strict=True)
    )
    assert by_vertex == dict(zip(rings[0].tolist(), turned[0].tolist(), strict=True))
    assert f"and read as one per {owner}" in " ".join(texts(sequence.notes))


def test_faces_may_have_uvs_and_a_scope_that_fits_is_not_noted(tmp_path):
    sequence = make_archive(tmp_path / "a.abc", make_uvs(6, GeometryScope.kUniformScope))
    uvs = sequence.first.attributes.uvs
    assert (uvs.indices.reshape(6, 4) == np.arange(6)[:, None]).all()
    assert "read as" not in " ".join(texts(sequence.notes))


def test_normals_of_corners_that_are_stated_as_constant_are_kept(tmp_path):
    values = np.repeat(np.eye(3), 8, axis=0).astype("f4")
    normals = ON3fGeomParamSample(V3fArrayFromBuffer(values), GeometryScope.kConstantScope)
    sequence = make_archive(tmp_path / "a.abc", normals=normals)
    assert sequence.first.attributes.normal_fans is not None
    assert "24 values of its surface are stated as kConstantScope" in " ".join(
        texts(sequence.notes)
    )


WRONG_UVS = {
    "too few": (7, GeometryScope.kVertexScope),
    "too few corners": (23, GeometryScope.kFacevaryingScope),
    "of the whole": (1, GeometryScope.kConstantScope),
    "an index beyond": (2, GeometryScope.kFacevaryingScope, [0, 1] * 11 + [2, 0]),
}


@pytest.mark.parametrize("given", WRONG_UVS.values(), ids=WRONG_UVS)
def test_uvs_that_do_not_fit_are_left_out_and_said_so(tmp_path, given):
    sequence = make_archive(tmp_path / "a.abc", make_uvs(*given))
    assert sequence.first.attributes.uvs is None
    assert "texture coordinates left out" in texts(sequence.notes)[-1]


def test_normals_that_do_not_fit_are_left_out_and_said_so(tmp_path):
    for k, values in enumerate((np.ones((7, 3)), np.full((8, 3), np.nan))):
        points = V3fArrayFromBuffer(values.astype("f4"))
        normals = ON3fGeomParamSample(points, GeometryScope.kVertexScope)
        sequence = make_archive(tmp_path / f"{k}.abc", normals=normals)
        assert sequence.first.attributes.normal_fans is None
        assert "normals left out" in texts(sequence.notes)[-1]


@pytest.mark.parametrize("faces", [[6], [-1, 2]])
def test_face_sets_of_others_are_left_out_and_said_so(tmp_path, faces):
    sequence = make_archive(tmp_path / "a.abc", faces=faces)
    assert sequence.first.attributes.materials is None
    assert "face sets left out" in texts(sequence.notes)[-1]
