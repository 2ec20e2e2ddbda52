"""A character of four parts, from each format into each, read back by other libraries."""

from functools import cache, partial

import h5py
import numpy as np
import pytest
from scipy.spatial import cKDTree

from cageik_cli.formats.open import load_mesh, open_clip_and_rest, open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.formats.write import Output
from cageik_cli.geometry.parts import list_part_names, split_parts
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.run.deform import deform
from cageik_cli.run.export import export
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import DeformSettings, ExportSettings, ExtractSettings
from tests.character import COLOURS, NAMES, make_cage, make_character, make_parts
from tests.formats.character_files import (
    WRITERS,
    Y_UP,
    read_alembic,
    read_gltf,
    read_obj,
    read_pc2,
    read_usd,
)

COUNTS = tuple(len(part.vertices) for part in make_parts())
MATERIALS = ("skin", "cloth", "white", "white")
SHORT = tuple(name.rpartition("/")[2] for name in NAMES)
PATHS = {
    "usd": NAMES,
    "alembic": NAMES,
    "gltf": NAMES,
    "obj": SHORT,
}
"""The names of parts that come from a format."""

OUTPUTS = {
    "usd": ("hero.usdc", read_usd),
    "alembic": ("hero.abc", read_alembic),
    "gltf": ("hero.glb", read_gltf),
    "obj": ("frames/hero_####.obj", lambda path: read_obj(path.parent)),
    "pc2": ("hero.pc2", partial(read_pc2, counts=COUNTS)),
}
TOL = 1e-6
"""Largest distance, in diagonals: files are in single precision."""


@pytest.mark.parametrize("is_cut", [False, True])
def test_a_rest_pose_of_other_names_keeps_the_parts_of_the_clip(tmp_path, is_cut):
    """An OBJ says neither paths nor transforms; cut into triangles, it has other polygons."""
    clip, model = WRITERS["usd"](tmp_path), truth()[0]
    path = WRITERS["obj"](tmp_path) / "hero_0001.obj"
    if is_cut:
        lines = ["v {!r} {!r} {!r}\nvt 0 0".format(*point) for point in model.vertices.tolist()]
        places = dict(zip(np.cumsum([0, *COUNTS]).tolist(), "abcd", strict=False))
        for face in model.faces.tolist():
            lines += [f"o {places.pop(min(face))}"] if min(face) in places else []
            lines.append("f {0}/{0} {1}/{1} {2}/{2}".format(*(k + 1 for k in face)))
        path.write_text("\n".join(lines))
        assert list_part_names(load_mesh(path).mesh) == ("a", "b", "c", "d")
    _, rest = open_clip_and_rest((str(clip),), ClipSettings(), load_mesh(path), 0)
    parts = rest.mesh.polygons.parts
    assert parts.names == NAMES
    np.testing.assert_allclose(parts.transforms, model.polygons.parts.transforms, atol=1e-6)
    for part, mesh in zip(split_parts(rest.mesh), make_parts(), strict=True):
        assert len(part.mesh.faces) == len(mesh.faces)
        assert part.mesh.polygons.uvs is not None


@pytest.fixture(scope="module", params=list(WRITERS))
def taken(request, tmp_path_factory, write_obj, weights_cache):
    """The format that a character came from, its clip, and the result."""
    folder = tmp_path_factory.mktemp(request.param)
    source = WRITERS[request.param](folder)
    cage = make_cage()
    turn = Y_UP[:3, :3] if request.param == "gltf" else np.eye(3)
    path = write_obj(folder / "cage.obj", cage.vertices @ turn, cage.faces)
    settings = ExtractSettings(
        (str(source),), path, folder / "hero.h5", bind=BindSettings(accuracy="preview"),
        cache=weights_cache,
    )  # fmt: skip
    return request.param, open_sequence([str(source)]), extract(settings)


@cache
def truth():
    return make_character()


def match(name, found):
    """The numbers of the character's vertices of those of a clip, by their rest poses."""
    points = found @ np.linalg.inv(Y_UP[:3, :3]) if name == "gltf" else found
    distances, numbers = cKDTree(truth()[0].vertices).query(points)
    assert distances.max() < 1e-5
    assert len(set(numbers.tolist())) == len(numbers)
    return numbers


def test_a_clip_has_the_parts_of_its_file(taken):
    name, clip, result = taken
    model, frames = truth()
    assert list_part_names(result.rest) == PATHS[name]
    numbers = match(name, result.rest.vertices)
    turn = Y_UP[:3, :3] if name == "gltf" else np.eye(3)
    for k in range(len(clip)):
        found = clip.read_positions(k)
        np.testing.assert_allclose(found, (frames[k] @ turn)[numbers], atol=TOL * model.diagonal)
    wanted = split_parts(model)
    for part, own in zip(split_parts(result.rest), wanted, strict=True):
        assert (numbers[part.vertices] // 1 >= own.vertices.start).all()
        assert len(part.mesh.vertices) == len(own.mesh.vertices)
        matrix = np.eye(4) if name == "obj" else own.transform
        np.testing.assert_allclose(part.transform, matrix @ turn4(name), atol=1e-6)
        found = list_uvs(part.mesh.polygons, numbers[part.vertices] - own.vertices.start)
        assert_same_uvs(found, list_uvs(own.mesh.polygons, np.arange(len(own.mesh.vertices))))


def turn4(name):
    return Y_UP if name == "gltf" else np.eye(4)


def list_uvs(attributes, numbers):
    uvs = attributes.uvs.values[attributes.uvs.indices]
    return np.column_stack([numbers[attributes.corners], uvs])


def assert_same_uvs(found, wanted):
    """Each vertex has the same coordinates at its corners, in whatever order."""
    rows = [np.unique(np.round(each, 5), axis=0) for each in (found, wanted)]
    np.testing.assert_allclose(*rows, atol=2e-5)


def check_character(result, found, *, output, source):
    """Compare meshes of a file with what the weights and the cages of the result give."""
    with h5py.File(result.path) as file:
        meshes = file["weights"][:] @ file["verts"][:]
    turn = Y_UP if output == "gltf" and result.scene.up_axis == "Z" else np.eye(4)
    parts = split_parts(result.rest)
    assert len(found) == len(parts)
    for part, own, name, material in zip(parts, found, PATHS[source], MATERIALS, strict=True):
        wanted = meshes[:, part.vertices] @ turn[:3, :3]
        distances, numbers = cKDTree(wanted[-1]).query(own.placed[-1])
        if output != "gltf":  # which splits vertices
            assert numbers.tolist() == list(range(len(wanted[0])))
        assert set(numbers.tolist()) == set(range(len(wanted[0])))
        distances = np.linalg.norm(own.placed - wanted[:, numbers], axis=2)
        assert distances.max() < TOL * result.rest.diagonal
        if output == "pc2":
            continue
        check_name(own.path, name, output)
        if output != "obj":  # which has none, so that there is none to compare either
            np.testing.assert_allclose(own.matrix, part.transform @ turn, atol=TOL)
        rows = np.column_stack([numbers[own.uvs[:, 0].astype(int)], own.uvs[:, 1:]])
        polygons = part.mesh.polygons
        assert_same_uvs(rows, list_uvs(polygons, np.arange(len(part.mesh.vertices))))
        assert own.material[0] == material
        if source != "alembic" and own.material[1]:  # Alembic has no colours
            np.testing.assert_allclose(own.material[1], COLOURS[material][:3], atol=0.01)


def check_name(found, name, output):
    """Paths are kept; a name alone is below a root in formats of paths."""
    if output == "obj":
        assert found == name.rpartition("/")[2]
    elif name.startswith("/"):
        assert found in (name, f"{name}/{name.rpartition('/')[2]}Shape")
    else:
        assert found.rpartition("/")[2] in (name, f"{name}Shape")


@pytest.mark.parametrize("output", list(OUTPUTS))
def test_what_is_deformed_is_the_same_character(taken, tmp_path, output):
    name, _, result = taken
    (tmp_path / "out").mkdir()
    file, read = OUTPUTS[output]
    path = tmp_path / "out" / file
    deform(DeformSettings(result.path, Output(path)))
    check_character(result, read(path), output=output, source=name)


def test_alembic_has_a_transform_of_the_name_of_each_part(taken, tmp_path):
    """Blender calls objects by the transforms above meshes, which all were `geo`."""
    name, _, result = taken
    deform(DeformSettings(result.path, Output(tmp_path / "hero.abc")))
    found = [mesh.path.split("/") for mesh in read_alembic(tmp_path / "hero.abc")]
    if name == "obj":  # at the top, where nothing moves them
        assert [steps[-1] for steps in found if len(steps) > 2] == []
    else:
        assert [steps[-2] for steps in found] == list(SHORT)


@pytest.mark.parametrize("output", ["usd", "alembic", "gltf", "obj"])
def test_an_export_with_the_model_has_the_cage_beside_its_parts(taken, tmp_path, output):
    name, _, result = taken
    (tmp_path / "out").mkdir()
    file, read = OUTPUTS[output]
    path = tmp_path / "out" / file
    export(ExportSettings((result.path,), Output(path), with_model=True))
    cage, *parts = read(path)
    assert cage.path.removesuffix("Shape").rpartition("/")[2] == "cage"
    check_character(result, parts, output=output, source=name)
