"""The report of a result, and its views in files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, cast

from cageik_cli.report import record
from cageik_cli.report.overview import Overview, build_clip_entry
from cageik_cli.report.record import Report
from cageik_cli.report.views.data import format_csv, format_json, format_junit
from cageik_cli.report.views.markdown import format_markdown
from cageik_cli.run.keywords import make_settings, takes_settings
from cageik_cli.run.report_settings import ReportSettings
from cageik_cli.store.result import Edit, Result, StoredAnimation, read_animation
from cageik_cli.util.calls import FilePath, check_call
from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import Hint, Spelling, spell_keyword
from cageik_cli.util.outputs import check_no_overlap, check_writable, write_bytes
from cageik_cli.util.progress import ProgressListener


@check_call
def build_report(result: FilePath | Result | Edit) -> Report:
    """Compute the report of a result or an edit, as `cageik report` shows it.

    Raises
    ------
    CageikError
        When the file is not a complete, sound result or edit.

    Examples
    --------
    >>> from cageik_cli import build_report, extract_to_file
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> report = build_report(result)
    >>> report.verdict, round(report.summary.rms_percent, 2), report.summary.worst_frame
    ('good', 0.25, 'walker_26.obj')
    """
    return record.build_report(_read(result))


@check_call
@takes_settings(ReportSettings)
def report_to_files(
    results: FilePath | Result | Edit | Sequence[FilePath | Result | Edit], **settings: Any
) -> tuple[Report, ...]:
    """Write views of the report of one result or several, as `cageik report` does.

    Parameters
    ----------
    results : path, Result or Edit, or a sequence of these
        Those that the views show; `html`, `plot`, `player` and `film` show one.
    **settings
        As the options of `cageik report`; `help(cageik_cli.report_to_files)` lists them.

    Returns
    -------
    tuple of Report
        One per result.

    Raises
    ------
    CageikError
        When a result is damaged, a setting is impossible, or a file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from cageik_cli import extract_to_file, report_to_files
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> (report,) = report_to_files(result, html="walker.html", plot="walker.svg", csv="walker.csv")
    >>> len(report.frames), Path("walker.svg").stat().st_size > 10_000
    (48, True)
    """
    is_one = isinstance(results, Result | Edit | str | PathLike)
    given = cast(Sequence[FilePath | Result | Edit], [results] if is_one else results)
    if not given:
        raise SettingError(Hint("results") + " is empty; name a result")
    read = [_read(one) for one in given]
    made = make_settings(ReportSettings, settings, results=[one.path for one in read])
    for name, path in made.targets.named.items():
        if str(path) == "-":
            raise SettingError(Hint(name) + " is -, expected the name of a file")
    film = made.targets.film
    outputs = [path for name, path in made.targets.named.items() if name != "film"]
    films = []
    if film is not None:
        from cageik_cli.report.film.write import (  # slow: Pillow
            check_film_output,
            name_film_output,
            write_film,
        )

        films = [name_film_output(film)]
    check_no_overlap([*outputs, *films], made.inputs())
    for path in outputs:
        check_writable(path, made.overwrite)
    if film is not None:
        check_film_output(film, made.film_settings, made.overwrite)
    names = choose_names(made.results)
    reports = [record.build_report(one, None, name) for one, name in zip(read, names, strict=True)]
    overview = Overview([build_clip_entry(report) for report in reports])
    for name, view in render_views(made, read[0], reports, overview).items():
        data = view()
        path = made.targets.named[name]
        write_bytes(path, data.encode() if isinstance(data, str) else data, made.overwrite)
    if film is not None:
        write_film(read[0], film, made.film_settings, made.overwrite, ProgressListener())
    return tuple(reports)


def _read(result: FilePath | Result | Edit) -> StoredAnimation:
    return result if isinstance(result, Result | Edit) else read_animation(Path(result))


def choose_names(results: Sequence[Path]) -> list[str]:
    """Return the names of the files; all the paths if two files share a name."""
    names = [path.name for path in results]
    return names if len(set(names)) == len(names) else [path.as_posix() for path in results]


def render_views(
    settings: ReportSettings,
    result: StoredAnimation,
    reports: list[Report],
    overview: Overview,
    spelling: Spelling = spell_keyword,
) -> Mapping[str, Callable[[], str | bytes]]:
    """Return what renders each view that is asked for, but the film.

    Parameters
    ----------
    result : Result or Edit
        That of the first report.
    spelling : callable
        How a page writes the settings that notes name.
    """
    targets = settings.targets
    views: dict[str, Callable[[], str | bytes]] = {
        "html": partial(_render_page, result, reports[0], not targets.no_player, spelling),
        "plot": partial(_render_plot, reports[0], targets.plot),
        "player": partial(_render_player, result),
        "json": partial(format_json, reports, overview.gaps),
        "csv": partial(format_csv, reports),
        "junit": partial(format_junit, overview),
        "markdown": partial(format_markdown, overview),
    }
    return {name: view for name, view in views.items() if name in targets.named}


def _render_page(
    result: StoredAnimation, report: Report, has_player: bool, spelling: Spelling
) -> str:
    from cageik_cli.report.html.page import render_result_page
    from cageik_cli.view.player.section import load_player

    player = load_player(result) if has_player else None
    return render_result_page(result, report, player, spelling)


def _render_plot(report: Report, path: Path | None) -> str | bytes:
    from cageik_cli.report.plots.error_plot import render_plot_png, render_plot_svg  # matplotlib

    is_png = path is not None and path.suffix.lower() == ".png"
    return render_plot_png(report) if is_png else render_plot_svg(report)


def _render_player(result: StoredAnimation) -> str:
    from cageik_cli.view.player.section import render_player_page

    return render_player_page(result)
