"""The pictures of a film: which frames they show, from where, and what is drawn."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.method.weights.binding import Poses, reconstruct_frames
from cageik_cli.report.film import film as film_module
from cageik_cli.report.film.film import Film
from cageik_cli.report.film.settings import (
    DEFAULT_TURN_SECONDS,
    HALF_VIEW,
    MAX_FILM_RATE,
    MAX_FILM_SECONDS,
    MAX_FILM_SIDE,
    MIN_FILM_SIDE,
    TURN_RATE,
    FilmSettings,
    FilmView,
)
from cageik_cli.store.result import read_binding, read_cages, read_rotations
from cageik_cli.util.errors import SettingError
from tests.report.film.films import SMALL, with_rate


def plan(result, **settings):
    return Film(result, read_binding(result), replace(SMALL, **settings))


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"film_size": (MIN_FILM_SIDE - 1, 480)}, "film_size=63x480"),
        ({"film_size": (640, MAX_FILM_SIDE + 1)}, "film_size=640x1921"),
        ({"film_seconds": 0.0}, "film_seconds=0"),
        ({"film_seconds": -3.0}, "film_seconds=-3"),
        ({"film_seconds": MAX_FILM_SECONDS + 1}, "film_seconds=121"),
        ({"film_seconds": float("nan")}, "film_seconds=nan"),
        ({"film_seconds": float("inf")}, "film_seconds=inf"),
        ({"film_turntable": True, "film_follow": True}, "film_follow=True"),
        ({"film_view": ""}, "film_view=`: is no view"),
        ({"film_view": "32"}, "film_view=32`: is no view"),
        ({"film_view": "32,14,3"}, "film_view=32,14,3`: is no view"),
        ({"film_view": "32,14,follow"}, "film_view=32,14,follow`: is no view"),
        ({"film_view": "nan,14"}, "film_view=nan,14`: is no view"),
        ({"film_view": "361,14"}, "the turn 361 is out of range .expected -360 to 360"),
        ({"film_view": "32,-91"}, "the tilt -91 is out of range"),
        ({"film_view": "32,14,0,0,0,0"}, "the distance 0 is out of range .expected 0.02 to 50"),
        ({"film_view": "32,14,1e999,0,0,0"}, "the distance inf is out of range"),
        ({"film_view": "32,14,3,0,-1e5,0"}, "the coordinate -100000 is out of range"),
    ],
)
def test_settings_out_of_range_are_refused(settings, named):
    with pytest.raises(SettingError, match=named):
        FilmSettings(**settings)


def test_settings_at_the_ends_of_their_ranges_pass():
    settings = FilmSettings((MIN_FILM_SIDE, MAX_FILM_SIDE), MAX_FILM_SECONDS)
    assert (*settings.film_size, settings.film_seconds) == (
        MIN_FILM_SIDE,
        MAX_FILM_SIDE,
        MAX_FILM_SECONDS,
    )


def test_a_film_shows_the_frames_of_deform(closed):
    result = closed.result
    cages = np.concatenate(list(read_cages(result, 100)))
    meshes = reconstruct_frames(read_binding(result), Poses(cages, read_rotations(result)))
    found = list(plan(result).shots())
    np.testing.assert_allclose([shot.mesh for shot in found], meshes, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal([shot.cage for shot in found], cages)
    timeline = result.scene.make_timeline(len(cages))
    assert found[-1].label == f"frame {timeline.number_frame(len(cages) - 1)}"


def test_fitted_offsets_are_turned(make_fitted, monkeypatch):
    """In blocks of one frame, too, and of every second one."""
    result = with_rate(make_fitted(influences=4), 2 * MAX_FILM_RATE)
    binding, cages = read_binding(result), np.concatenate(list(read_cages(result, 100)))
    meshes = reconstruct_frames(binding, Poses(cages, read_rotations(result)))[::2]
    for memory in (1, 1 << 30):
        monkeypatch.setattr(film_module, "MAX_SHOT_BYTES", memory)
        found = [shot.mesh for shot in plan(result).shots()]
        np.testing.assert_allclose(found, meshes, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("fps", "seconds", "count", "rate"),
    [(24, None, 12, 24), (25, 0.2, 5, 25), (60, None, 6, 30), (120, None, 3, 30),
     (31, 0.2, 3, 15.5), (24, 100.0, 12, 24), (1000, 0.1, 1, 1000 / 34)],
)  # fmt: skip
def test_a_film_plays_at_the_speed_of_the_clip(make_fitted, fps, seconds, count, rate):
    made = plan(with_rate(make_fitted(), fps), film_seconds=seconds)
    assert (made.count, made.rate) == (count, pytest.approx(rate))
    assert len(list(made.shots())) == count
    times = made.list_times(100)
    assert len(times) == count + 1
    assert times[-1] == round(100 * made.seconds)


def test_times_in_hundredths_do_not_drift(make_fitted):
    """24 pictures per second are 4, 4, 4, 5, 4, 4, ... hundredths."""
    times = plan(with_rate(make_fitted(), 24)).list_times(100)
    assert sorted(set(np.diff(times))) == [4, 5]
    assert times[12] == 50


def test_a_clip_that_is_too_long_is_refused_unless_its_start_is_asked_for(make_fitted):
    result = with_rate(make_fitted(), 12 / (MAX_FILM_SECONDS + 1))
    with pytest.raises(SettingError, match="plays 121 s, which is too long"):
        plan(result)
    assert plan(result, film_seconds=MAX_FILM_SECONDS).count == 12


def test_a_turn_goes_once_around(closed):
    made = plan(closed.result, film_turntable=True)
    assert made.count == DEFAULT_TURN_SECONDS * TURN_RATE
    assert plan(closed.result, film_turntable=True, film_seconds=1.0).count == TURN_RATE
    views = np.array([shot.axes[2] for shot in made.shots()])
    steps = np.linalg.norm(np.roll(views, -1, axis=0) - views, axis=1)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    np.testing.assert_allclose(views.mean(axis=0)[[0, 2]], 0, atol=1e-9)


def list_drawn_boxes(result, **settings):
    """Where each picture differs from its ground: left, top, right, bottom."""
    made, boxes = plan(result, **settings), []
    made.fit()
    for shot in made.shots():
        drawn = (made.draw(replace(shot, label="")) < 250).any(axis=2)
        rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
        boxes.append((columns[0], rows[0], columns[-1] + 1, rows[-1] + 1))
    return np.array(boxes)


@pytest.mark.parametrize("size", [(96, 64), (64, 120)])
def test_all_frames_are_in_the_picture_which_they_fill(closed, size):
    boxes = list_drawn_boxes(closed.result, film_size=size)
    low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    assert (low >= 0).all()
    assert (high <= size).all()
    room = np.array(size) - (0, 20)
    assert ((high - low) / room).max() > 0.9


def test_a_camera_that_follows_shows_a_walk_larger(closed, tmp_path):
    """A walk of twenty sizes of the model, along an axis that the camera sees."""
    import h5py

    walk = tmp_path / "walk.h5"
    shutil.copy(closed.result.path, walk)
    with h5py.File(walk, "r+") as file:
        count = len(file["verts"])
        steps = np.linspace(0, 20 * closed.result.rest.diagonal, count)
        file["verts"][...] += steps[:, None, None] * np.array([1.0, 0, 0])
    result = replace(closed.result, path=walk)
    fixed, followed = (list_drawn_boxes(result, film_follow=follows) for follows in (False, True))
    widths = [(boxes[:, 2] - boxes[:, 0]).max() for boxes in (fixed, followed)]
    assert widths[1] > 2 * widths[0]
    middles = [np.ptp(boxes[:, ::2].mean(axis=1)) for boxes in (fixed, followed)]
    assert middles[0] > 40 > 12 > middles[1]


def test_tiles_join_without_a_seam(closed, monkeypatch):
    made = plan(closed.result, film_size=(90, 70))
    shot = next(made.shots())
    made.fit()
    whole = made.draw(shot)
    for side in (30, 37):
        monkeypatch.setattr(film_module, "MAX_TILE_SIDE", side)
        differs = np.abs(made.draw(shot).astype(int) - whole).max(axis=2) > 60
        assert differs.mean() < 0.01  # lines near a surface are before it or behind


@pytest.mark.parametrize(
    ("text", "view"),
    [
        ("-60,30", FilmView(-60, 30)),
        (" 32.5 , -90 ", FilmView(32.5, -90)),
        ("32,14,3.5,0.1,-.2,1e-3", FilmView(32, 14, 3.5, (0.1, -0.2, 1e-3))),
        ("32,14,3.5,0,0,0,Follow", FilmView(32, 14, 3.5, (0, 0, 0), follows=True)),
    ],
)
def test_a_view_is_parsed(text, view):
    assert FilmSettings(film_view=text).view == view


def test_the_usual_view_can_be_named(closed):
    usual, named = plan(closed.result), plan(closed.result, film_view="32,14")
    for made in (usual, named):
        made.fit()
    assert (usual.draw(next(usual.shots())) == named.draw(next(named.shots()))).all()


def test_all_of_the_motion_is_seen_from_any_side(closed):
    boxes = list_drawn_boxes(closed.result, film_view="-115,-40")
    assert (boxes[:, :2] >= 0).all()
    assert (boxes[:, 2:] <= (96, 64)).all()
    assert plan(closed.result, film_view="-115,-40").cut == 0


def make_walk(result, path, steps):
    """Copy a result, whose frames are then moved by so many diagonals along x."""
    import h5py

    shutil.copy(result.path, path)
    with h5py.File(path, "r+") as file:
        moves = np.linspace(0, steps * result.rest.diagonal, len(file["verts"]))
        file["verts"][...] += moves[:, None, None] * np.array([1.0, 0, 0])
    return replace(result, path=path)


def test_a_view_at_a_distance_is_that_of_the_player(closed):
    """What it looks at is in the middle; the edges above and below are 15 degrees away."""
    result, place = closed.result, np.array([0.1, -0.2, 0.05])
    made = plan(result, film_view="40,10,3,0.1,-0.2,0.05")
    made.fit()
    shot = next(made.shots())
    target = made.binding.cage.vertices.mean(axis=0) + result.rest.diagonal * place
    edge = result.rest.diagonal * 3 * np.tan(np.radians(HALF_VIEW)) * shot.axes[1]
    camera = made._place_camera(shot, 0, 0, 1)
    seen = camera.project(np.array([target, target + edge, target - edge]))[:, :2] / 2
    np.testing.assert_allclose(seen, [[48, 32], [48, 0], [48, 64]], rtol=0, atol=1e-9)


def test_a_view_that_follows_goes_with_the_mean_of_the_cage(closed, tmp_path):
    result = make_walk(closed.result, tmp_path / "walk.h5", 4)
    words = "32,14,6,0,0,0"
    fixed, followed = (plan(result, film_view=text) for text in (words, words + ",follow"))
    for made in (fixed, followed):
        made.fit()
    assert fixed.cut >= followed.count // 2
    assert followed.cut == 0
    centres = np.array([shot.centre for shot in followed.shots()])
    means = np.array([shot.cage.mean(axis=0) for shot in followed.shots()])
    np.testing.assert_allclose(centres, means, rtol=1e-12, atol=1e-12)
    follows = plan(result, film_view=words, film_follow=True)
    follows.fit()
    assert [shot.centre.tolist() for shot in follows.shots()] == centres.tolist()


def test_a_turn_begins_at_the_view(closed):
    made = plan(closed.result, film_turntable=True, film_view="90,0")
    first = next(made.shots())
    np.testing.assert_allclose(first.axes, [[0, 0, -1], [0, 1, 0], [1, 0, 0]], rtol=0, atol=1e-12)
    placed = plan(closed.result, film_turntable=True, film_view="90,0,3,0,0.5,0")
    middle = placed.binding.cage.vertices.mean(axis=0)
    lifted = middle + 0.5 * closed.result.rest.diagonal * np.array([0.0, 1, 0])
    np.testing.assert_allclose(next(placed.shots()).centre, lifted)


def test_tiles_of_a_perspective_join(closed, monkeypatch):
    made = plan(closed.result, film_size=(90, 70), film_view="32,14,2,0,0,0", film_no_cage=True)
    shot = next(made.shots())
    made.fit()
    whole = made.draw(shot)
    assert (whole < 200).any()
    monkeypatch.setattr(film_module, "MAX_TILE_SIDE", 30)
    differs = np.abs(made.draw(shot).astype(int) - whole).max(axis=2) > 4
    assert differs.mean() < 0.01


def test_without_its_cage_a_model_fills_the_picture(closed):
    with_cage, alone = (
        plan(closed.result, film_no_cage=is_left_out) for is_left_out in (False, True)
    )
    pictures = []
    for made in (with_cage, alone):
        made.fit()
        pictures.append(made.draw(next(made.shots())).astype(int))
    blue = [int((picture[..., 2] > picture[..., 0] + 40).sum()) for picture in pictures]
    assert blue[0] > 50 > blue[1] == 0
    assert alone._unit < with_cage._unit
