"""`cageik report`: the figures of results, and limits on them."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cageik_cli.cli.command import GroupedCommand, get_verbosity, option
from cageik_cli.cli.group import spell_option
from cageik_cli.cli.options import common_options, overwrite_option
from cageik_cli.cli.options.group import OptionGroup, list_options
from cageik_cli.cli.options.limits import LIMIT_OPTIONS, LimitOptions
from cageik_cli.cli.output import (
    LineLogger,
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
from cageik_cli.run.report_settings import ReportSettings, ReportTargets
from cageik_cli.util.text import format_count

if TYPE_CHECKING:
    from cageik_cli.report.record import Report
    from cageik_cli.store.result import StoredAnimation


def _print_schema(context: click.Context, _: click.Parameter, is_asked: bool) -> None:
    if is_asked:
        from cageik_cli.report.views.schema import format_schema

        click.echo(format_schema(), nl=False)
        context.exit()


@click.command("report", cls=GroupedCommand)
@OptionGroup("settings", ReportSettings, *list_options(ReportSettings, overwrite=overwrite_option))
@option(
    "--schema",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    is_per_clip=False,
    callback=_print_schema,
    help="Print the JSON Schema of reports and of the attributes of results, and exit.",
)
@click.option("--all", "has_all", is_flag=True, help="Print all figures, notes and regions.")
@LIMIT_OPTIONS
@common_options
def report_command(
    settings: ReportSettings,
    has_all: bool,
    limits: LimitOptions,
    quiet: bool,
) -> None:
    """Show how well results fit; check limits.

    RESULTS are files of cageik extract or cageik pose; cages.h5 in this folder if none is named.
    The text goes to stdout, or to stderr when a view goes to stdout. Markdown is also appended to
    the file that GITHUB_STEP_SUMMARY names, when it is set.
    """
    results, targets = settings.results or (Path("cages.h5"),), settings.targets
    overwrite = settings.overwrite
    from cageik_cli.report.overview import Overview, build_clip_entry
    from cageik_cli.report.record import build_report
    from cageik_cli.report.views.markdown import format_markdown
    from cageik_cli.store.result import read_animation
    from cageik_cli.view.report import choose_names, render_views

    _check_outputs(settings, [*results, limits.baseline])
    loaded_limits = limits.load()
    loaded = [read_animation(path) for path in results]
    names = choose_names(results)
    if len(results) > 1:
        loaded_limits = loaded_limits.match_several(names)
    reports = [
        build_report(result, loaded_limits, name, spell_option)
        for result, name in zip(loaded, names, strict=True)
    ]
    entries = [build_clip_entry(report) for report in reports]
    overview = Overview(entries, limits=dict.fromkeys(names, loaded_limits))
    for name, render in render_views(settings, loaded[0], reports, overview, spell_option).items():
        write_or_print(render(), targets.named[name], overwrite)
    film_words = _write_film(targets.film, loaded[0], settings.film_settings, overwrite, quiet)
    append_step_summary(format_markdown(overview))
    if quiet:
        echo_exceeded_limits(overview)
    else:
        texts = [_format_result(report, has_all or bool(get_verbosity())) for report in reports]
        lines = ["\n\n".join(texts), *_list_written(targets, film_words)]
        if len(results) == 1:
            lines += list_next_steps(loaded[0])
        uses_stdout = any(str(path) == "-" for path in targets.named.values())
        click.echo("\n".join(lines), err=uses_stdout)
        echo_gaps(overview)
    exit_with_code(overview)


def _check_outputs(settings: ReportSettings, inputs: Sequence[Path | None]) -> None:
    """Refuse outputs that cannot be written; a film may be files in a folder."""
    named, film, films = dict(settings.targets.named), settings.targets.film, []
    if film is not None:
        from cageik_cli.report.film.write import check_film_output, name_film_output

        films = [name_film_output(named.pop("film"))]
    check_views([*named.values()], inputs, settings.overwrite, films)
    if film is not None:
        check_film_output(film, settings.film_settings, settings.overwrite)


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
    from cageik_cli.report.film.write import write_film

    with show_progress(not quiet, None, overwrite, LineLogger) as progress:
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
        if str(path) == "-":
            continue
        # Of a film of pictures, the name is a pattern.
        files = [path] if path.exists() else [*path.parent.iterdir()]
        size = format_bytes(sum(file.stat().st_size for file in files))
        facts = [size, *([film_words] if name == "film" else [])]
        lines.append(f"wrote {path} ({', '.join(facts)})")
    return lines
