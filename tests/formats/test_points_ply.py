import numpy as np
import pytest
import trimesh

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.ply import Reader
from cageik_cli.formats.ply_points import (
    MAX_LOG_SCALE,
    PointFile,
    PointWriter,
    holds_splats,
    parse_points,
    place_positions,
    place_splats,
    read_splats,
)
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.points import PointCloud
from cageik_cli.method.points.oriented import move_splats
from cageik_cli.util.errors import FormatError, OutputError
from tests.formats.test_fuzz_readers import damaged
from tests.refusals import refused
from tests.shapes import ball
from tests.splats import covariances, encode_rows, make_splat_rows, splat_names

KIND = [("x", "<f4"), ("red", "u1"), ("y", "<f8"), ("z", "<f4"), ("label", "<i2"), ("nx", "<f4")]


def make_rows(count=7):
    random = np.random.default_rng(0)
    rows = np.zeros(count, KIND)
    for name in "xyz":
        rows[name] = random.normal(size=count)
    rows["red"], rows["label"], rows["nx"] = random.integers(0, 200, count), -5, 0.25
    return rows


@pytest.mark.parametrize("text", [False, True])
def test_all_properties_come_back(text):
    rows = make_rows()
    points = parse_points(encode_rows(rows, text))
    np.testing.assert_array_equal(points.rows, rows)
    expected = np.stack([rows[name] for name in "xyz"], axis=1)
    np.testing.assert_array_equal(points.positions, expected)
    assert points.encode(points.rows) == encode_rows(rows)


def test_big_endian_files_stay_so():
    rows = make_rows().astype([(name, kind.replace("<", ">")) for name, kind in KIND])
    data = encode_rows(make_rows()).replace(b"little", b"big").split(b"end_header\n")[0]
    data += b"end_header\n" + rows.tobytes()
    points = parse_points(data)
    np.testing.assert_array_equal(points.rows["label"], -5)
    assert points.encode(points.rows) == data


def test_what_follows_the_points_of_a_binary_file_is_kept():
    camera = b"element camera 2\nproperty float view\n"
    data = encode_rows(make_rows(), extra=camera) + np.ones(2, "<f4").tobytes()
    points = parse_points(data)
    assert points.encode(points.rows) == data


def test_a_frame_differs_in_its_positions_alone(tmp_path):
    rows = make_rows()
    points = parse_points(encode_rows(rows))
    cloud = PointCloud.from_points(points.positions)
    animation = Animation(cloud, 2, Scene(start=1), "cloud")
    writer = PointWriter(tmp_path / "p_##.ply", animation, points)
    writer.append(np.stack([points.positions, points.positions + 1]))
    writer.complete()
    assert (tmp_path / "p_01.ply").read_bytes() == encode_rows(rows)
    moved = parse_points((tmp_path / "p_02.ply").read_bytes()).rows
    for name, _ in KIND:
        shift = 1 if name in "xyz" else 0
        np.testing.assert_allclose(moved[name], rows[name] + shift, rtol=0, atol=1e-6)


def test_other_programs_read_what_is_written(tmp_path):
    rows = make_rows()
    points = parse_points(encode_rows(rows, text=True))
    (tmp_path / "p.ply").write_bytes(points.encode(points.rows))
    loaded = trimesh.load(tmp_path / "p.ply")
    np.testing.assert_allclose(loaded.vertices, points.positions, rtol=0, atol=1e-12)


def test_meshes_and_other_files_are_left_to_their_readers():
    assert parse_points(ball(1).vertices.tobytes()) is None
    mesh = trimesh.Trimesh(ball(1).vertices, ball(1).faces, process=False)
    assert parse_points(mesh.export(file_type="ply")) is None
    assert parse_points(b"ply\nformat binary_little_endian 1.0\nelement vertex many\n") is None
    assert parse_points(b"ply\nformat binary_middle_endian 1.0\nend_header\n") is None


def replace_in(old, new, text=False):
    data = encode_rows(make_rows(), text)
    assert old in data
    return data.replace(old, new, 1)


FAULTS = {
    "too few bytes": (encode_rows(make_rows())[:-1], "announces 7 points of at least 23 bytes"),
    "absurd count": (replace_in(b"vertex 7", b"vertex 99999999999"), "99 999 999 999 points"),
    "absurd count of a text": (replace_in(b"vertex 7", b"vertex 99999999999", True), "cut short"),
    "no points": (replace_in(b"vertex 7", b"vertex 0"), "has no points"),
    "no z": (replace_in(b"double y", b"double why"), "no property `y`"),
    "whole y": (replace_in(b"double y", b"int64 y"), "`y` is a whole number"),
    "a list": (replace_in(b"uchar red", b"list uchar int red"), "a list"),
    "chunks first": (
        replace_in(b"element vertex", b"element chunk 0\nproperty float min_x\nelement vertex"),
        "`chunk` before its points",
    ),
    "strange name": (replace_in(b"uchar red", "uchar größe".encode()), "not plain text"),
    "text too short": (encode_rows(make_rows(), True)[:-60], "not rows of 6 numbers"),
    "text with a row too few": (replace_in(b"vertex 7", b"vertex 8", True), "holds 7"),
    "text too long": (encode_rows(make_rows(), True) + b"1 2 3 4 5 6\n", "holds more"),
    "text with words": (replace_in(b"0.25", b"none", True), "not a sound PLY"),
    "text with others": (
        encode_rows(make_rows(), True, b"element camera 1\nproperty float view\n") + b"1\n",
        "has `camera` besides",
    ),
}


@pytest.mark.parametrize(("data", "says"), FAULTS.values(), ids=FAULTS)
def test_faults_are_named(data, says):
    with refused(FormatError, says):
        parse_points(data) or Reader.parse(data)


def test_a_position_too_large_for_its_property_is_refused():
    points = parse_points(encode_rows(make_rows()))
    rows = points.rows.copy()
    place_positions(rows, np.full((7, 3), 1e39))
    assert rows["y"][0] == 1e39, "it is a double"
    with pytest.raises(OutputError, match="`x` is too large for its type, float32"):
        points.encode(rows)


def test_splats_are_known_by_their_properties():
    splats = parse_points(encode_rows(make_splat_rows(ball(1), 20)))
    assert holds_splats(splats)
    assert not holds_splats(parse_points(encode_rows(make_rows())))


@pytest.mark.parametrize("degree", range(4))
def test_splats_at_rest_come_back(degree):
    rows = make_splat_rows(ball(1), 20, degree)
    splats = read_splats(parse_points(encode_rows(rows)))
    assert splats.harmonics.shape == (3, (degree + 1) ** 2 - 1, 20)
    out = rows.copy()
    place_splats(out, splats)
    for name in rows.dtype.names:
        if not name.startswith("rot_"):  # their length is not kept
            np.testing.assert_allclose(out[name], rows[name], rtol=2e-7)
    np.testing.assert_allclose(covariances(out), covariances(rows), rtol=0, atol=1e-7)


def test_the_coefficients_of_a_colour_are_together():
    rows = make_splat_rows(ball(1), 20, 2)
    splats = read_splats(parse_points(encode_rows(rows)))
    np.testing.assert_array_equal(splats.harmonics[1, 3], rows["f_rest_11"])


def change(name, value, kind="<f4"):
    rows = make_splat_rows(ball(1), 20)
    rows = rows.astype([(each, kind) for each in rows.dtype.names])
    for each in name if isinstance(name, list) else [name]:
        rows[each][4] = value
    return rows


def without(*names):
    rows = make_splat_rows(ball(1), 20)
    return rows[[name for name in rows.dtype.names if name not in names]].astype(
        [(name, "<f4") for name in rows.dtype.names if name not in names]
    )


SPLAT_FAULTS = {
    "nan": (change("f_rest_7", np.nan), "`f_rest_7` of splat 4 (from 0) is nan"),
    "infinite": (change("scale_1", np.inf), "`scale_1` of splat 4 (from 0) is inf"),
    "huge": (change("scale_1", 500), "`scale_1` of splat 4 (from 0) is 500, expected at most 80"),
    "opacity": (change("opacity", np.nan), "`opacity` of splat 4 (from 0) is nan"),
    "constant colour": (change("f_dc_2", -np.inf), "`f_dc_2` of splat 4 (from 0) is -inf"),
    "bright": (change("f_rest_9", 1e38), "`f_rest_9` of splat 4 (from 0) is 1e+38, expected at"),
    "too bright for USD": (
        change("f_dc_1", 1e200, "<f8"),
        "`f_dc_1` of splat 4 (from 0) is 1e+200, expected at most 1e+30",
    ),
    "no turn": (change([f"rot_{k}" for k in range(4)], 0), "`rot_0` of splat 4"),
    "two axes": (without("scale_2"), "without `scale_2`"),
    "no opacity": (without("opacity"), "without `opacity`"),
    "gap": (without("f_rest_3"), "without `f_rest_3`"),
    "odd count": (without("f_rest_44"), "44 properties f_rest_*"),
}


@pytest.mark.parametrize(("rows", "says"), SPLAT_FAULTS.values(), ids=SPLAT_FAULTS)
def test_faults_of_splats_are_named(rows, says):
    with refused(FormatError, says):
        read_splats(parse_points(encode_rows(rows)))


@pytest.mark.parametrize("length", [1e200, 1e-200, 5e-324])
def test_quaternions_of_any_length_are_read(length):
    """Their squares are not numbers."""
    rows = change("rot_0", 0, "<f8")
    expected = read_splats(parse_points(encode_rows(change("rot_0", 1e-9)))).quaternions
    for k, entry in enumerate((1, -1, 0, 1)):
        rows[f"rot_{k}"][4] = length * entry
    found = read_splats(parse_points(encode_rows(rows))).quaternions
    np.testing.assert_allclose(found[:, 4], np.array([1, -1, 0, 1]) / np.sqrt(3), rtol=1e-15)
    others = np.arange(20) != 4
    np.testing.assert_allclose(found[:, others], expected[:, others], rtol=1e-15)


def test_a_coefficient_too_large_for_half_precision_is_refused():
    rows = make_splat_rows(ball(1), 20).astype(
        [(name, "<f2" if name in ("f_rest_1", "nx") else "<f4") for name in splat_names()]
    )
    rows["nx"][2] = np.nan  # what was not finite is kept
    points = PointFile(b"", rows, b"")
    splats, moved = read_splats(points), rows.copy()
    place_splats(moved, splats)
    points.encode(moved)
    splats.harmonics[0, 1, 4] = 1e5
    place_splats(moved, splats)
    with pytest.raises(OutputError, match="`f_rest_1` is too large for its type, float16"):
        points.encode(moved)


@pytest.mark.parametrize("linear", [np.zeros((3, 3)), np.full((3, 3), 1e-300), -1e-36 * np.eye(3)])
def test_splats_without_extent_are_read_again(linear):
    """Their logarithms are finite, and no smaller than a file may hold."""
    rows = make_splat_rows(ball(1), 20, 0)
    rows = rows.astype([(name, "<f8") for name in rows.dtype.names])
    splats = read_splats(parse_points(encode_rows(rows)))
    moved = move_splats(splats, np.repeat(linear[:, :, None], 20, axis=2))
    place_splats(rows, moved)
    found = read_splats(parse_points(encode_rows(rows)))
    np.testing.assert_allclose(found.axes, np.exp(-MAX_LOG_SCALE), rtol=1e-12)


@pytest.mark.parametrize("kind", ["cloud", "text", "splats"])
def test_damaged_files_are_read_or_refused(kind):
    """Sound points or a sentence, whatever is wrong."""
    rows = make_splat_rows(ball(1), 20) if kind == "splats" else make_rows()
    sound = encode_rows(rows, text=kind == "text")
    random = np.random.default_rng(3)
    outcomes = set()
    for _ in range(400):
        try:
            points = parse_points(bytes(damaged(sound, random)))
            if points is not None:
                PointCloud.from_points(points.positions)
                if holds_splats(points):
                    read_splats(points)
        except FormatError:
            outcomes.add("refused")
        else:
            outcomes.add("read" if points is not None else "left")
    assert "refused" in outcomes
    assert "read" in outcomes
