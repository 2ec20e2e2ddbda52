"""The character of four parts in files of other programs, and read back without cageik."""

import struct
import warnings
from dataclasses import dataclass

import imath
import numpy as np
import trimesh
from alembic3d.Abc import IArchive, OArchive
from alembic3d.AbcCoreAbstract import TimeSampling
from alembic3d.AbcGeom import (
    GeometryScope,
    IPolyMesh,
    IXform,
    OFaceSetSchemaSample,
    ON3fGeomParamSample,
    OPolyMesh,
    OPolyMeshSchemaSample,
    OV2fGeomParamSample,
    OXform,
    XformSample,
)
from pxr import Usd, UsdGeom, UsdShade
from pygltflib import GLTF2

from tests.character import COLOURS, NAMES, make_character, make_parts, make_transforms, write_usd
from tests.formats.gltf.built import Built
from tests.formats.gltf.decoded import KINDS, WIDTHS, make_matrix

Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""Rows of a scene with z up times it have y up."""


@dataclass(eq=False)
class Found:
    """A mesh of a file: its frames (F, k, 3) in its own space, and what places it, (4, 4).

    `uvs` is the vertex and the coordinates of each corner, (c, 3).
    """

    path: str
    frames: np.ndarray
    matrix: np.ndarray
    uvs: np.ndarray | None = None
    material: tuple[str, tuple[float, ...]] | None = None

    @property
    def placed(self):
        return self.frames @ self.matrix[:3, :3] + self.matrix[3, :3]


def split_frames():
    """The name, the mesh, the transform and the frames in its own space of each part."""
    _, frames = make_character()
    start = 0
    for name, mesh, matrix in zip(NAMES, make_parts(), make_transforms(), strict=True):
        stop, inverse = start + len(mesh.vertices), np.linalg.inv(matrix)
        yield name, mesh, matrix, frames[:, start:stop] @ inverse[:3, :3] + inverse[3, :3]
        start = stop


# --- files as other programs write them


def write_alembic(path):
    """As Maya does: each mesh is a shape below a transform of its name."""
    archive = OArchive(str(path))
    sampling = archive.addTimeSampling(TimeSampling(1 / 24, 1 / 24))
    above = {"": archive.getTop()}
    for name, mesh, matrix, frames in split_frames():
        steps = name.strip("/").split("/")
        for k in range(len(steps)):
            place = "/".join(steps[: k + 1])
            if place not in above:
                above[place] = OXform(above["/".join(steps[:k])], steps[k])
                if k == len(steps) - 1 and not np.array_equal(matrix, np.eye(4)):
                    sample = XformSample()
                    sample.setMatrix(imath.M44d(*matrix.ravel().tolist()))
                    above[place].getSchema().set(sample)
        shape = OPolyMesh(above["/".join(steps)], f"{steps[-1]}Shape", sampling).getSchema()
        _set_alembic_mesh(shape, mesh.attributes, frames)
    return path


def _set_alembic_mesh(schema, attributes, frames):
    ends = np.cumsum(attributes.corner_counts)[:-1]
    turned = [ring[::-1] for ring in np.split(np.arange(len(attributes.corners)), ends)]
    order = np.concatenate(turned)  # clockwise
    uvs = attributes.uvs.values[attributes.uvs.indices][order].astype("f4")
    corners = imath.IntArrayFromBuffer(attributes.corners[order].astype("i4"))
    counts = imath.IntArrayFromBuffer(attributes.corner_counts.astype("i4"))
    sample = OV2fGeomParamSample(imath.V2fArrayFromBuffer(uvs), GeometryScope.kFacevaryingScope)
    for frame in frames:
        points = imath.V3fArrayFromBuffer(np.ascontiguousarray(frame, "f4"))
        schema.set(OPolyMeshSchemaSample(points, corners, counts, sample, ON3fGeomParamSample()))
    faces = imath.IntArrayFromBuffer(np.arange(len(counts), dtype="i4"))
    (material,) = attributes.materials.names
    schema.createFaceSet(material).getSchema().set(OFaceSetSchemaSample(faces))


def write_gltf(path):
    """As exporters do: vertices split at seams, a morph target per frame, y up by a node."""
    file = Built()
    names = {"": None}
    for name, colour in COLOURS.items():
        shade = {"baseColorFactor": list(colour)}
        file.add("materials", {"name": name, "pbrMetallicRoughness": shade})
    channels = []
    for name, mesh, matrix, frames in split_frames():
        attributes = mesh.attributes
        uvs = attributes.uvs.values[attributes.uvs.indices]
        ends = np.cumsum(attributes.corner_counts)[:-1]
        fans = [
            [ring[0], ring[k], ring[k + 1]]
            for ring in np.split(np.arange(len(uvs)), ends)
            for k in range(1, len(ring) - 1)
        ]
        rows = np.column_stack([attributes.corners, uvs])
        split, indices = np.unique(rows, axis=0, return_inverse=True)
        numbers = split[:, 0].astype(int)
        given = {
            "POSITION": file.array(frames[0][numbers]),
            "TEXCOORD_0": file.array(np.column_stack([split[:, 1], 1 - split[:, 2]])),
        }
        targets = [{"POSITION": file.array((one - frames[0])[numbers])} for one in frames[1:]]
        primitive = {"attributes": given, "targets": targets}
        primitive["indices"] = file.array(indices.ravel()[np.concatenate(fans)], "H")
        primitive["material"] = list(COLOURS).index(attributes.materials.names[0])
        node = _add_nodes(file, names, name, matrix)
        node["mesh"] = file.add("meshes", {"primitives": [primitive]})
        number = file.json["nodes"].index(node)
        keys = (1 + np.arange(len(frames))) / 24
        weights = np.eye(len(frames))[:, 1:].ravel()
        channels.append((number, "weights", keys, weights, "LINEAR"))
    file.animate("bend", *channels)
    return file.save(path)


def _add_nodes(file, numbers, path, matrix):
    """Add the node of a path, and those above it; the top one turns z up into y up."""
    steps = path.strip("/").split("/")
    for k, step in enumerate(steps):
        place, above = "/".join(steps[: k + 1]), "/".join(steps[:k])
        if place not in numbers:
            node = {"name": step}
            if not above:
                node["matrix"] = Y_UP.ravel().tolist()
            elif k == len(steps) - 1:
                node["matrix"] = matrix.ravel().tolist()
            numbers[place] = file.add("nodes", node)
            if above:
                file.json["nodes"][numbers[above]].setdefault("children", []).append(numbers[place])
    return file.json["nodes"][numbers["/".join(steps)]]


def write_obj(folder):
    """A folder of files, each with four objects; and the library of materials."""
    folder.mkdir()
    colours = [
        f"newmtl {name}\nKd {' '.join(map(str, colour[:3]))}\n" for name, colour in COLOURS.items()
    ]
    (folder / "hero.mtl").write_text("\n".join(colours))
    _, frames = make_character()
    for k, frame in enumerate(frames):
        lines, first, first_uv = ["mtllib hero.mtl"], 0, 0
        for name, mesh in zip(NAMES, make_parts(), strict=True):
            given = mesh.attributes
            lines.append(f"o {name.rpartition('/')[2]}")
            own = frame[first : first + len(mesh.vertices)]
            lines += ["v {!r} {!r} {!r}".format(*point) for point in own.tolist()]
            lines += ["vt {!r} {!r}".format(*uv) for uv in given.uvs.values.tolist()]
            lines.append(f"usemtl {given.materials.names[0]}")
            pairs = np.stack([given.corners + first, given.uvs.indices + first_uv], axis=1) + 1
            for ring in np.split(pairs, np.cumsum(given.corner_counts)[:-1]):
                lines.append("f " + " ".join(f"{v}/{t}" for v, t in ring.tolist()))
            first, first_uv = first + len(mesh.vertices), first_uv + len(given.uvs.values)
        (folder / f"hero_{k + 1:04}.obj").write_text("\n".join(lines) + "\n")
    return folder


WRITERS = {
    "usd": lambda folder: write_usd(folder / "hero.usdc"),
    "alembic": lambda folder: write_alembic(folder / "hero.abc"),
    "gltf": lambda folder: write_gltf(folder / "hero.glb"),
    "obj": lambda folder: write_obj(folder / "frames"),
}


# --- files read by other libraries


def read_usd(path):
    stage = Usd.Stage.Open(str(path))
    times = np.arange(stage.GetStartTimeCode(), stage.GetEndTimeCode() + 1)
    found = []
    for prim in stage.Traverse():
        if not prim.IsA(UsdGeom.Mesh):
            continue
        mesh = UsdGeom.Mesh(prim)
        corners = np.array(mesh.GetFaceVertexIndicesAttr().Get())
        path = str(prim.GetPath())
        frames = np.array([mesh.GetPointsAttr().Get(time) for time in times], float)
        matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(1.0))
        found.append(Found(path, frames, matrix))
        primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("st")
        if not primvar.HasValue():
            continue
        uvs = np.array(primvar.ComputeFlattened())
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
        if not material:  # of faces
            (subset,) = UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets()
            material, _ = UsdShade.MaterialBindingAPI(subset).ComputeBoundMaterial()
        shader = material.ComputeSurfaceSource()[0]
        colour = shader.GetInput("diffuseColor").Get() if shader else ()
        found[-1].uvs = np.column_stack([corners, uvs])
        found[-1].material = (material.GetPrim().GetName(), tuple(map(float, colour)))
    return found


def read_alembic(path):
    archive, found = IArchive(str(path)), []

    def visit(above, place, matrix):
        for k in range(above.getNumChildren()):
            header = above.getChildHeader(k)
            name = header.getName()
            if IXform.matches(header):
                child = IXform(above, name)
                local = np.eye(4)
                if child.getSchema().getNumOps():
                    value = child.getSchema().getValue().getMatrix()
                    local = np.array([[value[i][j] for j in range(4)] for i in range(4)])
                visit(child, f"{place}/{name}", local @ matrix)
            elif IPolyMesh.matches(header):
                found.append(_read_alembic_mesh(IPolyMesh(above, name), f"{place}/{name}", matrix))

    visit(archive.getTop(), "", np.eye(4))
    return found


def _read_alembic_mesh(mesh, path, matrix):
    schema = mesh.getSchema()
    positions = schema.getPositionsProperty()
    frames = np.array([np.array(positions.getValue(k)) for k in range(len(positions.samples))])
    corners = np.array(schema.getFaceIndicesProperty().getValue(0))
    if not schema.getUVsParam():
        return Found(path, frames, matrix)
    uvs = np.array(schema.getUVsParam().getExpandedValue().getVals())
    (material,) = schema.getFaceSetNames()
    return Found(path, frames, matrix, np.column_stack([corners, uvs]), (material, ()))


def read_gltf(path):
    """By the structure that pygltflib reads, and the accessors themselves."""
    file = GLTF2().load(str(path))
    blob = file.binary_blob()

    def array(number):
        accessor = file.accessors[number]
        view, width = file.bufferViews[accessor.bufferView], WIDTHS[accessor.type]
        start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
        kind = KINDS[accessor.componentType]
        return np.frombuffer(blob, kind, accessor.count * width, start).reshape(-1, width)

    weights = {}
    for channel in file.animations[0].channels:
        sampler = file.animations[0].samplers[channel.sampler]
        values = array(sampler.output)[:, 0]
        weights[channel.target.node] = values.reshape(len(array(sampler.input)), -1)
    found = []

    def visit(number, place, matrix):
        node = file.nodes[number]
        own = np.array(node.matrix).reshape(4, 4) if node.matrix else _make_node_matrix(node)
        matrix, place = own @ matrix, f"{place}/{node.name}"
        if node.mesh is not None:
            found.append(read_mesh(number, place, matrix))
        for child in node.children or ():
            visit(child, place, matrix)

    def read_mesh(number, place, matrix):
        frames, uvs, materials, start = [], [], [], 0
        for primitive in file.meshes[file.nodes[number].mesh].primitives:
            base = array(primitive.attributes.POSITION).astype(float)
            targets = np.array([array(target["POSITION"]) for target in primitive.targets])
            frames.append(base + np.einsum("ft,tmx->fmx", weights[number], targets))
            if primitive.attributes.TEXCOORD_0 is None:
                return Found(place, frames[0], matrix)
            own = array(primitive.attributes.TEXCOORD_0).astype(float)
            uvs.append(np.column_stack([np.arange(len(own)) + start, own[:, 0], 1 - own[:, 1]]))
            materials.append(file.materials[primitive.material])
            start += len(base)
        (material,) = materials
        colour = tuple(material.pbrMetallicRoughness.baseColorFactor[:3])
        frames = np.concatenate(frames, axis=1)
        return Found(place, frames, matrix, np.concatenate(uvs), (material.name, colour))

    for top in file.scenes[file.scene].nodes:
        visit(top, "", np.eye(4))
    return found


def _make_node_matrix(node):
    given = {key: getattr(node, key) for key in ("rotation", "scale", "translation")}
    return make_matrix({key: value for key, value in given.items() if value}).T


def read_obj(folder):
    """The objects of each file line by line; trimesh has the vertices and faces of all."""
    files = sorted(folder.glob("*.obj"))
    read = [list(_read_objects(file)) for file in files]
    with warnings.catch_warnings(action="ignore"):  # of trimesh, on vertices of other objects
        whole = trimesh.load(files[0], force="mesh", process=False, maintain_order=True)
    points = np.concatenate([points for _, points, _, _ in read[0]])
    np.testing.assert_array_equal(np.unique(whole.vertices, axis=0), np.unique(points, axis=0))
    return [
        Found(name, np.array([one[k][1] for one in read]), np.eye(4), uvs, material)
        for k, (name, _, uvs, material) in enumerate(read[0])
    ]


def _read_objects(file):
    """The name, the vertices, the rows of Found.uvs and the material of each object."""
    points, coordinates, objects, material = [], [], [], ""
    for word, *rest in map(str.split, file.read_text().splitlines()):
        if word == "o":
            objects.append((rest[0], [], set()))
        elif word == "v":
            points.append([float(text) for text in rest[:3]])
        elif word == "vt":
            coordinates.append([float(text) for text in rest[:2]])
        elif word == "usemtl":
            material = rest[0]  # also of objects after this one
        elif word == "f":
            objects[-1][2].add(material)
            objects[-1][1].extend(corner.split("/") for corner in rest)
    for name, corners, materials in objects:
        numbers = np.array([int(corner[0]) for corner in corners]) - 1
        used, places = np.unique(numbers, return_inverse=True)
        uvs = [coordinates[int(corner[1]) - 1] for corner in corners if len(corner) > 1]
        rows = np.column_stack([places, uvs]) if uvs else None
        yield name, np.array(points)[used], rows, (*materials, ())


def read_pc2(path, counts):
    """The vertices of one cache as those of parts with these counts."""
    data = path.read_bytes()
    _, _, vertices, _, _, frames = struct.unpack("<12siiffi", data[:32])
    assert vertices == sum(counts)
    rows = np.frombuffer(data, "<f4", offset=32).reshape(frames, vertices, 3)
    parts = np.split(rows.astype(float), np.cumsum(counts)[:-1], axis=1)
    return [Found("", part, np.eye(4)) for part in parts]
