"""One mesh out, read back by another program."""

import numpy as np
import pytest
import trimesh

from cageik_cli.formats.write import check_mesh_output, write_mesh
from cageik_cli.util.errors import OutputError
from tests.shapes import ball

MESH = ball(levels=1)
MOVED = 2 * MESH.vertices + 1


@pytest.mark.parametrize("name", ["posed.obj", "posed.ply", "POSED.OBJ"])
def test_trimesh_reads_it(tmp_path, name):
    write_mesh(tmp_path / name, MESH, MOVED, overwrite=False)
    kind = name[-3:].lower()
    read = trimesh.load(tmp_path / name, file_type=kind, process=False, maintain_order=True)
    np.testing.assert_allclose(read.vertices, MOVED, rtol=1e-6, atol=0)
    np.testing.assert_array_equal(read.faces, MESH.faces)
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["posed.npz", "posed.abc", "posed", "posed.fbx"])
def test_files_that_hold_no_single_mesh_are_refused(tmp_path, name):
    with pytest.raises(OutputError, match=rf"{name}: .*expected \.obj, \.ply"):
        check_mesh_output(tmp_path / name, overwrite=False)


def test_what_is_there_is_kept(tmp_path):
    (tmp_path / "posed.obj").write_text("mine")
    for refused in (
        check_mesh_output,
        lambda path, overwrite: write_mesh(path, MESH, MOVED, overwrite),
    ):
        with pytest.raises(OutputError, match="exists already"):
            refused(tmp_path / "posed.obj", overwrite=False)
    assert (tmp_path / "posed.obj").read_text() == "mine"
