"""Surfaces in USD: written and read by USD itself, and read back as they were."""

import re
from dataclasses import replace

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from cageik_cli.formats.open import open_sequence
from cageik_cli.geometry.mesh import TriMesh
from tests.assets import asset_text, parse_asset
from tests.formats.clips import faults_of, written
from tests.shapes import box
from tests.surfaces import ASSET, CREASES, change
from tests.texts import texts

TEXT = parse_asset(asset_text())


FRAMES = np.stack([ASSET.vertices * (1, 1, 1 + k) for k in range(3)])


STAGES = []
"""Stages that are open: prims are invalid without them."""


def open_mesh(path, name="tube"):
    STAGES.append(Usd.Stage.Open(str(path)))
    return UsdGeom.Mesh(STAGES[-1].GetPrimAtPath(f"/hero/{name}"))


def read_back(path):
    return open_sequence([str(path)]).first


@pytest.fixture
def path(tmp_path):
    return written(tmp_path / "a.usdc", FRAMES, ASSET)


def test_usd_reads_polygons_and_uvs_corner_by_corner(path):
    mesh = open_mesh(path)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get())
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    polygons = np.split(corners, np.cumsum(counts)[:-1])
    assert [polygon.tolist() for polygon in polygons] == TEXT.polygons
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    assert primvar.GetInterpolation() == "faceVarying"
    assert str(primvar.GetTypeName()) == "texCoord2f[]"
    expected = [uv for polygon in TEXT.corner_uvs for uv in polygon]
    np.testing.assert_allclose(np.array(primvar.ComputeFlattened()), expected, atol=1e-7)
    # The islands share no value, and their seams double some.
    np.testing.assert_array_equal(primvar.GetIndices(), ASSET.attributes.uvs.indices)


def test_usd_finds_the_material_of_every_face(path):
    mesh = open_mesh(path)
    found = [""] * len(TEXT.polygons)
    for subset in UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets():
        material = UsdShade.MaterialBindingAPI(subset).ComputeBoundMaterial()[0].GetPrim()
        for face in subset.GetIndicesAttr().Get():
            found[face] = material.GetDisplayName() or material.GetName()
    assert found == [name[2] for name in TEXT.names]
    valid, _ = UsdGeom.Subset.ValidateFamily(mesh, "face", "groups")
    assert valid


def test_normals_are_those_of_each_frame(path):
    mesh = open_mesh(path)
    assert mesh.GetNormalsInterpolation() == "faceVarying"
    for k in range(len(FRAMES)):
        normals = np.array(mesh.GetNormalsAttr().Get(11 + k))
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-6)
        np.testing.assert_allclose(normals[-10:, 2], [-1] * 5 + [1] * 5, atol=1e-6)
        np.testing.assert_allclose(normals[:-10, 2], 0, atol=1e-6)


def test_a_subdivided_surface_has_no_normals(tmp_path):
    mesh = change(ASSET, subdivision=CREASES)
    prim = open_mesh(written(tmp_path / "a.usdc", FRAMES, mesh))
    assert not prim.GetNormalsAttr().HasAuthoredValue()


def test_an_object_called_as_its_materials_are(tmp_path):
    from cageik_cli.formats.base.writers import Animation
    from cageik_cli.formats.settings import Scene
    from cageik_cli.formats.write import Output

    animation = Animation(ASSET, 1, Scene(), "materials")
    with Output(tmp_path / "a.usdc").open_writer(animation) as writer:
        writer.append(FRAMES[:1])
    assert faults_of(tmp_path / "a.usdc") == []
    assert set(read_back(tmp_path / "a.usdc").attributes.materials.names) == {
        "cloth",
        "gold%1",
        "skin",
    }


def make_stage(path, edit):
    """A cube of quads, as another program writes it, that `edit` completes."""
    stage = Usd.Stage.CreateNew(str(path))
    mesh = UsdGeom.Mesh.Define(stage, "/hero")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(box().vertices.astype("f4")))
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(
        [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
    )
    mesh.CreateSubdivisionSchemeAttr("none")
    edit(stage, mesh)
    stage.Save()
    return open_sequence([str(path)])


def add_uvs(interpolation, count, indices=None, name="map1"):
    def edit(stage, mesh):
        kind = Sdf.ValueTypeNames.TexCoord2fArray
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, kind, interpolation)
        primvar.Set([Gf.Vec2f(k, 0) for k in range(count)])
        if indices is not None:
            primvar.SetIndices(indices)

    return edit


def test_uvs_of_vertices_under_another_name(tmp_path):
    uvs = make_stage(tmp_path / "a.usda", add_uvs("vertex", 8)).first.attributes.uvs
    np.testing.assert_array_equal(uvs.indices[:4], [0, 1, 3, 2])


def test_left_handed_faces_keep_the_uvs_of_their_corners(tmp_path):
    def edit(stage, mesh):
        add_uvs("faceVarying", 24)(stage, mesh)
        mesh.CreateOrientationAttr("leftHanded")

    first = make_stage(tmp_path / "a.usda", edit).first
    assert first.attributes.corners[:4].tolist() == [2, 3, 1, 0]
    assert first.attributes.uvs.indices[:4].tolist() == [3, 2, 1, 0]
    first.attributes.check_cut(first.faces)


def test_the_default_scheme_is_kept(tmp_path):
    sequence = make_stage(tmp_path / "a.usda", lambda _, mesh: mesh.GetPrim().RemoveProperty(
        "subdivisionScheme"))  # fmt: skip
    assert sequence.first.attributes.subdivision.scheme == "catmullClark"


def add_subset(name, family, indices, material=None):
    def edit(stage, mesh):
        subset = UsdGeom.Subset.Define(stage, f"/hero/{name}")
        subset.CreateElementTypeAttr("face")
        subset.CreateFamilyNameAttr(family)
        subset.CreateIndicesAttr(indices)
        if material:
            made = UsdShade.Material.Define(stage, f"/looks/{material}")
            UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(made)

    return edit


def test_faces_outside_the_subsets_have_the_material_of_the_mesh(tmp_path):
    def edit(stage, mesh):
        whole = UsdShade.Material.Define(stage, "/looks/whole")
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(whole)
        add_subset("part", "materialBind", [1, 2], "red")(stage, mesh)
        add_subset("side", "faces", [0])(stage, mesh)

    attributes = make_stage(tmp_path / "a.usda", edit).first.attributes
    materials = [attributes.materials.names[k] for k in attributes.materials.indices]
    assert materials == ["whole", "red", "red", "whole", "whole", "whole"]
    assert attributes.groups.names == ("side",)
    assert attributes.groups.indices.tolist() == [0, -1, -1, -1, -1, -1]


LEFT_OUT = {
    "too few UVs": (add_uvs("faceVarying", 23), "texture coordinates left out"),
    "UVs of the whole": (add_uvs("constant", 1), "texture coordinates left out"),
    "indices of UVs": (add_uvs("vertex", 8, [0] * 7 + [8]), "texture coordinates left out"),
    "no UVs": (add_uvs("vertex", 0), "texture coordinates left out"),
    "too few normals": (lambda _, mesh: mesh.CreateNormalsAttr([Gf.Vec3f(0, 0, 1)] * 7), "normals"),
    "a colour of the whole": (
        lambda _, mesh: mesh.CreateDisplayColorPrimvar("constant").Set([Gf.Vec3f(1)]),
        "colours left out",
    ),
    "faces that are not there": (add_subset("a", "b", [6]), "materials and groups left out"),
    "a crease elsewhere": (
        lambda _, mesh: (
            mesh.CreateCreaseIndicesAttr([0, 8]),
            mesh.CreateCreaseLengthsAttr([2]),
            mesh.CreateCreaseSharpnessesAttr([1.0]),
        ),
        "subdivision left out",
    ),
    "creases of others": (
        lambda _, mesh: mesh.CreateCreaseLengthsAttr([2]),
        "subdivision left out",
    ),
}


@pytest.mark.parametrize(("edit", "says"), LEFT_OUT.values(), ids=LEFT_OUT)
def test_what_is_damaged_is_left_out_and_said_so(tmp_path, edit, says):
    sequence = make_stage(tmp_path / "a.usda", edit)
    assert any(says in note for note in texts(sequence.notes))
    assert sequence.first.attributes.uvs is None
    np.testing.assert_array_equal(sequence.first.vertices, box().vertices)


HOSTILE = {
    "creases of text": 'string[] creaseIndices = ["a"]',
    "one crease": "int creaseIndices = 5",
    "sharpness of whole numbers": "int[] creaseSharpnesses = [1]",
    "a scheme of numbers": "uniform int subdivisionScheme = 3",
    "UVs of text": 'string[] primvars:st = ["a"] (interpolation = "vertex")',
    "one UV": 'texCoord2f primvars:st = (0, 1) (interpolation = "vertex")',
    "indices of text": 'texCoord2f[] primvars:st = [(0, 1)] (interpolation = "vertex")\n'
    'string[] primvars:st:indices = ["a"]',
    "normals of text": 'string[] normals = ["a"]',
    "one normal": "normal3f normals = (0, 0, 1)",
    "a colour of text": 'string[] primvars:displayColor = ["a"] (interpolation = "vertex")',
    "opacity of whole numbers": "color3f[] primvars:displayColor = [(0, 0, 1)] "
    '(interpolation = "vertex")\nint[] primvars:displayOpacity = [1] (interpolation = "vertex")',
    "faces of text": 'def GeomSubset "a" {\nuniform token elementType = "face"\n'
    'string[] indices = ["a"]\n}',
    "one face": 'def GeomSubset "a" {\nuniform token elementType = "face"\nint indices = 1\n}',
    "a family of numbers": 'def GeomSubset "a" {\nuniform token elementType = "face"\n'
    "int familyName = 1\nint[] indices = [9]\n}",
    "a binding of nothing": "rel material:binding = </nowhere>",
}
TRIANGLE = """#usda 1.0
def Mesh "hero" {{
point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
int[] faceVertexCounts = [3]
int[] faceVertexIndices = [0, 1, 2]
{}
}}
"""


@pytest.mark.parametrize("line", HOSTILE.values(), ids=HOSTILE)
def test_attributes_of_other_types_are_left_out(tmp_path, line):
    (tmp_path / "a.usda").write_text(TRIANGLE.format(line))
    sequence = open_sequence([str(tmp_path / "a.usda")])
    assert sequence.first.faces.tolist() == [[0, 1, 2]]
    attributes = sequence.first.attributes
    if not replace(attributes, parts=None).is_plain:  # the scheme is then that of USD by default
        assert attributes.subdivision.scheme == "catmullClark"
        given = (attributes.uvs, attributes.normal_fans, attributes.colours, attributes.groups)
        assert given == (None, None, None, None)


def test_triangles_alone_have_no_attributes(tmp_path):
    mesh = TriMesh(box().vertices, box().faces)
    back = read_back(written(tmp_path / "a.usdc", mesh.vertices[None], mesh))
    assert replace(back.attributes, parts=None).is_plain


COLOURS = np.array([[0.5, 0.25, 0.125, 1], [1, 0, 0.75, 0.5], [0, 0.5, 1, 1]])


def test_usd_finds_the_colours_of_materials(tmp_path):
    coloured = change(ASSET, material_colours=COLOURS)
    path = written(tmp_path / "a.usdc", FRAMES, coloured)
    for subset in UsdGeom.Subset.GetAllGeomSubsets(open_mesh(path)):
        material = UsdShade.MaterialBindingAPI(subset).ComputeBoundMaterial()[0]
        if not material:
            continue
        shader = material.ComputeSurfaceSource()[0]
        assert shader.GetIdAttr().Get() == "UsdPreviewSurface"
        name = material.GetPrim().GetDisplayName() or material.GetPrim().GetName()
        expected = COLOURS[ASSET.attributes.materials.names.index(name)]
        np.testing.assert_array_equal(shader.GetInput("diffuseColor").Get(), expected[:3])
        assert shader.GetInput("opacity").Get() == expected[3]
    back = read_back(path).attributes
    order = [ASSET.attributes.materials.names.index(name) for name in back.materials.names]
    np.testing.assert_array_equal(back.material_colours, COLOURS[order])


def test_a_textured_or_damaged_material_has_no_colour(tmp_path):
    coloured = change(ASSET, material_colours=COLOURS)
    path = written(tmp_path / "a.usda", FRAMES, coloured)
    text = path.read_text()
    textured = text.replace("color3f inputs:diffuseColor = ", "string inputs:diffuseColor = ")
    path.write_text(
        re.sub(r"inputs:diffuseColor = \([^)]*\)", 'inputs:diffuseColor = "x"', textured)
    )
    back = read_back(path).attributes
    assert back.material_colours is None or (back.material_colours[:, :3] == 0.8).all()
