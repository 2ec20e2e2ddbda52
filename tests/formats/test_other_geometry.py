"""What is no polygon mesh: surfaces to subdivide are read as their polygons, the rest is named."""

import alembic3d  # noqa: F401  # before imath, which is its own
import numpy as np
import pytest
from alembic3d.AbcGeom import (
    GeometryScope,
    OCurves,
    ONuPatch,
    OPoints,
    OSubD,
    OSubDSchemaSample,
    OV2fGeomParamSample,
)
from imath import FloatArray, IntArrayFromBuffer, V2fArrayFromBuffer, V3fArrayFromBuffer
from pxr import Usd, UsdGeom

from cageik_cli.formats.open import load_mesh
from cageik_cli.util.errors import FormatError
from tests.clips import frames_of
from tests.formats.scenes import EVERY_24TH, FRAMES, MESH, AlembicScene, UsdScene, translation
from tests.formats.written import write
from tests.shapes import QUADS, box
from tests.texts import texts

BOX = (box().vertices + np.arange(4)[:, None, None] * [0.1, 0, 0]).astype("f4")


def to_ints(values):
    return IntArrayFromBuffer(np.array(values, np.int32))


class SubdividedScene(AlembicScene):
    """An archive of surfaces to subdivide, as programs write them."""

    def subdivide(self, name="hair", scheme=None, crease=None, corner=None, uvs=None):
        number = self.file.addTimeSampling(EVERY_24TH)
        schema = OSubD(self.objects[None], name, number).getSchema()
        rings = [corner for quad in QUADS for corner in quad[::-1]]
        for points in BOX:
            sample = OSubDSchemaSample(V3fArrayFromBuffer(points), to_ints(rings), to_ints([4] * 6))
            if scheme is not None:
                sample.setSubdivisionScheme(scheme)
            if crease is not None:
                sample.setCreaseIndices(to_ints(crease))
                sample.setCreaseLengths(to_ints([len(crease)]))
                sample.setCreaseSharpnesses(FloatArray(2.5, 1))
            if corner is not None:
                sample.setCornerIndices(to_ints([corner]))
                sample.setCornerSharpnesses(FloatArray(10.0, 1))
            if uvs is not None:
                values = V2fArrayFromBuffer(uvs.astype("f4"))
                sample.setUVs(OV2fGeomParamSample(values, GeometryScope.kFacevaryingScope))
            schema.set(sample)
        self.objects[name] = schema


@pytest.fixture
def archive(tmp_path):
    return SubdividedScene(tmp_path)


@pytest.fixture
def scene(tmp_path):
    return UsdScene(tmp_path)


def test_a_surface_to_subdivide_is_read_as_its_polygons(archive, tmp_path):
    uvs = np.arange(48).reshape(24, 2)
    archive.subdivide(crease=[0, 1, 3], corner=5, uvs=uvs)
    sequence = archive.opened()
    np.testing.assert_array_equal(frames_of(sequence), BOX)
    mesh = sequence.first
    assert mesh.is_closed
    assert mesh.volume == pytest.approx(8)
    attributes = mesh.attributes
    assert attributes.corner_counts.tolist() == [4] * 6
    assert attributes.uvs is not None
    held = attributes.subdivision
    assert held.scheme == "catmullClark"
    assert held.crease_vertices.tolist() == [0, 1, 3]
    assert held.crease_lengths.tolist() == [3]
    assert held.crease_sharpness.tolist() == [2.5]
    assert (held.corner_vertices.tolist(), held.corner_sharpness.tolist()) == ([5], [10])
    path = write(tmp_path / "out.usdc", mesh, BOX.astype(float))
    stage = Usd.Stage.Open(str(path))
    (prim,) = [UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    assert prim.GetSubdivisionSchemeAttr().Get() == "catmullClark"
    assert list(prim.GetCreaseIndicesAttr().Get()) == [0, 1, 3]
    assert list(prim.GetCornerIndicesAttr().Get()) == [5]


@pytest.mark.parametrize(
    ("scheme", "known"),
    [
        ("catmull-clark", "catmullClark"),
        ("catmullClark", "catmullClark"),
        ("loop", "loop"),
        ("bilinear", "bilinear"),
        ("doo-sabin", "none"),
    ],
)
def test_schemes_are_those_of_usd(archive, scheme, known):
    archive.subdivide(scheme=scheme)
    sequence = archive.opened()
    attributes = sequence.first.attributes
    assert attributes.subdivision.scheme == known
    is_left_out = any("its subdivision left out" in note for note in texts(sequence.notes))
    assert is_left_out == (known == "none")


def test_creases_of_vertices_that_are_not_there_are_left_out(archive):
    archive.subdivide(crease=[0, 8])
    sequence = archive.opened()
    assert sequence.first.attributes.subdivision.scheme == "none"
    assert "its subdivision left out (it names vertex 8 of 8)" in " ".join(texts(sequence.notes))


def test_both_kinds_of_surface_are_parts_in_the_order_of_the_archive(archive):
    archive.subdivide("hair")
    archive.transform([translation(0, 0, 5)], "above")
    archive.mesh("body", "above")
    sequence = archive.opened()
    assert sequence.first.attributes.parts.names == ("/hair", "/above/body")
    assert sequence.first.attributes.subdivision.part_schemes == ("catmullClark", "none")
    frames = frames_of(sequence)
    np.testing.assert_allclose(frames[:, 8:], FRAMES + np.float32([0, 0, 5]), atol=1e-6)
    assert "no mesh" not in " ".join(texts(sequence.notes))


def add_alembic_others(archive):
    for kind, names in ((OCurves, "ab"), (OPoints, "cdefg"), (ONuPatch, "h")):
        for name in names:
            archive.objects[name] = kind(archive.objects[None], name)


def test_what_is_no_surface_of_an_archive_is_named_with_counts(archive):
    archive.mesh("body")
    add_alembic_others(archive)
    sequence = archive.opened()
    (note,) = [note for note in texts(sequence.notes) if "no mesh" in note]
    assert note == (
        "clip.abc: left out what is no mesh: 2 Curves (/a and 1 more), 5 Points (/c and 4 more), 1 "
        "NuPatch (/h); turn them into meshes of polygons to take them along"
    )
    assert texts(archive.opened("::/body").notes) == ()


def test_an_archive_without_a_surface_says_what_it_holds(archive):
    add_alembic_others(archive)
    assert archive.refused() == (
        "holds no mesh, but 2 Curves (/a and 1 more), 5 Points (/c and 4 more), 1 NuPatch (/h); "
        "turn "
        "them into meshes of polygons and export it again"
    )


KINDS = [
    "Sphere",
    "Cube",
    "Cylinder",
    "Cone",
    "Capsule",
    "Plane",
    "NurbsPatch",
    "BasisCurves",
    "NurbsCurves",
    "HermiteCurves",
    "Points",
    "TetMesh",
]


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_mesh_of_a_stage_is_named_with_counts(scene, kind):
    scene.mesh("body")
    for name in ("a", "b", "c", "d"):
        scene.stage.DefinePrim(f"/{name}", kind)
    sequence = scene.opened()
    assert (
        f"clip.usda: left out what is no mesh: 4 {kind} (/a, /b, /c and 1 more); turn them"
        in " ".join(texts(sequence.notes))
    )
    assert "no mesh" not in " ".join(texts(scene.opened("::/body").notes))


@pytest.mark.parametrize("kind", KINDS)
def test_a_stage_without_a_mesh_says_what_it_holds(scene, kind):
    scene.stage.DefinePrim("/a", kind)
    assert scene.refused().startswith(f"holds no mesh, but 1 {kind} (/a); turn them into meshes")


def test_what_nobody_sees_is_not_named(scene):
    """Guides, what is invisible, what a point instancer scatters; cameras and lights."""
    scene.mesh("body")
    for k, name in enumerate(("guide", "hidden", "copies/proto")):
        sphere = UsdGeom.Sphere.Define(scene.stage, f"/{name}")
        if k == 0:
            sphere.CreatePurposeAttr("guide")
        if k == 1:
            sphere.MakeInvisible()
    copies = UsdGeom.PointInstancer.Define(scene.stage, "/copies")
    copies.CreatePrototypesRel().SetTargets(["/copies/proto"])
    for kind in ("Camera", "SphereLight", "Scope"):
        scene.stage.DefinePrim(f"/{kind}", kind)
    assert "no mesh" not in " ".join(texts(scene.opened().notes))


def test_a_stage_of_nothing_holds_no_mesh(scene):
    scene.stage.DefinePrim("/camera", "Camera")
    assert scene.refused() == "holds no mesh; export an animated mesh"


def test_a_mesh_beside_others_is_a_model_too(scene):
    scene.mesh("body", frames=FRAMES[:1])
    scene.stage.DefinePrim("/eye", "Sphere")
    scene.close()
    assert len(load_mesh(scene.path).mesh.vertices) == len(MESH.vertices)
    with pytest.raises(FormatError, match="holds no mesh, but 1 Sphere"):
        load_mesh(make_sphere(scene.path.with_name("eye.usda")))


def make_sphere(path):
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.Sphere.Define(stage, "/eye")
    stage.GetRootLayer().Save()
    return path
