"""Films of a result: which frames they show, from where, what is drawn, and how it is stored."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from cageik_cli.method.weights.binding import Poses, reconstruct_frames
from cageik_cli.report.film import film as film_module
from cageik_cli.report.film.film import (
    GIF_COLOURS,
    Film,
    write_film,
)
from cageik_cli.report.film.settings import (
    DEFAULT_TURN_SECONDS,
    MAX_FILM_RATE,
    MAX_FILM_SECONDS,
    MAX_FILM_SIDE,
    MIN_FILM_SIDE,
    TURN_RATE,
    FilmSettings,
)
from cageik_cli.store.result import read_binding, read_cages, read_rotations
from cageik_cli.util.errors import OutputError, SettingError
from cageik_cli.util.progress import ProgressListener

SMALL = FilmSettings(film_size=(96, 64))


def plan(result, **settings):
    return Film(result, read_binding(result), replace(SMALL, **settings))


def with_rate(result, fps):
    return replace(result, scene=replace(result.scene, fps=fps))


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


@pytest.mark.parametrize("name", ["film.webp", "film.GIF"])
def test_a_film_is_read_back_by_pillow(closed, tmp_path, name):
    told = []

    class Listener(ProgressListener):
        def update(self, done, total):
            told.append((done, total))

    made = write_film(closed.result, tmp_path / name, SMALL, False, Listener())
    assert told == [(k + 1, made.count) for k in range(made.count)]
    with Image.open(tmp_path / name) as image:
        assert (image.n_frames, image.size) == (made.count, (96, 64))
        image.seek(made.count - 1)
        last = np.asarray(image.convert("RGB")).astype(int)
    wanted = made.draw(list(made.shots())[-1])
    assert np.abs(last - wanted).mean() < 8
    write_film(closed.result, tmp_path / f"again{name[4:]}", SMALL, False, ProgressListener())
    assert (tmp_path / f"again{name[4:]}").read_bytes() == (tmp_path / name).read_bytes()


def test_a_film_that_fails_leaves_what_was_there(closed, tmp_path, monkeypatch):
    path = tmp_path / "film.gif"
    path.write_text("old")
    with pytest.raises(OutputError, match="another run has written it"):
        write_film(closed.result, path, SMALL, False, ProgressListener())
    monkeypatch.setattr(Film, "draw", None)
    with pytest.raises(TypeError):
        write_film(closed.result, path, SMALL, True, ProgressListener())
    assert [file.name for file in tmp_path.iterdir()] == ["film.gif"]
    assert path.read_text() == "old"


@pytest.mark.parametrize("name", ["film.webp", "film.gif"])
def test_a_film_plays_for_ever_at_the_times_of_its_plan(make_fitted, tmp_path, name):
    """24 pictures per second are 4 or 5 hundredths in a GIF."""
    result = with_rate(make_fitted(), 24)
    made = write_film(result, tmp_path / name, SMALL, False, ProgressListener())
    with Image.open(tmp_path / name) as image:
        assert image.info["loop"] == 0
        shown = []
        for number in range(image.n_frames):
            image.seek(number)
            image.load()  # a WebP says it then
            shown.append(image.info["duration"])
    parts = 100 if name.endswith("gif") else 1000
    assert shown == (np.diff(made.list_times(parts)) * (1000 // parts)).tolist()


def test_a_film_of_one_picture_is_an_image(closed, tmp_path):
    settings = replace(SMALL, film_seconds=0.1)
    result = with_rate(closed.result, 10)
    for name in ("film.webp", "film.gif"):
        assert write_film(result, tmp_path / name, settings, False, ProgressListener()).count == 1
        with Image.open(tmp_path / name) as image:
            assert (getattr(image, "n_frames", 1), image.size) == (1, (96, 64))


def test_a_gif_has_the_same_colours_in_all_pictures(closed, tmp_path):
    write_film(closed.result, tmp_path / "film.gif", SMALL, False, ProgressListener())
    found = set()
    with Image.open(tmp_path / "film.gif") as image:
        for number in range(image.n_frames):
            image.seek(number)
            found |= {colour for _, colour in image.convert("RGB").getcolors()}
    assert 20 < len(found) <= GIF_COLOURS


def test_a_gif_that_takes_too_much_memory_is_refused(closed, tmp_path, monkeypatch):
    monkeypatch.setattr(film_module, "MAX_GIF_PIXELS", 5 * 96 * 64 - 1)
    with pytest.raises(SettingError, match="5 pictures of 96x64 pixels are too many for a GIF"):
        write_film(closed.result, tmp_path / "film.gif", SMALL, False, ProgressListener())
    assert list(tmp_path.iterdir()) == []
    write_film(closed.result, tmp_path / "film.webp", SMALL, False, ProgressListener())
