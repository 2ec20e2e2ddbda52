"""How films are stored: read back by other programs, and what is refused."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cageik_cli.report.film import write as write_module
from cageik_cli.report.film.film import GIF_COLOURS, Film
from cageik_cli.report.film.write import check_film_output, write_film
from cageik_cli.util.errors import OutputError, SettingError
from cageik_cli.util.progress import ProgressListener
from tests.report.film.films import SMALL, with_rate

needs_ffmpeg = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="there is no ffmpeg here")


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
    monkeypatch.setattr(write_module, "MAX_GIF_PIXELS", 5 * 96 * 64 - 1)
    with pytest.raises(SettingError, match="5 pictures of 96x64 pixels are too many for a GIF"):
        write_film(closed.result, tmp_path / "film.gif", SMALL, False, ProgressListener())
    assert list(tmp_path.iterdir()) == []
    write_film(closed.result, tmp_path / "film.webp", SMALL, False, ProgressListener())


def test_pictures_are_numbered_from_one(closed, tmp_path):
    path = tmp_path / "frames" / "walk_###.png"
    check_film_output(path, SMALL, False)
    made = write_film(closed.result, path, SMALL, False, ProgressListener())
    names = sorted(file.name for file in path.parent.iterdir())
    assert names == [f"walk_{number:03d}.png" for number in range(1, made.count + 1)]
    shots = list(made.shots())
    for name, shot in ((names[0], shots[0]), (names[-1], shots[-1])):
        with Image.open(path.parent / name) as image:
            np.testing.assert_array_equal(np.asarray(image), made.draw(shot))
    with pytest.raises(OutputError, match="exists already"):
        check_film_output(path, SMALL, False)
    check_film_output(path, SMALL, True)
    (path.parent / "notes.txt").touch()
    with pytest.raises(OutputError, match=r"holds notes\.txt"):
        check_film_output(path, SMALL, True)


def test_one_png_is_refused(tmp_path):
    with pytest.raises(OutputError, match="holds one picture; name files in a folder, such as"):
        check_film_output(tmp_path / "walk.png", SMALL, False)


@pytest.fixture
def fake_ffmpeg(tmp_path, monkeypatch):
    """Put a program `ffmpeg` of some lines on the PATH, which names its output "$last"."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))

    def make(*lines):
        program = folder / "ffmpeg"
        last = 'for last; do :; done; last="${last#file:}"'
        program.write_text("\n".join(["#!/bin/sh", last, *lines]) + "\n")
        program.chmod(0o755)
        return tmp_path / "film.mp4"

    return make


def test_ffmpeg_gets_every_picture(closed, tmp_path, fake_ffmpeg):
    path = fake_ffmpeg(f'echo "$@" > "{tmp_path}/words"', '/bin/cat > "$last"')
    check_film_output(path, SMALL, False)
    made = write_film(
        with_rate(closed.result, 24000 / 1001), path, SMALL, False, ProgressListener()
    )
    pictures = np.frombuffer(path.read_bytes(), np.uint8).reshape(made.count, 64, 96, 3)
    for picture, shot in zip(pictures, made.shots(), strict=True):
        np.testing.assert_array_equal(picture, made.draw(shot))
    words = (tmp_path / "words").read_text()
    assert "-video_size 96x64 -framerate 24000/1001 -i pipe:0" in words
    assert "-c:v libx264" in words


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (['echo "Unknown encoder" >&2', "exit 1"], "ends with exit code 1: Unknown encoder; use"),
        (["/bin/cat > /dev/null", "exit 3"], "ends with exit code 3; use an ffmpeg"),
        (['/bin/cat > "$last"', "kill -9 $$"], "ends with SIGKILL; use an ffmpeg"),
    ],
)
def test_an_ffmpeg_that_fails_leaves_what_was_there(closed, tmp_path, fake_ffmpeg, lines, said):
    path = fake_ffmpeg(*lines)
    path.write_text("old")
    with pytest.raises(OutputError, match=said) as caught:
        write_film(closed.result, path, SMALL, True, ProgressListener())
    assert "encoder libx264" in str(caught.value)
    assert path.read_text() == "old"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["bin", "film.mp4"]


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_without_ffmpeg_a_film_says_what_to_do(tmp_path, monkeypatch, suffix):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SettingError) as caught:
        check_film_output(tmp_path / f"walk{suffix}", SMALL, False)
    assert "is written by the program ffmpeg, which is not on the PATH" in str(caught.value)
    assert str(Path("walk") / "walk_####.png") in str(caught.value)


def test_odd_sides_are_refused_for_mp4_only(tmp_path, fake_ffmpeg):
    path, odd = fake_ffmpeg("exit 0"), replace(SMALL, film_size=(97, 64))
    with pytest.raises(SettingError, match=r"film_size=97x64`: \.mp4 has even sides; choose 98x64"):
        check_film_output(path, odd, False)
    check_film_output(path.with_suffix(".webm"), odd, False)


@needs_ffmpeg
@pytest.mark.parametrize(("name", "codec"), [("walk.mp4", "h264"), ("a:b.webm", "vp9")])
def test_ffmpeg_reads_back_what_it_wrote(closed, tmp_path, name, codec):
    """Frames, size, speed and colours, and the same bytes again."""
    path, result = tmp_path / name, with_rate(closed.result, 10)
    made = write_film(result, path, SMALL, False, ProgressListener())
    asked = "stream=codec_name,width,height,pix_fmt,color_space,r_frame_rate,nb_read_frames"
    words = ["ffprobe", "-v", "error", "-count_frames", "-show_entries", asked, "-of", "csv=p=0"]
    found = subprocess.run([*words, f"file:{path}"], check=True, capture_output=True, text=True)
    assert found.stdout.strip() == f"{codec},96,64,yuv420p,bt709,10/1,{made.count}"
    words = ["ffmpeg", "-v", "error", "-i", f"file:{path}", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    raw = subprocess.run([*words, "-"], check=True, capture_output=True).stdout
    pictures = np.frombuffer(raw, np.uint8).reshape(made.count, 64, 96, 3).astype(int)
    for picture, shot in zip(pictures, made.shots(), strict=True):
        assert np.abs(picture - made.draw(shot)).mean() < 6
    again = path.with_name(f"again{path.suffix}")
    write_film(result, again, SMALL, False, ProgressListener())
    assert again.read_bytes() == path.read_bytes()


def test_what_a_view_cuts_off_is_noted(closed, tmp_path):
    noted = []

    class Listener(ProgressListener):
        def note(self, topic, text):
            noted.append((topic, str(text)))

    for view in ("32,14,0.3,0,0,0", "32,14,9,0,0,0", "32,14"):
        settings = replace(SMALL, film_view=view)
        made = write_film(closed.result, tmp_path / "film.gif", settings, True, Listener())
    assert len(noted) == 1
    assert f"is beyond the edges of {made.count} of {made.count} pictures" in noted[0][1]
