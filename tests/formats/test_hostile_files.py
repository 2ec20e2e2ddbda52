"""Small files that ask for much: each is read, or refused, in bounded time and memory."""

import gzip
import json
import sys

import numpy as np
import pytest
from alembic3d.Abc import OArchive
from alembic3d.AbcCoreAbstract import TimeSampling
from alembic3d.AbcGeom import OFaceSetSchemaSample
from pxr import Usd, UsdGeom, Vt

from tests.formats.gltf.built import Built
from tests.formats.kinds import FRAMES, KINDS, add_abc_mesh, imath
from tests.measured import run_measured
from tests.shapes import TETRAHEDRON

MOST_SECONDS = 10
MOST_BYTES = 1 << 30
"""What one command may take of a processor and of memory; the starts of Python and USD included."""

TRIANGLES = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1/1 3/1 2/1\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def write_wide_number(path):
    text = TRIANGLES + "vt 0 0\n" * 9000 + "vt " + "0" * 400_000 + " 0\n"
    path.write_bytes(gzip.compress(text.encode(), mtime=0))


def write_wide_colour(path):
    colours = "v 0 0 0 1 1 1\n" * 50_000 + "v 1 1 1 1 1 " + "1" * 400_000 + "\n"
    path.write_text(colours + "f 1 2 3\n")


def write_polygon(path, points):
    """One polygon of many corners, whose fan folds over."""
    rows = "".join(f"v {x:.6g} {y:.6g} 0\n" for x, y in points)
    path.write_text(f"{rows}f {' '.join(str(k + 1) for k in range(len(points)))}\n")


def write_star(path):
    angles = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)
    points = np.column_stack([np.cos(angles), np.sin(angles)])
    write_polygon(path, points * np.where(np.arange(20_000) % 2, 1, 0.5)[:, None])


def write_scribble(path):
    write_polygon(path, np.cumsum(np.random.default_rng(0).normal(size=(20_000, 2)), axis=0))


def define_usd_mesh(path, count):
    """A mesh of faces that are alike: crates pack whole numbers, and store equal arrays once."""
    stage = Usd.Stage.CreateNew(str(path))
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreatePointsAttr(np.eye(4, 3, dtype=np.float32))
    mesh.CreateFaceVertexCountsAttr(np.full(count, 3, np.int32))
    mesh.CreateFaceVertexIndicesAttr(np.tile(np.arange(3, dtype=np.int32), count))
    return stage, mesh


def write_subsets(path):
    stage, mesh = define_usd_mesh(path, 60_000)
    faces = Vt.IntArray.FromNumpy(np.arange(60_000, dtype=np.int32))
    for number in range(4000):
        UsdGeom.Subset.CreateGeomSubset(mesh, f"s{number}", "face", faces)
    stage.Save()


def write_opacity(path):
    stage, mesh = define_usd_mesh(path, 4)
    mesh.CreateDisplayColorPrimvar("vertex").Set(np.ones((4, 3), np.float32))
    opacity = mesh.CreateDisplayOpacityPrimvar("vertex")
    opacity.Set(Vt.FloatArray.FromNumpy(np.ones(70_000_000, np.float32)))
    stage.Save()


def write_shared_meshes(path):
    stage, _ = define_usd_mesh(path, 40_000)
    for number in range(2000):
        other = UsdGeom.Mesh.Define(stage, f"/other{number}")
        other.GetPrim().GetReferences().AddInternalReference("/mesh")
    stage.Save()


def write_face_sets(path):
    archive = OArchive(str(path))
    faces = np.tile(np.arange(3), (60_000, 1))
    schema = add_abc_mesh(archive, archive.getTop(), "mesh", TimeSampling(1, 0), FRAMES[:1], faces)
    numbers = imath.IntArrayFromBuffer(np.arange(60_000, dtype=np.int32))
    for number in range(1000):
        schema.createFaceSet(f"s{number}").getSchema().set(OFaceSetSchemaSample(numbers))


STL_FACET = (
    b"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex %b 1 0\nendloop\n"
    b"endfacet\n"
)


def write_wide_stl(path):
    """A number that is no number at its end, and one that is."""
    digits = b"1" * 2_000_000
    facets = STL_FACET % (b"0." + digits) + STL_FACET % (digits + b"x")
    path.write_bytes(b"solid\n" + facets + b"endsolid\n")


def write_many_solids(path):
    text = (b"solid\nendsolid\n" * 50 + b"solid\n" + STL_FACET % b"0" + b"endsolid\n") * 20_000
    path.write_bytes(text)


def damage_clip(path, place):
    """Write a 1 over a number of a clip, on which the library ends its process by a signal."""
    KINDS[f"clip{path.suffix}"](path, FRAMES)
    data = path.read_bytes()
    path.write_bytes(data[:place] + (1).to_bytes(8, "little") + data[place + 8 :])


def build_gltf():
    """Build a tetrahedron in glTF."""
    built = Built()
    positions = built.array(TETRAHEDRON.vertices)
    corners = built.array(TETRAHEDRON.faces.ravel(), "I")
    primitive = {"attributes": {"POSITION": positions}, "indices": corners}
    built.add("nodes", {"mesh": built.add("meshes", {"primitives": [primitive]})})
    return built


def write_points_of_nodes(path):
    built = build_gltf()
    points = built.add("meshes", {"primitives": [{"mode": 0, "attributes": {}}] * 3000})
    built.json["nodes"] += [{"mesh": points}] * 3000
    built.save(path)


def write_channels(path):
    """Channels of one sampler of many keys."""
    built = build_gltf()
    sampler = {"input": built.array(np.arange(100_000) / 24)}
    sampler["output"] = built.array(np.zeros((100_000, 3)))
    built.json["nodes"] += [{} for _ in range(5000)]
    targets = [{"node": k, "path": "translation"} for k in range(1, 5001)]
    channels = [{"sampler": 0, "target": target} for target in targets]
    built.add("animations", {"samplers": [sampler], "channels": channels})
    built.save(path)


def write_targets(path):
    """Morph targets that move nothing."""
    built = Built()
    points = built.array(np.random.default_rng(0).normal(size=(9999, 3)))
    primitive = {"attributes": {"POSITION": points}, "targets": [{}] * 30_000}
    built.add("nodes", {"mesh": built.add("meshes", {"primitives": [primitive]})})
    built.save(path)


def write_nodes(path):
    built = build_gltf()
    built.json["nodes"] += [{}] * 1_000_000
    built.json["scenes"] = [{"nodes": [0]}]
    built.save(path)


def write_joints(path):
    built = build_gltf()
    (primitive,) = built.json["meshes"][0]["primitives"]
    primitive["attributes"] |= {
        "JOINTS_0": built.array(np.zeros((4, 4)), "B"),
        "WEIGHTS_0": built.array(np.eye(4)[[0] * 4]),
    }
    built.json["nodes"][0]["skin"] = built.add("skins", {"joints": [0] * 2_000_000})
    built.save(path)


def write_named_files(path):
    """One file that thousands of buffers name."""
    count = 3000
    (path.parent / "big.bin").write_bytes(np.random.default_rng(0).bytes(1 << 20))
    accessor = {"componentType": 5121, "count": 3, "type": "VEC3"}
    primitives = [{"attributes": {"POSITION": k}} for k in range(count)]
    document = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "buffers": [{"uri": "big.bin", "byteLength": 1 << 20}] * count,
        "bufferViews": [{"buffer": k, "byteLength": 48} for k in range(count)],
        "accessors": [accessor | {"bufferView": k} for k in range(count)],
        "meshes": [{"primitives": primitives}],
    }
    path.write_text(json.dumps(document))


def write_copies(path):
    built = build_gltf()
    built.json["nodes"] *= 40_000
    built.save(path)


def write_instances(path, count):
    """Many triangles of one mesh."""
    built, generator = Built(), np.random.default_rng(0)
    positions = built.array(generator.normal(size=(5000, 3)))
    corners = built.array(generator.integers(5000, size=30_000), "H")
    primitive = {"attributes": {"POSITION": positions}, "indices": corners}
    mesh = built.add("meshes", {"primitives": [primitive]})
    built.json["nodes"] = [{"mesh": mesh}] * count
    built.save(path)


FILES = {
    "wide_number.obj.gz": write_wide_number,
    "wide_colour.obj": write_wide_colour,
    "star.obj": write_star,
    "scribble.obj": write_scribble,
    "subsets.usdc": write_subsets,
    "opacity.usdc": write_opacity,
    "shared_meshes.usdc": write_shared_meshes,
    "face_sets.abc": write_face_sets,
    "wide.stl": write_wide_stl,
    "solids.stl": write_many_solids,
    "points.glb": write_points_of_nodes,
    "channels.glb": write_channels,
    "targets.glb": write_targets,
    "nodes.glb": write_nodes,
    "joints.glb": write_joints,
    "named.gltf": write_named_files,
    "copies.glb": write_copies,
    "instances.glb": lambda path: write_instances(path, 240),
    "more_instances.glb": lambda path: write_instances(path, 385),
    "ends_by_SIGABRT.usdc": lambda path: damage_clip(path, 96),
    "ends_by_SIGSEGV.abc": lambda path: damage_clip(path, 872),
}


LIMITS = {"RLIMIT_AS": 6 * MOST_BYTES, "RLIMIT_CPU": 2 * MOST_SECONDS}
"""They keep a reader that is not bounded from taking the machine; libraries map much unused."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="measures as Linux does")
@pytest.mark.parametrize("name", FILES)
def test_small_files_take_little(tmp_path, name):
    path = tmp_path / name
    FILES[name](path)
    found = run_measured(["info", path], **LIMITS)
    assert found.code in (0, 1), found.text
    assert "internal error" not in found.text
    assert "out of memory" not in found.text
    assert "/numpy/" not in found.text
    assert found.size < MOST_BYTES
    assert found.seconds < MOST_SECONDS


if __name__ == "__main__":
    for path in sys.argv[1:]:
        found = run_measured(["info", path], **LIMITS)
        size, text = found.size / 2**30, found.text[:300]
        print(f"{path}: exit {found.code}, {found.seconds:.1f} s, {size:.2f} GiB, {text!r}")
