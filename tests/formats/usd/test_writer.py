"""USD out, read back by usd-core alone."""

import zipfile

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from cageik_cli.formats.usd import writer
from cageik_cli.formats.usd.library import USD_SUFFIXES
from cageik_cli.formats.usd.writer import choose_prim_paths
from cageik_cli.util.errors import OutputError
from tests.formats.clips import FRAMES, REST, faults_of, written


@pytest.mark.parametrize("suffix", USD_SUFFIXES)
def test_every_frame_is_what_was_given_in_single_precision(tmp_path, suffix):
    assert faults_of(written(tmp_path / f"clip{suffix}")) == []
    stage = Usd.Stage.Open(str(tmp_path / f"clip{suffix}"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/hero/hero"))
    points = mesh.GetPointsAttr()
    assert points.GetTimeSamples() == [11 + k for k in range(7)]
    for k, frame in enumerate(FRAMES.astype(np.float32)):
        np.testing.assert_array_equal(np.array(points.Get(11 + k)), frame)
        extent = [frame.min(axis=0), frame.max(axis=0)]
        np.testing.assert_array_equal(np.array(mesh.GetExtentAttr().Get(11 + k)), extent)
    assert list(mesh.GetFaceVertexCountsAttr().Get()) == [3] * 8
    np.testing.assert_array_equal(mesh.GetFaceVertexIndicesAttr().Get(), REST.faces.ravel())
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert mesh.GetOrientationAttr().Get() == "rightHanded"
    assert mesh.GetPurposeAttr().Get() == "default"


def test_the_stage_says_what_the_scene_is(tmp_path):
    stage = Usd.Stage.Open(str(written(tmp_path / "clip.usdc")))
    assert stage.GetDefaultPrim().GetPath() == "/hero"
    assert stage.GetDefaultPrim().IsA(UsdGeom.Xform)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (11, 17)
    assert (stage.GetTimeCodesPerSecond(), stage.GetFramesPerSecond()) == (30, 30)
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01


def test_frames_saved_as_they_come_are_all_there(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "MAX_UNSAVED_BYTES", 12 * 6 * 2)
    stage = Usd.Stage.Open(str(written(tmp_path / "clip.usdc")))
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/hero/hero")).GetPointsAttr()
    found = [np.array(points.Get(11 + k)) for k in range(7)]
    np.testing.assert_array_equal(found, FRAMES.astype(np.float32))
    files = {written(tmp_path / f"{k}.usdc", size=k).read_bytes() for k in (1, 4, 7)}
    assert len(files) == 1
    assert len(list(tmp_path.iterdir())) == 4


def test_usd_would_find_one(tmp_path):
    (tmp_path / "a.usda").write_text('#usda 1.0\ndef Mesh "a"\n{\n def Mesh "b"\n {\n }\n}\n')
    assert faults_of(tmp_path / "a.usda") != []


def test_binary_by_the_name_usd_alone(tmp_path):
    assert written(tmp_path / "clip.usd").read_bytes().startswith(b"PXR-USDC")


def test_a_package_is_stored_on_multiples_of_64_bytes(tmp_path):
    path = written(tmp_path / "clip.usdz")
    with zipfile.ZipFile(path) as archive:
        (member,) = archive.infolist()
        assert archive.testzip() is None
    assert member.filename == "hero.usdc"
    assert member.compress_type == zipfile.ZIP_STORED
    data = path.read_bytes()
    assert data.index(b"PXR-USDC") % 64 == 0


@pytest.mark.parametrize(
    ("suffix", "limit", "holds"),
    [(".usda", "MAX_UNSAVED_BYTES", 5), (".usdz", "MAX_USDZ_BYTES", 6)],
)
def test_too_much_for_a_kind_is_refused_before_anything_is_written(
    tmp_path, monkeypatch, suffix, limit, holds
):
    monkeypatch.setattr(writer, limit, holds * 12 * 6 - 1)
    with pytest.raises(OutputError, match=r"MiB of positions.*write \.usdc instead"):
        written(tmp_path / f"clip{suffix}", FRAMES[:holds])
    assert list(tmp_path.iterdir()) == []
    written(tmp_path / f"clip{suffix}", FRAMES[: holds - 1])


def test_names_that_are_alike_in_the_letters_of_usd_are_told_apart():
    paths = ["/root/a_b_2", "/root/a_b_3", "/root/a_b", "/root/a_b_4"]
    assert choose_prim_paths(["a_b_2", "a_b_3", "a_b", "a b"], "root") == paths
