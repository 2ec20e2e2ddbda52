"""A character of four parts that moves: body, jacket, two eyes; and how formats are read back."""

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from cageik_cli.geometry.attributes import FaceLabels, SurfaceAttributes, UvMap
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import join_meshes

FRAMES = 6
NAMES = ("/hero/geo/body", "/hero/geo/jacket", "/hero/geo/eyes/eye_L", "/hero/geo/eyes/eye_R")
COLOURS = {"skin": (0.9, 0.6, 0.5, 1), "cloth": (0.1, 0.2, 0.7, 1), "white": (1, 1, 1, 1)}


def make_tube(radius, height, rows, columns, bottom=0.0, capped=True):
    """Vertices, quads and UVs of a tube around z, whose ends are closed by one polygon each."""
    angle = 2 * np.pi * np.arange(columns) / columns
    z = np.repeat(bottom + height * np.arange(rows + 1) / rows, columns)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.column_stack([radius * np.tile(ring, (rows + 1, 1)), z])
    k, j = np.meshgrid(np.arange(columns), np.arange(rows))
    k, j = k.ravel(), j.ravel()
    after = (k + 1) % columns
    quads = np.stack([j, j, j + 1, j + 1]).T * columns + np.stack([k, after, after, k]).T
    polygons = quads.tolist()
    if capped:
        polygons += [
            np.arange(columns)[::-1].tolist(),
            (rows * columns + np.arange(columns)).tolist(),
        ]
    corners = np.concatenate(polygons)
    u = np.concatenate([np.stack([k, k + 1, k + 1, k]).T.ravel(), corners[quads.size :] % columns])
    uvs = np.stack([u / columns, (vertices[corners, 2] - bottom) / height], axis=1)
    return vertices, polygons, uvs


def make_part(vertices, polygons, uvs, material):
    """A mesh with UVs at every corner, and one material."""
    counts = np.array([len(polygon) for polygon in polygons])
    values, indices = np.unique(uvs, axis=0, return_inverse=True)
    attributes = SurfaceAttributes(
        corner_counts=counts,
        corners=np.concatenate(polygons),
        uvs=UvMap(values, indices.ravel()),
        materials=FaceLabels((material,), np.zeros(len(counts), np.int64)),
        material_colours=np.array([COLOURS[material]], float),
    )
    fans = [[p[0], p[k], p[k + 1]] for p in polygons for k in range(1, len(p) - 1)]
    return TriMesh(vertices, fans, attributes)


def make_eye(radius=0.12):
    """A small ball."""
    vertices, polygons, uvs = make_tube(1.0, 2.0, 6, 8, bottom=-1.0)
    heights = np.sin(np.pi / 2 * vertices[:, 2] * 0.9)
    shrunk = np.sqrt(1 - heights**2)[:, None]
    ball = radius * np.column_stack([vertices[:, :2] * shrunk, heights])
    return make_part(ball, polygons, uvs, "white")


def make_parts():
    """The meshes of the parts, each in its own space."""
    body = make_part(*make_tube(0.5, 2.0, 12, 16), "skin")
    jacket = make_part(*make_tube(0.56, 0.9, 6, 16, bottom=0.5, capped=False), "cloth")
    return [body, jacket, make_eye(), make_eye()]


def make_transforms():
    """Of the parts at rest: the eyes are moved, turned and scaled."""
    eyes = []
    for side in (-1.0, 1.0):
        matrix = np.eye(4)
        matrix[:3, :3] = 0.8 * np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
        matrix[3, :3] = [0.45, 0.18 * side, 1.7]
        eyes.append(matrix)
    return [np.eye(4), np.eye(4), *eyes]


def bend(points, frame):
    """Bend points (m, 3) about y, the more the higher they are."""
    angle = 0.12 * frame * points[:, 2] / 2
    x, y, z = points.T
    return np.stack(
        [x * np.cos(angle) + 0.4 * z * np.sin(angle), y, z * np.cos(angle) - x * np.sin(angle)],
        axis=1,
    )


def make_character():
    """The model at rest, and its frames (F, m, 3)."""
    parts, transforms = make_parts(), make_transforms()
    placed = [
        part.move(part.vertices @ matrix[:3, :3] + matrix[3, :3])
        for part, matrix in zip(parts, transforms, strict=True)
    ]
    model = join_meshes(placed, NAMES, transforms)
    return model, np.stack([bend(model.vertices, k) for k in range(FRAMES)])


def write_usd(path):
    """Write the character as another program would: eyes below transforms of their own."""
    _, frames = make_character()
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetTimeCodesPerSecond(24)
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/hero").GetPrim())
    for name, colour in COLOURS.items():
        material = UsdShade.Material.Define(stage, f"/hero/materials/{name}")
        shader = UsdShade.Shader.Define(stage, f"/hero/materials/{name}/surface")
        shader.CreateIdAttr("UsdPreviewSurface")
        shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*colour[:3]))
        material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    start = 0
    for name, mesh, matrix in zip(NAMES, make_parts(), make_transforms(), strict=True):
        for above in Sdf.Path(name).GetPrefixes()[1:-1]:
            UsdGeom.Xform.Define(stage, above)
        prim, attributes = UsdGeom.Mesh.Define(stage, name), mesh.attributes
        prim.CreateSubdivisionSchemeAttr("none")
        prim.CreateFaceVertexCountsAttr(attributes.corner_counts.tolist())
        prim.CreateFaceVertexIndicesAttr(attributes.corners.tolist())
        uvs = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
            "st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying"
        )
        uvs.Set(Vt.Vec2fArray.FromNumpy(attributes.uvs.values.astype("f4")))
        uvs.SetIndices(attributes.uvs.indices.tolist())
        (material,) = attributes.materials.names
        UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(
            UsdShade.Material(stage.GetPrimAtPath(f"/hero/materials/{material}"))
        )
        if not np.array_equal(matrix, np.eye(4)):
            prim.AddTransformOp().Set(Gf.Matrix4d(matrix))
        stop, inverse = start + len(mesh.vertices), np.linalg.inv(matrix)
        for k, frame in enumerate(frames[:, start:stop] @ inverse[:3, :3] + inverse[3, :3]):
            prim.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(frame.astype("f4")), k + 1)
        start = stop
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(FRAMES)
    stage.GetRootLayer().Save()
    return path


def make_cage(radius=0.8):
    """A prism around the character at rest, of 8 sides; below 0.6 parts are outside."""
    vertices, polygons, _ = make_tube(radius, 2.6, 2, 8, bottom=-0.3)
    fans = [[p[0], p[k], p[k + 1]] for p in polygons for k in range(1, len(p) - 1)]
    return TriMesh(vertices, fans)
