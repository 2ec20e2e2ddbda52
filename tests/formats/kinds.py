"""The same little clip in every format, written byte by byte or by another program's library."""

import struct

import alembic3d  # noqa: F401  # before imath, which is its own
import h5py
import imath
import numpy as np
from alembic3d.Abc import OArchive
from alembic3d.AbcCoreAbstract import TimeSampling
from alembic3d.AbcGeom import OPolyMesh, OPolyMeshSchemaSample
from pxr import Sdf, Usd, UsdGeom, UsdUtils, Vt

from tests.formats.gltf.built import Built

FACES = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
FRAMES = np.random.default_rng(0).integers(-99, 99, (5, 4, 3)) / 8
"""Numbers that every format holds exactly."""

PC2_MAGIC = b"POINTCACHE2\0"


def pack(array, kind):
    """Pack numbers as struct does, one by one."""
    return struct.pack(f"{kind[0]}{array.size}{kind[1]}", *np.asarray(array).ravel().tolist())


def pc2(frames=FRAMES, magic=PC2_MAGIC, version=1, start=0.0, rate=1.0, counts=None):
    frame_count, vertex_count = counts or frames.shape[:2]
    header = struct.pack("<iiffi", version, vertex_count, start, rate, frame_count)
    return magic + header + pack(frames, "<f")


def mdd(frames=FRAMES, times=None, counts=None):
    times = np.arange(len(frames)) / 24 if times is None else np.array(times)
    return (
        struct.pack(">ii", *(counts or frames.shape[:2])) + pack(times, ">f") + pack(frames, ">f")
    )


def anime(frames=FRAMES, faces=FACES, counts=None):
    counts = counts or (len(frames), frames.shape[1], len(faces))
    parts = (pack(frames[0], "<f"), pack(faces, "<i"), pack(frames[1:] - frames[0], "<f"))
    return struct.pack("<iii", *counts) + b"".join(parts)


def add_usd_mesh(stage, path="/hero/mesh", frames=FRAMES, times=(1, 2, 3, 4), faces=FACES):
    """Define a mesh of polygons; without times, the first frame is its default value."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
    mesh.CreateFaceVertexIndicesAttr([int(corner) for face in faces for corner in face])
    attribute = mesh.CreatePointsAttr()
    points = [Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(f, np.float32)) for f in frames]
    if not times:
        attribute.Set(points[0])
    for time, frame in zip(times, points, strict=False):
        attribute.Set(frame, time)
    return mesh


def make_abc_arrays(faces):
    """Return how many corners faces have, and the corners, as Alembic takes them."""
    counts, corners = imath.IntArray(len(faces)), imath.IntArray(sum(map(len, faces)))
    for k, face in enumerate(faces):
        counts[k] = len(face)
    for k, corner in enumerate(corner for face in faces for corner in face):
        corners[k] = int(corner)
    return counts, corners


def add_abc_mesh(archive, parent, name, times, frames=FRAMES, faces=FACES):
    """Write a mesh whose faces are given clockwise, as Alembic has them; return its schema."""
    schema = OPolyMesh(parent, name, archive.addTimeSampling(times)).getSchema()
    counts, corners = make_abc_arrays(faces)
    for frame in frames:
        points = imath.V3fArray(len(frame))
        for k, point in enumerate(frame):
            points[k] = imath.V3f(*map(float, point))
        schema.set(OPolyMeshSchemaSample(points, corners, counts))
    return schema


def _write_npz(path, frames):
    np.savez(path, vertices=frames, faces=FACES)


def _write_h5(path, frames):
    with h5py.File(path, "w") as file:
        scaled = ((frames - [1, 2, 3]) / 2).astype("f4")
        file.create_dataset("verts", data=scaled, compression="gzip", shuffle=True)
        file["tris"] = FACES.astype(np.int32)
        file.attrs.update(scale=2.0, mean=[1.0, 2.0, 3.0])


def _write_dfaust(path, frames):
    with h5py.File(path, "w") as file:
        file["faces"] = FACES.astype("u4")
        file.create_dataset("one", data=frames.transpose(1, 2, 0), compression="gzip")


def _write_usd(path, frames):
    stage = Usd.Stage.CreateNew(str(path))
    add_usd_mesh(stage, frames=frames, times=range(1, len(frames) + 1))
    stage.Save()


def _write_usdz(path, frames):
    inner = path.with_name("inner.usdc")
    _write_usd(inner, frames)
    assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(inner)), str(path))
    inner.unlink()


def _write_gltf(path, frames):
    """Write the first frame, and the others as morph targets that are on at one key each."""
    file = Built()
    targets = [{"POSITION": file.array(frame - frames[0])} for frame in frames[1:]]
    primitive = {"attributes": {"POSITION": file.array(frames[0])}, "targets": targets}
    primitive["indices"] = file.array(FACES.ravel(), "H")
    file.add("meshes", {"primitives": [primitive]})
    file.add("nodes", {"mesh": 0, "name": "mesh"})
    weights = np.eye(len(frames))[:, 1:]
    keys = (1 + np.arange(len(frames))) / 24
    if len(frames) > 1:
        file.animate("", (0, "weights", keys, weights.ravel(), "LINEAR"))
    file.save(path)


def _write_abc(path, frames):
    archive = OArchive(str(path))
    times = TimeSampling(1 / 24, 1 / 24)
    add_abc_mesh(archive, archive.getTop(), "mesh", times, frames, FACES[:, ::-1])


KINDS = {
    "clip.pc2": lambda path, frames: path.write_bytes(pc2(frames)),
    "clip.mdd": lambda path, frames: path.write_bytes(mdd(frames)),
    "clip.anime": lambda path, frames: path.write_bytes(anime(frames)),
    "clip.npz": _write_npz,
    "clip.npy": np.save,
    "clip.h5": _write_h5,
    "clip.hdf5": _write_dfaust,
    "clip.usd": _write_usd,
    "clip.usda": _write_usd,
    "clip.usdc": _write_usd,
    "clip.usdz": _write_usdz,
    "clip.abc": _write_abc,
    "clip.glb": _write_gltf,
    "clip.gltf": _write_gltf,
}
"""What writes a clip of `FACES` in one file, by the name of the file."""

WITHOUT_FACES = ("clip.pc2", "clip.mdd", "clip.npy")
