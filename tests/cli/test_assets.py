"""An asset through extraction and deformation: polygons, UVs and materials in each format.

Each output is read by another program: USD by usd-core, Alembic by alembic3d, OBJ line by line.
"""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.assets import asset_text, parse_asset
from tests.conftest import run_in_process
from tests.shapes import quad_text

ASSET, CAGE = parse_asset(asset_text()), parse_asset(quad_text(1.2))
COUNT = 3


def pose(vertices, k):
    """Frame k: the asset stretched and bent."""
    x, y, z = vertices.T
    return np.column_stack([x + 0.05 * k * z**2, y, z * (1 + 0.02 * k)])


def write_frames(folder, text, vertices):
    """Frames with the text of a file, at other positions."""
    folder.mkdir()
    for k in range(COUNT):
        positions = iter(pose(vertices, k))
        lines = [
            "v {:.9g} {:.9g} {:.9g}".format(*next(positions)) if line[:2] == "v " else line
            for line in text.splitlines()
        ]
        (folder / f"{folder.name}_{k + 1}.obj").write_text("\n".join(lines) + "\n")


def read_obj(path):
    """Polygons, the UVs of their corners, and their materials."""
    asset = parse_asset(Path(path).read_text())
    return asset.polygons, asset.corner_uvs, [name[2] for name in asset.names]


def split(values, counts):
    return [part.tolist() for part in np.split(np.array(values), np.cumsum(counts)[:-1])]


def read_usd(path):
    from pxr import Usd, UsdGeom, UsdShade

    stage = Usd.Stage.Open(path)
    mesh = next(UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get())
    uvs = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").ComputeFlattened()
    names = [""] * len(counts)
    binding = UsdShade.MaterialBindingAPI(mesh)
    whole = binding.ComputeBoundMaterial()[0]
    if whole:
        names = [whole.GetPrim().GetName()] * len(counts)
    for subset in binding.GetMaterialBindSubsets():
        prim = UsdShade.MaterialBindingAPI(subset).ComputeBoundMaterial()[0].GetPrim()
        for face in subset.GetIndicesAttr().Get():
            names[face] = prim.GetDisplayName() or prim.GetName()
    return split(mesh.GetFaceVertexIndicesAttr().Get(), counts), split(uvs, counts), names


def read_abc(path):
    from alembic3d.Abc import IArchive
    from alembic3d.AbcGeom import IPolyMesh

    archive = IArchive(path)
    above = archive.getTop()
    while not IPolyMesh.matches(above.children[0].getHeader()):
        above = above.children[0]
    schema = IPolyMesh(above, above.children[0].getName()).getSchema()
    counts = np.array(schema.getFaceCountsProperty().getValue(0))
    names = [""] * len(counts)
    for name in schema.getFaceSetNames():
        for face in schema.getFaceSet(name).getSchema().getValue().getFaces():
            names[face] = name
    polygons = split(schema.getFaceIndicesProperty().getValue(0), counts)
    uvs = split(schema.getUVsParam().getExpandedValue().getVals(), counts)
    return [ring[::-1] for ring in polygons], [ring[::-1] for ring in uvs], names


CLIPS = {"obj": "frames", "usd": "clip.usda", "abc": "clip.abc"}
OUTPUTS = {
    "obj": ("{}/{}_####.obj", "{}/{}_0002.obj", read_obj),
    "usd": ("{}.usdc", "{}.usdc", read_usd),
    "abc": ("{}.abc", "{}.abc", read_abc),
}


def assert_kept(found, expected):
    polygons, uvs, names = found
    assert polygons == expected.polygons
    assert names == [name[2] for name in expected.names]
    for ring, wanted in zip(uvs, expected.corner_uvs, strict=True):
        np.testing.assert_allclose(ring, wanted, atol=1e-7)


@pytest.fixture(scope="module")
def extracted_assets(tmp_path_factory):
    """A folder, read only, with the asset as a clip of each format, and the result of each.

    The clips of formats that hold one file come from the OBJ frames.
    """
    folder = tmp_path_factory.mktemp("assets")
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.chdir(folder)
        monkeypatch.setenv("CAGEIK_CACHE", str(folder / "cache"))
        write_frames(Path("frames"), asset_text(), ASSET.vertices)
        Path("cage.obj").write_text(quad_text(1.2))
        for kind, clip in CLIPS.items():
            words = ("extract", clip, "--cage", "cage.obj", "-o", f"{kind}.h5", "-q")
            assert kind == "obj" or run_in_process("deform", "obj.h5", "-o", clip, "-q").code == 0
            assert run_in_process(*words, "--accuracy", "preview").code == 0
    return folder


@pytest.fixture(params=CLIPS)
def clip(request, tmp_path, monkeypatch, extracted_assets):
    """The clip of the asset in a format, with its result `r.h5` and its `cage.obj`."""
    monkeypatch.chdir(tmp_path)
    clip = CLIPS[request.param]
    for name, target in (("cage.obj", "cage.obj"), (f"{request.param}.h5", "r.h5"), (clip, clip)):
        Path(target).symlink_to(extracted_assets / name)
    return clip


@pytest.mark.parametrize("out", OUTPUTS)
def test_an_asset_survives(run, clip, out):
    pattern, first, read = OUTPUTS[out]
    assert run("deform", "r.h5", "-o", pattern.format("model", "model"), "-q").code == 0
    assert_kept(read(first.format("model", "model")), ASSET)
    assert run("export", "r.h5", pattern.format("cages", "cages"), "-q").code == 0
    assert_kept(read(first.format("cages", "cages")), CAGE)


@pytest.mark.parametrize("kind", [("deform", "--flat"), ("export", "--skeleton")])
def test_glb_has_the_triangles_of_each_material_with_their_uvs(run, clip, kind):
    """Read by trimesh, which has one mesh per material, and v upward."""
    command, option = kind
    target = ["-o", "out.glb"] if command == "deform" else ["out.glb"]
    outcome = run(command, "r.h5", *target, option)
    assert outcome.code == 0
    vertices = len(trimesh.load_scene("out.glb", process=False).to_geometry().vertices)
    assert command == "export" or f"are {vertices} in the file, split where" in outcome.err
    parts = trimesh.load_scene("out.glb", process=False).geometry.values()
    found = {
        (part.visual.material.name, tuple(np.round(corner, 5)))
        for part in parts
        for corner in part.visual.uv[part.faces].reshape(-1, 2)
    }
    expected = {
        (name[2] or "plain", tuple(np.round(uv, 5)))
        for name, uvs in zip(ASSET.names, ASSET.corner_uvs, strict=True)
        for uv in uvs
    }
    assert {name for name, _ in expected} >= {name for name, _ in found}
    assert found == expected


def test_edited_cages_keep_their_quads(run, clip):
    """Exported, edited by another program and read back, they move the model."""
    assert run("export", "r.h5", "edit/c_####.obj", "-q").code == 0
    for path in Path("edit").iterdir():
        path.write_text(path.read_text().replace("v ", "v 9", 1).replace("v 9-", "v -"))
    assert run("deform", "r.h5", "--cages", "edit", "-o", "m/m_####.obj", "-q").code == 0
    assert_kept(read_obj("m/m_0001.obj"), ASSET)


def test_a_clip_of_cages_is_one_of_quads(run, clip):
    """A result is itself a clip: of its cages."""
    words = ("extract", "r.h5", "--cage", "big.obj", "-o", "again.h5", "--accuracy", "preview")
    Path("big.obj").write_text(quad_text(2.0))
    assert run(*words).code == 0
    assert run("deform", "again.h5", "-o", "c/c_####.obj", "-q").code == 0
    assert_kept(read_obj("c/c_0001.obj"), CAGE)


def test_info_says_what_a_file_keeps(run, clip):
    kept = "56 triangles of 27 polygons with texture coordinates, normals, 3 materials"
    assert f"  model          30 vertices, {kept}" in run("info", "r.h5").out
    found = run("info", "cage.obj").out
    assert "  triangles      12 of 6 polygons with texture coordinates, normals, 1 mat" in found
