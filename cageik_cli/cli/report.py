"""`cageik report`: the figures of results, and limits on them."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cageik_cli.cli.command import GroupedCommand, get_verbosity, option
from cageik_cli.cli.group import spell_option
from cageik_cli.cli.options import common_options, overwrite_option
from cageik_cli.cli.options.group import PATH_TYPE, OptionGroup, list_options
from cageik_cli.cli.options.limits import LIMIT_OPTIONS, LimitOptions
from cageik_cli.cli.options.types import SuffixedPath
from cageik_cli.cli.output import (
    append_step_summary,
    check_views,
    echo_exceeded_limits,
    echo_gaps,
    exit_with_code,
    list_next_steps,
    show_progress,
    write_or_print,
)
from cageik_cli.report.film.settings import FilmSettings
from cageik_cli.util.text import format_count

if TYPE_CHECKING:
    from cageik_cli.report.overview import Overview
    from cageik_cli.report.record import Report
    from cageik_cli.store.result import StoredAnimation


SINGLE_VIEWS = ("html", "plot", "player", "film")
"""The views that show one result."""


@dataclass(frozen=True, slots=True)
class ReportTargets:
    """The file that each view is written to; `-` is stdout."""

    html: Path | None
    plot: Path | None
    json: Path | None
    csv: Path | None
    junit: Path | None
    markdown: Path | None
    player: Path | None
    film: Path | None
    no_player: bool

    def __post_init__(self) -> None:
        on_stdout = [f"--{name}" for name, path in self.named.items() if str(path) == "-"]
        if len(on_stdout) > 1:
            raise click.UsageError(
                f"{on_stdout[0]} and {on_stdout[1]} both go to stdout; write one to a file"
            )

    @property
    def named(self) -> dict[str, Path]:
        """The targets that are given, by the names of the views."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: path for name, path in values.items() if isinstance(path, Path)}

    @property
    def uses_stdout(self) -> bool:
        """Whether a view goes to stdout."""
        return any(str(path) == "-" for path in self.named.values())

    def check_single(self, count: int) -> None:
        """Refuse views of one result when there are several."""
        for name in SINGLE_VIEWS:
            if name in self.named and count > 1:
                raise click.UsageError(
                    f"--{name} shows one result, {count} were named; name one, or use cageik batch"
                )


def _print_schema(ctx: click.Context, _: click.Parameter, value: bool) -> None:
    if value:
        from cageik_cli.report.views.schema import format_schema

        click.echo(format_schema(), nl=False)
        ctx.exit()


@click.command("report", cls=GroupedCommand)
@click.argument("results", nargs=-1, type=PATH_TYPE)
@OptionGroup(
    "targets",
    ReportTargets,
    option("--html", type=PATH_TYPE, help="Write the page of one result, complete in one file."),
    option(
        "--plot",
        type=SuffixedPath(".png", ".svg"),
        help="Draw RMS error and volume over the frames (.png, .svg).",
    ),
    option("--json", type=PATH_TYPE, help="Write the record as JSON; - is stdout."),
    option("--csv", type=PATH_TYPE, help="Write CSV with one line per frame; - is stdout."),
    option(
        "--junit",
        type=PATH_TYPE,
        help="Write JUnit XML with one test case per limit; - is stdout.",
    ),
    option(
        "--markdown", type=PATH_TYPE, help="Write a Markdown table of the results; - is stdout."
    ),
    option(
        "--player",
        type=SuffixedPath(".html"),
        help="Write a small page of one result that plays and poses it (.html).",
    ),
    option(
        "--film",
        type=SuffixedPath(".webp", ".gif"),
        help="Draw a film of one result (.webp, .gif).",
    ),
    option("--no-player", is_flag=True, help="Leave the player out of the page of --html."),
)
@OptionGroup("film", FilmSettings, *list_options(FilmSettings))
@click.option(
    "--schema",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_schema,
    help="Print the JSON schema of reports, batches and results, and exit.",
)
@click.option("--all", "has_all", is_flag=True, help="Print all figures, notes and regions.")
@LIMIT_OPTIONS
@overwrite_option
@common_options
def report_command(
    results: tuple[Path, ...],
    targets: ReportTargets,
    film: FilmSettings,
    has_all: bool,
    limits: LimitOptions,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Show how well results fit; check limits.

    RESULTS are files of cageik extract or cageik pose; cages.h5 in this folder if none is named.
    The text goes to stdout, or to stderr when a view goes to stdout. Markdown is also appended to
    the file that GITHUB_STEP_SUMMARY names, when it is set.
    """
    results = results or (Path("cages.h5"),)
    targets.check_single(len(results))
    _check_film(targets, film)

    from cageik_cli.report.overview import Overview, build_clip_entry
    from cageik_cli.report.record import build_report
    from cageik_cli.report.views.markdown import format_markdown
    from cageik_cli.store.result import read_animation

    check_views(list(targets.named.values()), [*results, limits.baseline], overwrite)
    loaded_limits = limits.load()
    loaded = [read_animation(path) for path in results]
    names = _choose_names(results)
    if len(results) > 1:
        loaded_limits = loaded_limits.match_several(names)
    reports = [
        build_report(result, loaded_limits, name, spell_option)
        for result, name in zip(loaded, names, strict=True)
    ]
    entries = [build_clip_entry(report) for report in reports]
    overview = Overview(entries, limits=dict.fromkeys(names, loaded_limits))
    _write_views(targets, overwrite, loaded[0], reports, overview)
    film_words = _write_film(targets.film, loaded[0], film, overwrite, quiet)
    append_step_summary(format_markdown(overview))
    if quiet:
        echo_exceeded_limits(overview)
    else:
        texts = [_format_result(report, has_all or bool(get_verbosity())) for report in reports]
        lines = ["\n\n".join(texts), *_list_written(targets, film_words)]
        if len(results) == 1:
            lines += list_next_steps(loaded[0])
        click.echo("\n".join(lines), err=targets.uses_stdout)
        echo_gaps(overview)
    exit_with_code(overview)


def _write_views(
    targets: ReportTargets,
    overwrite: bool,
    result: "StoredAnimation",
    reports: list["Report"],
    overview: "Overview",
) -> None:
    """Write every view that is asked for; `result` is that of the first report."""
    from cageik_cli.report.views.data import format_csv, format_json, format_junit
    from cageik_cli.report.views.markdown import format_markdown

    views: dict[str, Callable[[], str | bytes]] = {
        "html": partial(_render_page, result, reports[0], not targets.no_player),
        "plot": partial(_render_plot, reports[0], targets.plot),
        "player": partial(_render_player, result),
        "json": partial(format_json, reports, overview.gaps),
        "csv": partial(format_csv, reports),
        "junit": partial(format_junit, overview),
        "markdown": partial(format_markdown, overview),
    }
    for name, path in targets.named.items():
        if name in views:
            write_or_print(views[name](), path, overwrite)


def _check_film(targets: ReportTargets, film: FilmSettings) -> None:
    """Refuse settings of a film where none is written."""
    usual = FilmSettings()
    given = [
        one.name for one in fields(film) if getattr(film, one.name) != getattr(usual, one.name)
    ]
    if given and targets.film is None:
        name = given[0].replace("_", "-")
        raise click.UsageError(f"--{name}: no film is written; name one with --film FILE.webp")


def _write_film(
    path: Path | None,
    result: "StoredAnimation",
    settings: FilmSettings,
    overwrite: bool,
    quiet: bool,
) -> str:
    """Write the film, if one is asked for; return what it is in words."""
    if path is None:
        return ""
    from cageik_cli.report.film.film import write_film

    with show_progress(not quiet, None, overwrite) as progress:
        plan = write_film(result, path, settings, overwrite, progress)
    width, height = settings.film_size
    pictures = format_count(plan.count, "picture")
    drawn = progress.seconds["total"]
    return f"{pictures} of {width}x{height}, {plan.seconds:.1f} s, drawn in {drawn:.1f} s"


def _format_result(report: "Report", has_all: bool) -> str:
    from cageik_cli.report.views.front import format_front
    from cageik_cli.report.views.text import format_text

    if has_all:
        return format_text(report, is_verbose=True, spelling=spell_option)
    return format_front(report, source="-v")


def _list_written(targets: ReportTargets, film_words: str) -> list[str]:
    """Return a line on each file that was written, with its size."""
    from cageik_cli.util.text import format_bytes

    lines = []
    for name, path in targets.named.items():
        if str(path) != "-":
            facts = [format_bytes(path.stat().st_size), *([film_words] if name == "film" else [])]
            lines.append(f"wrote {path} ({', '.join(facts)})")
    return lines


def _choose_names(results: tuple[Path, ...]) -> list[str]:
    """Return the names of the files; all the paths if two files share a name."""
    names = [path.name for path in results]
    return names if len(set(names)) == len(names) else [path.as_posix() for path in results]


def _render_page(result: "StoredAnimation", report: "Report", has_player: bool) -> str:
    from cageik_cli.report.html.page import render_result_page
    from cageik_cli.view.player.section import load_player

    player = load_player(result) if has_player else None
    return render_result_page(result, report, player, spell_option)


def _render_plot(report: "Report", path: Path | None) -> str | bytes:
    from cageik_cli.report.plots.error_plot import render_plot_png, render_plot_svg

    is_png = path is not None and path.suffix.lower() == ".png"
    return render_plot_png(report) if is_png else render_plot_svg(report)


def _render_player(result: "StoredAnimation") -> str:
    from cageik_cli.view.player.section import render_player_page

    return render_player_page(result)
