"""Gaussian splats on the surface of a mesh, in the layout of 3D Gaussian splatting."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh

REST_BY_DEGREE = {0: 0, 1: 9, 2: 24, 3: 45}


def splat_names(degree: int = 3, normals: bool = True) -> list[str]:
    return [
        *"xyz",
        *(["nx", "ny", "nz"] if normals else []),
        *(f"f_dc_{k}" for k in range(3)),
        *(f"f_rest_{k}" for k in range(REST_BY_DEGREE[degree])),
        "opacity",
        *(f"scale_{k}" for k in range(3)),
        *(f"rot_{k}" for k in range(4)),
    ]


def make_splat_rows(mesh: TriMesh, count: int, degree: int = 3, seed: int = 0) -> np.ndarray:
    """Flat splats along the faces; colours by position, with a tint that depends on direction."""
    random = np.random.default_rng(seed)
    corner = mesh.vertices[mesh.faces]
    sides = corner[:, 1:] - corner[:, :1]
    area_vectors = np.cross(sides[:, 0], sides[:, 1])
    areas = np.linalg.norm(area_vectors, axis=1)
    face = random.choice(len(areas), count, p=areas / areas.sum())
    shares = random.dirichlet(np.ones(3), count)
    places = np.einsum("ik,ikx->ix", shares, corner[face])
    normal = area_vectors[face] / areas[face, None]
    along = sides[face, 0] / np.linalg.norm(sides[face, 0], axis=1, keepdims=True)
    frames = np.stack([along, np.cross(normal, along), normal], axis=2)
    rows = np.zeros(count, [(name, "<f4") for name in splat_names(degree)])
    for name, values in zip("xyz", places.T, strict=True):
        rows[name] = values
    size = np.sqrt(areas.sum() / 2 / count)
    for k, stretch in enumerate((1.2, 0.6, 0.1)):
        rows[f"scale_{k}"] = np.log(size * stretch * random.uniform(0.8, 1.25, count))
    turns = matrix_quaternions(frames) * random.uniform(0.5, 2, (count, 1))
    for k in range(4):
        rows[f"rot_{k}"] = turns[:, k]
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    shade = 0.15 + 0.7 * (places - low) / (high - low)
    for k in range(3):
        rows[f"f_dc_{k}"] = (shade[:, k] - 0.5) / 0.28209479177387814
    for k in range(REST_BY_DEGREE[degree]):
        rows[f"f_rest_{k}"] = 0.05 * random.standard_normal(count)
    rows["opacity"] = random.uniform(1, 4, count)
    return rows


def matrix_quaternions(matrices: np.ndarray) -> np.ndarray:
    """Quaternions w, x, y, z, (m, 4), of rotations (m, 3, 3), by SciPy."""
    from scipy.spatial.transform import Rotation

    return np.roll(Rotation.from_matrix(matrices).as_quat(), 1, axis=1)


def covariances(rows: np.ndarray) -> np.ndarray:
    """The covariances of splats, (m, 3, 3), by SciPy."""
    from scipy.spatial.transform import Rotation

    turns = np.stack([rows[f"rot_{k}"].astype(np.float64) for k in range(4)], axis=1)
    frames = Rotation.from_quat(np.roll(turns, -1, axis=1)).as_matrix()
    logs = np.stack([rows[f"scale_{k}"].astype(np.float64) for k in range(3)], axis=1)
    frames *= np.exp(logs)[:, None]
    return frames @ frames.swapaxes(1, 2)


def encode_rows(rows: np.ndarray, text: bool = False, extra: bytes = b"") -> bytes:
    """A PLY file of rows, without faces."""
    kinds = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int", "i2": "short"}
    order = "ascii" if text else "binary_little_endian"
    lines = ["ply", f"format {order} 1.0", f"element vertex {len(rows)}"]
    lines += [f"property {kinds[rows.dtype[name].str[1:]]} {name}" for name in rows.dtype.names]
    head = "\n".join(lines).encode() + b"\n" + extra + b"end_header\n"
    if not text:
        return head + rows.tobytes()
    return head + b"".join(
        " ".join(repr(value.item()) for value in row).encode() + b"\n" for row in rows
    )
