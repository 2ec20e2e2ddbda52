"""Write a film: GIF and WebP by Pillow, pictures in a folder, MP4 and WebM by the program ffmpeg.

Pictures are drawn one by one. Until the last is there, Pillow keeps a byte per pixel of those of a
GIF, and those of a WebP as they are encoded.

No encoder of films comes with the package: the wheels of PyAV and imageio-ffmpeg hold x264 and
x265, which are under the GPL. An ffmpeg that a user has installed runs as a program of its own.
"""

import shutil
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from cageik_cli.formats.base.file_numbers import FrameNames
from cageik_cli.report.film.film import Film, Pixels
from cageik_cli.report.film.settings import FilmSettings
from cageik_cli.store.result import StoredAnimation, load_binding
from cageik_cli.util.errors import OutputError, SettingError
from cageik_cli.util.messages import Hint, say
from cageik_cli.util.outputs import (
    atomic_file,
    atomic_folder,
    atomic_path,
    check_folder_writable,
    check_writable,
)
from cageik_cli.util.processes import Program, ProgramError
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import single_line
from cageik_cli.util.threads import OrderedMap, count_processors

MAX_GIF_PIXELS = 1 << 30
"""Pixels of all pictures of a GIF, each of which takes a byte of memory."""

WEBP_QUALITY = 75
"""Of the pictures of a WebP, up to 100: the thin lines of a cage stay clean."""

ENCODERS = {
    ".mp4": ("libx264", "-preset medium -crf 18 -movflags +faststart -f mp4"),
    ".webm": ("libvpx-vp9", "-crf 28 -b:v 0 -row-mt 0 -deadline good -cpu-used 2 -f webm"),
}
"""The encoder of ffmpeg for each suffix, and its options. Lines of a cage stay clean."""

Pictures = Iterator[Pixels]


def name_film_output(path: Path) -> Path:
    """Return the file or the folder that a film is written to, by its name.

    Raises
    ------
    OutputError
        When it is the name of one picture.
    """
    if path.suffix.lower() != ".png":
        return path
    if FrameNames.parse(path.name) is None:
        raise OutputError(
            f"{path}: a .png file holds one picture; name files in a folder, such as "
            f"{path.with_suffix('') / f'{path.stem}_####.png'}"
        )
    return path.parent


def check_film_output(path: Path, settings: FilmSettings, overwrite: bool) -> None:
    """Refuse, before any work, a film that cannot be written.

    Raises
    ------
    SettingError
        When there is no ffmpeg for it, or it has a size that MP4 has not.
    OutputError
        When its file or folder cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix in ENCODERS:
        find_encoder(path)
    width, height = settings.film_size
    if suffix == ".mp4" and (width % 2 or height % 2):
        raise SettingError(
            Hint("film_size", f"{width}x{height}") + ": .mp4 has even sides; choose "
            f"{width + width % 2}x{height + height % 2}, or write .webm or .webp"
        )
    output, names = name_film_output(path), FrameNames.parse(path.name)
    if suffix == ".png" and names is not None:
        check_folder_writable(output, overwrite, names.matches)
    else:
        check_writable(output, overwrite)


def find_encoder(path: Path) -> str:
    """Return the path of ffmpeg, which writes `path`.

    Raises
    ------
    SettingError
        When there is none.
    """
    program = shutil.which("ffmpeg")
    if program is None:
        raise SettingError(
            f"{path}: is written by the program ffmpeg, which is not on the PATH; install it "
            "(ffmpeg.org), or write .webp, .gif, or pictures for another program, such as "
            f"{path.with_suffix('') / f'{path.stem}_####.png'}"
        )
    return program


def write_film(
    result: StoredAnimation,
    path: Path,
    settings: FilmSettings,
    overwrite: bool,
    progress: ProgressListener,
) -> Film:
    """Write a film, which `check_film_output` has let pass, in the format of its suffix.

    The same arguments give the same bytes; of MP4 and WebM, with the same version of ffmpeg.

    Raises
    ------
    SettingError
        When the result has no weights, or its clip is too long.
    OutputError
        When the file cannot be written.
    """
    binding = load_binding(result, "a film")
    film = Film(result, binding, settings)
    suffix = path.suffix.lower()
    width, height = settings.film_size
    if suffix == ".gif" and film.count * width * height > MAX_GIF_PIXELS:
        raise SettingError(
            f"{path}: {film.count} pictures of {width}x{height} pixels are too many for a "
            "GIF; " + say("choose a smaller `film_size=` or `film_seconds=`, or write .webp")
        )
    write: Callable[[Film, Pictures, Path, bool], None] = _write_by_ffmpeg
    if suffix in (".gif", ".webp"):
        write = _write_by_pillow
    elif suffix == ".png":
        write = _write_pictures
    jobs = count_processors()
    with progress.stage("film"):
        film.fit()
        with OrderedMap(film.draw, film.shots(), jobs, jobs + 1) as drawn:

            def count_drawn() -> Pictures:
                for number, pixels in enumerate(drawn):
                    progress.update(number + 1, film.count)
                    yield pixels

            write(film, count_drawn(), path, overwrite)
    if film.cut:
        shown = "the model" if settings.film_no_cage else "the model or its cage"
        progress.note(
            "note",
            f"{shown} is beyond the edges of {film.cut} of {film.count} pictures; "
            + say("for all of the motion, give `film_view=` without a distance: two numbers"),
        )
    return film


def _write_pictures(film: Film, pictures: Pictures, path: Path, overwrite: bool) -> None:
    """Write PNG files, which are numbered from 1 on: programs that encode take them so."""
    names = FrameNames.parse(path.name)
    assert names is not None
    with atomic_folder(path.parent, overwrite, names.matches) as folder:
        for number, pixels in enumerate(pictures, start=1):
            Image.fromarray(pixels).save(folder / names.file_name(number), "PNG")


def _write_by_ffmpeg(film: Film, pictures: Pictures, path: Path, overwrite: bool) -> None:
    """Let ffmpeg encode a film. One thread, as more would change the bytes."""
    program = find_encoder(path)
    encoder, options = ENCODERS[path.suffix.lower()]
    width, height = film.settings.film_size
    rate = Fraction(film.rate).limit_denominator(1001)
    given = f"-f rawvideo -pix_fmt rgb24 -video_size {width}x{height} -framerate {rate} -i pipe:0"
    # HDTV colours, which players take such films for; a key picture per second, to jump to.
    colours = "-colorspace bt709 -color_primaries bt709 -color_trc bt709 -color_range tv"
    made = f"-vf scale=out_color_matrix=bt709:out_range=tv,format=yuv420p {colours} -c:v {encoder}"
    exact = "-threads 1 -fflags +bitexact -flags:v +bitexact"
    encoded = f"{made} -g {max(1, round(film.rate))} {options} {exact}"
    words = ["-nostdin", "-loglevel", "error", *given.split(), *encoded.split()]
    with atomic_path(path, overwrite) as partial:
        try:
            with Program([program, *words, "-y", f"file:{partial.absolute()}"]) as encoding:
                for pixels in pictures:
                    encoding.feed(pixels.tobytes())
                encoding.finish()
        except ProgramError as error:
            text = single_line(str(error))
            raise OutputError(
                f"{path}: ffmpeg, which should write it, {text}; use an ffmpeg with the encoder "
                f"{encoder} and a disk with room, or write .webp, .gif or .png"
            ) from error


class LaterPictures:
    """The pictures of a film after the first, which are drawn when Pillow asks for them.

    Pillow takes this for an image of several pictures, such as a file holds, and has one at a time.
    """

    def __init__(self, first: Image.Image, others: Iterator[Image.Image], count: int) -> None:
        self.n_frames = count
        self._shown, self._others = first, others

    def seek(self, number: int) -> None:
        """Go to the next picture."""
        if number == self.n_frames:
            raise EOFError
        self._shown = next(self._others)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._shown, name)


def _write_by_pillow(film: Film, pictures: Pictures, path: Path, overwrite: bool) -> None:
    is_gif = path.suffix.lower() == ".gif"
    palette = film.choose_colours() if is_gif else None
    # GIF has times in hundredths of a second.
    unit = 10 if is_gif else 1
    times = unit * np.array(film.list_times(1000 // unit))

    def convert(pixels: Pixels) -> Image.Image:
        image = Image.fromarray(pixels)
        if palette is None:
            return image
        return image.quantize(palette=palette, dither=Image.Dither.NONE)

    images = map(convert, pictures)
    with atomic_file(path, overwrite) as file:
        first = next(images)
        first.save(
            file,
            "GIF" if is_gif else "WEBP",
            save_all=True,
            append_images=[LaterPictures(first, images, film.count - 1)],
            duration=np.diff(times).tolist(),
            loop=0,
            optimize=True,
            quality=WEBP_QUALITY,
            method=4,
        )
