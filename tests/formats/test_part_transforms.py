"""Parts with transforms and paths that are hard to keep: written, and read back by cageik."""

import numpy as np
import pygltflib
import pytest

from cageik_cli.formats.open import open_sequence
from cageik_cli.geometry.parts import join_meshes, list_part_names, split_parts
from tests.formats.written import write
from tests.shapes import box

PLAIN = np.eye(4)
MIRROR = np.diag([-1.0, 1, 1, 1])
TWICE = np.diag([2.0, 2, 2, 1])
STRETCH = np.diag([3.0, 1, 1, 1])
SHEAR = np.eye(4)
SHEAR[0, 1] = 0.5
TURN = np.eye(4)
TURN[:2, :2] = [[0.8, 0.6], [-0.6, 0.8]]
CASES = {
    "mirrored": {"/h/a": PLAIN, "/h/b": MIRROR},
    "sheared": {"/h/a": PLAIN, "/h/b": SHEAR},
    "at the top": {"/a": PLAIN, "/b": TWICE},
    "below each other": {"/h/a": TWICE, "/h/a/b": PLAIN, "/h/a/b/c": STRETCH},
    "stretched in a turned one": {"/h/a": TURN, "/h/a/b": STRETCH @ TURN},
    "sheared by those above": {"/h/a": STRETCH, "/h/a/b": TURN @ STRETCH},
    "sheared below its path": {"/h/a": STRETCH, "/h/a/b": TURN, "/h/a/b/c": TURN},
}
OTHERS = {
    "mirrored": {"/h/b": PLAIN},
    "sheared": {"/h/b": PLAIN},
    "sheared below its path": {"/h/a/b": STRETCH, "/h/a/b/c": STRETCH},
}
"""Transforms that nodes of glTF cannot have: positions are in the space of what is above."""


def make_model(transforms):
    """A box per part, beside each other."""
    meshes = []
    for k, matrix in enumerate(transforms.values()):
        mesh = box() if np.linalg.det(matrix) > 0 else box().flip()
        places = mesh.vertices + np.array([3.0 * k, 0, 0])
        meshes.append(mesh.move(places @ matrix[:3, :3]))
    return join_meshes(meshes, list(transforms), list(transforms.values()))


@pytest.mark.parametrize("suffix", ["usdc", "abc", "glb"])
@pytest.mark.parametrize("case", list(CASES))
def test_places_and_transforms_come_back(tmp_path, case, suffix):
    model = make_model(CASES[case])
    frames = np.stack([model.vertices * (1 + 0.1 * k) for k in range(3)])
    clip = open_sequence([str(write(tmp_path / f"a.{suffix}", model, frames))])
    for k in range(3):
        np.testing.assert_allclose(clip.read_positions(k), frames[k], rtol=0, atol=2e-6)
    assert clip.first.volume == pytest.approx(model.volume, rel=1e-6)  # faces are not turned
    for part, (name, matrix) in zip(split_parts(clip.first), CASES[case].items(), strict=True):
        assert part.name == name
        kept = OTHERS.get(case, {}).get(name, matrix) if suffix == "glb" else matrix
        np.testing.assert_allclose(part.transform, kept, atol=1e-12)


@pytest.mark.parametrize("case", list(CASES))
def test_nodes_of_gltf_are_moved_turned_and_scaled_only(tmp_path, case):
    """As the specification wants it: the axes of each node are at right angles."""
    model = make_model(CASES[case])
    path = write(tmp_path / "a.glb", model, model.vertices[None])
    matrices = [node.matrix for node in pygltflib.GLTF2().load(path).nodes if node.matrix]
    assert matrices or case in ("mirrored", "sheared")
    for matrix in matrices:
        axes = np.reshape(matrix, (4, 4))[:3, :3]
        products = axes @ axes.T
        assert np.abs(products - np.diag(np.diag(products))).max() < 1e-9


@pytest.mark.parametrize("suffix", ["usdc", "abc", "glb", "obj"])
def test_names_that_would_be_one_place_stay_apart(tmp_path, suffix):
    names = ["body", "/body", "/", "a//b", "a/b", "a b", "/ä"]
    model = make_model(dict.fromkeys(names, PLAIN))
    path = tmp_path / ("a_####.obj" if suffix == "obj" else f"a.{suffix}")
    if suffix == "obj":
        path = tmp_path / "out" / path.name
    frames = np.stack([model.vertices, 2 * model.vertices])
    write(path, model, frames)
    clip = open_sequence([str(path.parent if suffix == "obj" else path)])
    assert len(set(list_part_names(clip.first))) == len(names)
    assert len(clip.first.vertices) == len(model.vertices)
    assert clip.first.volume == pytest.approx(model.volume, rel=1e-6)
