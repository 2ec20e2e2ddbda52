"""Alembic out, read back by alembic3d alone."""

import shutil

import numpy as np
import pytest
from alembic3d.Abc import GetArchiveInfo, IArchive
from alembic3d.AbcGeom import IPolyMesh

from cageik_cli.formats.alembic import Writer
from cageik_cli.formats.base.writers import Animation
from cageik_cli.util.errors import OutputError
from tests.formats.clips import FRAMES, REST, SCENE, written


@pytest.fixture
def schema(tmp_path):
    archive = IArchive(str(written(tmp_path / "clip.abc")))
    return IPolyMesh(archive.getTop(), "hero").getSchema()


def test_every_frame_is_what_was_given_in_single_precision(schema):
    positions = schema.getPositionsProperty()
    assert positions.getNumSamples() == 7
    found = [np.array(positions.getValue(k)) for k in range(7)]
    np.testing.assert_array_equal(found, FRAMES.astype(np.float32))


def test_faces_turn_clockwise(schema):
    assert list(schema.getFaceCountsProperty().getValue(0)) == [3] * 8
    corners = np.array(schema.getFaceIndicesProperty().getValue(0)).reshape(-1, 3)
    a, b, c = FRAMES[0][corners].transpose(1, 0, 2)
    assert np.einsum("fx,fx", a, np.cross(b, c)) < 0  # six times the signed volume
    np.testing.assert_array_equal(corners, REST.faces[:, ::-1])


def test_frame_k_is_at_its_second(schema):
    times = schema.getTimeSampling()
    found = [times.getSampleTime(k) for k in range(7)]
    np.testing.assert_allclose(found, [(11 + k) / 30 for k in range(7)], rtol=1e-14)


def test_the_time_of_writing_is_not_stated(tmp_path):
    archive = IArchive(str(written(tmp_path / "clip.abc")))
    assert GetArchiveInfo(archive)["whenWritten"] == ""


def test_a_disk_without_room_is_refused_before_anything_is_written(tmp_path, monkeypatch):
    # Room for the arrays alone: the library ends the process when it then writes the rest.
    usage = shutil.disk_usage(tmp_path)._replace(free=12 * 6 * 7 + 8192)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage)
    with pytest.raises(OutputError, match=r"a\.abc: cannot be written \(No space left on device\)"):
        written(tmp_path / "a.abc")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_made_is_an_error_of_the_disk(tmp_path):
    (tmp_path / "a.abc").mkdir()
    with pytest.raises(OSError, match="ERROR"):
        Writer(tmp_path / "a.abc", Animation(REST, 1, SCENE, "hero"))
