"""A new kind of coordinates is a module and an entry of the table: nothing else knows the kinds."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import cageik_cli
from cageik_cli.cages.bind import bind
from cageik_cli.formats.ply_points import parse_points
from cageik_cli.geometry.points import PointCloud
from cageik_cli.method.points.motion import PointMotion
from cageik_cli.method.points.oriented import Oriented
from cageik_cli.method.weights.binding import Poses
from cageik_cli.method.weights.settings import COORDINATES, BindSettings
from cageik_cli.util.errors import SettingError
from tests.method.weights.moving_least_squares import HERE, KIND, NAME, Field, compute_weights
from tests.shapes import ball, box, concave, inside
from tests.splats import encode_rows, make_splat_rows


@pytest.fixture
def registered(monkeypatch):
    monkeypatch.setitem(COORDINATES, NAME, KIND)


def test_a_kind_that_is_in_no_table_is_refused():
    with pytest.raises(SettingError, match="expected one of harmonic, mean-value"):
        BindSettings(NAME)


@pytest.mark.usefixtures("registered")
def test_a_model_is_bound_with_a_new_kind():
    rest = ball(2, 0.9)
    bound = bind(rest, box(), BindSettings(NAME))
    np.testing.assert_array_equal(bound.weights, compute_weights(box(), rest.vertices).values)
    assert bound.quality.partition_of_unity < 1e-12
    assert bound.quality.linear_precision < 1e-12
    assert repr(bound) == f"<Binding: 66 vertices in a cage of 8, {NAME}>"
    assert bound.notes == ()


@pytest.mark.usefixtures("registered")
def test_normals_turn_by_the_gradients_of_a_new_kind():
    cage, points = concave(), inside(concave(), 50)
    bent = cage.vertices + 0.2 * cage.vertices[:, [1, 2, 0]] ** 2
    given = np.random.default_rng(1).standard_normal((3, 50))
    motion = PointMotion(
        bind(PointCloud.from_points(points), cage, BindSettings(NAME)), Oriented(given), 1 << 20, 1
    )
    (chosen,) = motion.blocks
    places, oriented, _ = motion.move(chosen, Poses(bent[None]))
    field, step = Field(cage, points), 1e-5
    np.testing.assert_allclose(places[0].T, field.evaluate(points) @ bent, rtol=0, atol=1e-12)
    columns = [
        (field.evaluate(points + s) - field.evaluate(points - s)) @ bent / (2 * step)
        for s in step * np.eye(3)
    ]
    expected = np.linalg.solve(np.stack(columns, axis=1), given.T[:, :, None])[:, :, 0]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(oriented[0].normals.T, expected, rtol=0, atol=1e-7)


def test_a_new_kind_goes_the_whole_way(fixtures_folder, tmp_path):
    """Through the command line, whose options are made when it is imported."""
    walker = fixtures_folder / "walker"
    frames = [str(walker / "frames" / f"walker_{k}.obj") for k in (1, 9, 17)]
    rest = cageik_cli.load_mesh(frames[0])
    (tmp_path / "splats.ply").write_bytes(encode_rows(make_splat_rows(rest, 60)))
    cage = ("--cage", str(walker / "cage.obj"))
    commands = [
        ("bind", "--rest", frames[0], *cage, "--coordinates", NAME, "-o", "bound.h5"),
        ("extract", *frames, *cage, "--coordinates", NAME, "-o", "cages.h5"),
        ("extract", *frames, "--binding", "bound.h5", "-o", "again.h5"),
        ("report", "cages.h5", "--html", "page.html"),
        ("deform", "cages.h5", "--mesh", "splats.ply", "-o", "moved"),
    ]
    script = (
        f"import json, sys; from {HERE} import register; register();"
        "from cageik_cli.cli import main\n"
        "for words in json.loads(sys.argv[1]): main(words, standalone_mode=False)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, json.dumps(commands)],
        cwd=tmp_path,
        env={"PYTHONPATH": str(Path(cageik_cli.__file__).parents[1]), "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert KIND.lowest_meaning in (tmp_path / "page.html").read_text()
    first, *_, last = sorted((tmp_path / "moved").iterdir())
    rows = [parse_points(path.read_bytes()).rows for path in (first, last)]
    assert abs(rows[1]["x"] - rows[0]["x"]).max() > 0.01
    assert abs(rows[1]["rot_1"] - rows[0]["rot_1"]).max() > 0.01


def test_no_other_module_asks_for_a_kind_by_its_name():
    """By a comparison, or in a table of its own."""
    folder = Path(cageik_cli.__file__).parent
    names = {"harmonic", "mean-value"}
    texts = {path: path.read_text() for path in sorted(folder.rglob("*.py"))}
    asked = [
        str(path.relative_to(folder))
        for path, text in texts.items()
        if any(f'"{name}"' in text for name in names)  # as the formatter quotes it
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Compare | ast.MatchValue | ast.Dict)
        for part in (node.keys if isinstance(node, ast.Dict) else ast.walk(node))
        if isinstance(part, ast.Constant) and part.value in names
    ]
    assert asked == ["method/weights/settings.py"] * 2
