"""Paths of meshes in Alembic, and of the parts that they are."""

import numpy as np
import pytest

from cageik_cli.formats.alembic import name_parts, place_meshes
from cageik_cli.formats.open import open_sequence
from cageik_cli.geometry.parts import list_part_names
from tests.formats.character_files import WRITERS, read_alembic, read_usd
from tests.formats.written import write

PAIRS = {
    "pairs": (
        {"/hero/geo/body/bodyShape": 0, "/hero/eye/eyeShape": 1},
        ["/hero/geo/body", "/hero/eye"],
    ),
    "moved at the top": ({"/body/bodyShape": 0}, ["/body"]),
    "below each other": ({"/a/b/bShape": 1, "/a/b/c/cShape": 1}, ["/a/b", "/a/b/c"]),
    "Blender": ({"/hero/geo/hat/hat": 1}, ["/hero/geo/hat/hat"]),
    "several below one": ({"/geo/geoShape": 1, "/geo/other": 1}, ["/geo", "/geo/other"]),
    "still at the top": ({"/body/bodyShape": 1}, ["/body/bodyShape"]),
    "below a name that is its own": ({"/body/body_1/body_1Shape": 1}, ["/body/body_1/body_1Shape"]),
    "twice": ({"/a/b": 1, "/a/b/bShape": 1}, ["/a/b", "/a/b/bShape"]),
}
"""Paths of meshes with whether they are still, and the first of their parts."""


@pytest.mark.parametrize("case", list(PAIRS))
def test_a_pair_of_names_is_one_part_if_it_is_written_as_that_pair(case):
    meshes, parts = PAIRS[case]
    assert name_parts(list(meshes), list(meshes.values()))[: len(parts)] == parts


def test_parts_of_any_paths_are_written_where_their_meshes_were():
    """Those of pairs are; what else an archive has may get a transform of its own."""
    rng = np.random.default_rng(1)
    shortened = 0
    for _ in range(500):
        steps = rng.choice(["a", "b", "ab", "aShape", "abShape"], (4, 3))
        meshes = list({"/" + "/".join(each[: rng.integers(1, 4)]) for each in steps})
        are_still = (rng.random(len(meshes)) < 0.5).tolist()
        parts = name_parts(meshes, are_still)
        assert len(set(parts)) == len(parts)
        placed = place_meshes(parts, are_still)
        for mesh, part, place in zip(meshes, parts, placed, strict=True):
            assert part in (mesh, mesh.rpartition("/")[0])
            assert part == mesh or place == mesh
            shortened += part != mesh
    assert shortened > 50


def test_a_part_is_chosen_by_its_path_and_by_that_of_its_mesh(tmp_path):
    file = WRITERS["alembic"](tmp_path)
    for member in ("/hero/geo/jacket", "/hero/geo/jacket/jacketShape"):
        clip = open_sequence([f"{file}::{member}"])
        assert list_part_names(clip.first) == ("/hero/geo/jacket",)


@pytest.mark.parametrize("source", ["usd", "alembic"])
def test_paths_come_back_on_the_way_through_other_formats(tmp_path, source):
    """An archive is written onto the one that it came from, and a stage through an archive, too."""
    first = WRITERS[source](tmp_path)
    read = read_usd if source == "usd" else read_alembic
    path = first
    for k, suffix in enumerate(("usdc", "abc", "glb", "abc", first.suffix[1:])):
        clip = open_sequence([str(path)])
        frames = np.stack([clip.read_positions(k) for k in range(2)])
        path = write(tmp_path / f"{k}.{suffix}", clip.first, frames)
    assert {mesh.path for mesh in read(path)} == {mesh.path for mesh in read(first)}
