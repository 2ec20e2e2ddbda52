"""What tests of films share."""

from dataclasses import replace

from cageik_cli.report.film.settings import FilmSettings

SMALL = FilmSettings(film_size=(96, 64))


def with_rate(result, fps):
    return replace(result, scene=replace(result.scene, fps=fps))
