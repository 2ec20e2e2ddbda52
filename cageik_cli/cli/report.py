"""`cageik report`: what a result says about itself."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.github_summary import append_step_summary
from cageik_cli.cli.options.common import PATH_TYPE, common_options, write_or_print
from cageik_cli.cli.options.limits import (
    echo_exceeded_limits,
    exit_with_code,
    limit_options,
    pop_limits,
)

MULTI_RESULT_VIEWS = ("json", "csv", "junit", "markdown")
"""Views of any number of results."""

SINGLE_RESULT_VIEWS = ("html", "plot")
PLOT_SUFFIXES = (".png", ".svg")


@click.command("report")
@click.argument("results", nargs=-1, type=PATH_TYPE)
@click.option("--html", type=PATH_TYPE, help="Write one result's page, which needs no other file.")
@click.option(
    "--plot", type=PATH_TYPE, help="Draw rms and volume over the frames, as .png or .svg."
)
@click.option("--json", type=PATH_TYPE, help="Write the record as JSON; - is stdout.")
@click.option("--csv", type=PATH_TYPE, help="Write a line a frame as CSV; - is stdout.")
@click.option(
    "--junit", type=PATH_TYPE, help="Write a test case a limit as JUnit XML; - is stdout."
)
@click.option("--markdown", type=PATH_TYPE, help="Write a table of the results; - is stdout.")
@limit_options
@click.option("--overwrite", is_flag=True, help="Replace existing files.")
@common_options
def report_command(results: tuple[Path, ...], overwrite: bool, quiet: bool, **options: Any) -> None:
    """Report on RESULTS of cageik extract or pose; on cages.h5 in this folder if none is named.

    The text goes to stdout, or to stderr when another view goes there. Markdown is appended to
    the file that GITHUB_STEP_SUMMARY names, when it is set.
    """
    results = results or (Path("cages.h5"),)
    targets: dict[str, Path | None] = {
        name: options.pop(name) for name in SINGLE_RESULT_VIEWS + MULTI_RESULT_VIEWS
    }
    is_stdout_taken = _check_stdout_taken(targets)
    _check_single_result_views(targets, len(results))

    from cageik_cli.report.overview import build_clip_entry, build_overview
    from cageik_cli.report.record import build_report
    from cageik_cli.report.views.junit import format_junit
    from cageik_cli.report.views.markdown import format_markdown
    from cageik_cli.report.views.tables import format_csv, format_json
    from cageik_cli.report.views.text import format_text
    from cageik_cli.store.result import read_result
    from cageik_cli.util.outputs import check_no_overlap, check_writable

    check_no_overlap(list(targets.values()), [*results, options["baseline"]])
    limits = pop_limits(options)
    for path in targets.values():
        if path is not None and str(path) != "-":
            check_writable(path, overwrite)
    names = _choose_names(results)
    limits = limits.match_by_name() if len(results) > 1 else limits
    loaded = list(map(read_result, results))
    reports = [
        build_report(*given) for given in zip(loaded, [limits] * len(loaded), names, strict=True)
    ]
    overview = build_overview([build_clip_entry(report) for report in reports])
    views: dict[str, Callable[[], str | bytes]] = {
        "html": partial(_render_page, loaded[0], reports[0]),
        "plot": partial(_render_plot, reports[0], targets["plot"]),
        "json": partial(format_json, reports),
        "csv": partial(format_csv, reports),
        "junit": partial(format_junit, overview),
        "markdown": partial(format_markdown, overview),
    }
    for name, path in targets.items():
        if path is not None:
            write_or_print(views[name](), path, overwrite)
    append_step_summary(format_markdown(overview))
    if quiet:
        echo_exceeded_limits(overview)
    else:
        click.echo("\n\n".join(map(format_text, reports)), err=is_stdout_taken)
    exit_with_code(overview)


def _check_stdout_taken(targets: dict[str, Path | None]) -> bool:
    """Whether a view goes to stdout; two are wrong usage."""
    there = [f"--{name}" for name, path in targets.items() if str(path) == "-"]
    if len(there) > 1:
        raise click.UsageError(f"{there[0]} and {there[1]} both go to stdout; name a file for one")
    return bool(there)


def _check_single_result_views(targets: dict[str, Path | None], results: int) -> None:
    """Refuse what shows one result, of several; and a picture of no kind that is drawn."""
    for name in SINGLE_RESULT_VIEWS:
        if targets[name] is not None and results > 1:
            raise click.UsageError(
                f"--{name} shows one result, {results} were named; name one, or use cageik batch"
            )
    plot = targets["plot"]
    if plot is not None and plot.suffix.lower() not in PLOT_SUFFIXES:
        raise click.UsageError(
            f"--plot {plot}: expected a name that ends in {' or '.join(PLOT_SUFFIXES)}"
        )


def _choose_names(results: tuple[Path, ...]) -> list[str]:
    """What results are called: their files' names, or all their paths where two share a name."""
    names = [path.name for path in results]
    return names if len(set(names)) == len(names) else [path.as_posix() for path in results]


def _render_page(result: Any, report: Any) -> str:
    from cageik_cli.report.html.page import render_result_page

    return render_result_page(result, report)


def _render_plot(report: Any, path: Path | None) -> str | bytes:
    from cageik_cli.report.plots.error_plot import render_plot_png, render_plot_svg

    is_png = path is not None and path.suffix.lower() == ".png"
    return render_plot_png(report) if is_png else render_plot_svg(report)
