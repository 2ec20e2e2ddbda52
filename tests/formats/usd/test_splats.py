import numpy as np
import pytest

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.ply_points import parse_points
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.usd import writer as usd_writer
from cageik_cli.geometry.points import PointCloud
from cageik_cli.util.errors import MissingLibraryError, OutputError
from tests.shapes import ball
from tests.splats import encode_rows, make_splat_rows

pytest.importorskip("pxr")

RADIANCE = "radiance:sphericalHarmonics"


def write(path, degree=2, shift=0.5):
    rows = make_splat_rows(ball(1), 30, degree)
    points = parse_points(encode_rows(rows))
    cloud = PointCloud.from_points(points.positions)
    animation = Animation(cloud, 2, Scene(start=1, fps=24.0), "thing")
    writer = usd_writer.UsdSplatWriter(path, animation, points)
    moved = rows.copy()
    for axis in "xyz":
        moved[axis] += shift
    moved["f_rest_0"] = 7
    try:
        writer.append(np.stack([rows, moved]))
    except BaseException:
        writer.abandon()
        raise
    writer.complete()
    return rows, moved


def open_prim(path):
    from pxr import Usd

    stage = Usd.Stage.Open(str(path))
    return stage, stage.GetPrimAtPath("/thing/thing")


@pytest.mark.parametrize("suffix", [".usdc", ".usda", ".usdz"])
def test_usd_has_what_the_rows_have(tmp_path, suffix):
    rows, moved = write(tmp_path / f"s{suffix}")
    stage, prim = open_prim(tmp_path / f"s{suffix}")
    assert prim.GetTypeName() == "ParticleField3DGaussianSplat"
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1, 2)
    for time, expected in ((1, rows), (2, moved)):

        def read(name, time=time):
            return np.array(prim.GetAttribute(name).Get(time))

        places = np.stack([expected[axis] for axis in "xyz"], axis=1)
        np.testing.assert_array_equal(read("positions"), places)
        scales = np.exp(np.stack([expected[f"scale_{k}"] for k in range(3)], axis=1))
        np.testing.assert_allclose(read("scales"), scales, rtol=1e-6)
        turns = [
            [q.GetReal(), *q.GetImaginary()] for q in prim.GetAttribute("orientations").Get(time)
        ]
        for k in range(4):
            np.testing.assert_array_equal(np.array(turns, np.float32)[:, k], expected[f"rot_{k}"])
        colours = read(f"{RADIANCE}Coefficients").reshape(30, 9, 3)
        np.testing.assert_array_equal(colours[:, 0, 1], expected["f_dc_1"])
        np.testing.assert_array_equal(colours[:, 1, 0], expected["f_rest_0"])
        np.testing.assert_array_equal(colours[:, 8, 2], expected["f_rest_23"])
        low, high = read("extent")
        assert (low < places.min(axis=0)).all()
        assert (high > places.max(axis=0)).all()
    assert prim.GetAttribute(f"{RADIANCE}Degree").Get() == 2
    opacity = 1 / (1 + np.exp(-rows["opacity"]))
    np.testing.assert_allclose(prim.GetAttribute("opacities").Get(), opacity, rtol=1e-6)


def test_constant_colours_are_written_once(tmp_path):
    rows = make_splat_rows(ball(1), 5, 0)
    points = parse_points(encode_rows(rows))
    cloud = PointCloud.from_points(points.positions)
    animation = Animation(cloud, 1, Scene(start=1), "thing")
    writer = usd_writer.UsdSplatWriter(tmp_path / "s.usdc", animation, points)
    writer.append(rows[None])
    writer.complete()
    _, prim = open_prim(tmp_path / "s.usdc")
    attribute = prim.GetAttribute(f"{RADIANCE}Coefficients")
    assert attribute.GetNumTimeSamples() == 0
    assert len(attribute.Get()) == 5


def test_what_does_not_fit_single_precision_is_refused(tmp_path):
    with pytest.raises(OutputError, match="too large"), np.errstate(over="ignore"):
        write(tmp_path / "s.usdc", shift=np.float32(np.inf))


def test_an_old_usd_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(usd_writer, "SPLAT_SCHEMA", "ParticleFieldOfTheFuture")
    with pytest.raises(MissingLibraryError, match=r"usd-core 26\.3 or newer"):
        write(tmp_path / "s.usdc")
