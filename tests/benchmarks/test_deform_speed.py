"""Time of `deform --mesh` with weights that carry a fit, against harmonic ones in the same cage.

The walking figure, subdivided three times; seconds of processor time of the whole command, medians
of 3 runs; `make bench`.
"""

import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cageik_cli.formats.open import load_mesh
from tests.conftest import run_in_process

pytestmark = pytest.mark.bench

WALKER = Path(__file__).parents[2] / "data_fixtures/walker"
MAX_RATIO = 2.0
"""Carried weights may take this many times the seconds of harmonic ones."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two results in one cage, harmonic and fitted, and a mesh of 64 times as many triangles."""
    folder = tmp_path_factory.mktemp("deform")
    rest = load_mesh(WALKER / "frames/walker_1.obj").mesh
    points, faces = rest.vertices, rest.faces
    for _ in range(3):
        points, faces = trimesh.remesh.subdivide(points, faces)
    lines = ["v {!r} {!r} {!r}".format(*point) for point in np.asarray(points).tolist()]
    lines += ["f {} {} {}".format(*face) for face in (np.asarray(faces) + 1).tolist()]
    (folder / "fine.obj").write_text("\n".join(lines) + "\n")
    extract = ("extract", WALKER / "frames", "--cage", WALKER / "cage.obj", "-q", "-o")
    for name, words in (("harmonic", ()), ("transferred", ("--fit",))):
        done = run_in_process(*map(str, (*extract, folder / f"{name}.h5", *words)))
        assert done.code == 0, done.err
    return folder


def measure(folder, name, *words):
    """Return the seconds of processor time of one command."""
    out = folder / f"{name}.npz"
    command = ("deform", folder / f"{name}.h5", "--mesh", folder / "fine.obj", "-q", "-o", out)
    start = time.process_time()
    done = run_in_process(*map(str, (*command, "--overwrite", *words)))
    seconds = time.process_time() - start
    assert done.code == 0, done.err
    return seconds


@pytest.mark.parametrize("is_cached", [True, False], ids=["cached", "computed"])
def test_another_mesh_with_transferred_weights(folder, is_cached, monkeypatch):
    monkeypatch.setenv("CAGEIK_CACHE", str(folder / "cache"))
    words = () if is_cached else ("--no-cache",)
    seconds = {}
    for name in ("harmonic", "transferred"):
        measure(folder, name, *words)
        seconds[name] = np.median([measure(folder, name, *words) for _ in range(3)])
    ratio = seconds["transferred"] / seconds["harmonic"]
    with np.load(folder / "transferred.npz") as found:
        frames, count = found["vertices"].shape[:2]
    print(
        f"\n{count} vertices, {frames} frames: harmonic {seconds['harmonic']:.2f} s, "
        f"transferred {seconds['transferred']:.2f} s, ratio {ratio:.2f}",
        end="",
    )
    assert ratio <= MAX_RATIO
