"""`cageik report`: what a result says about itself."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.github_summary import append_step_summary
from cageik_cli.cli.options.common import PATH, common, write_or_print
from cageik_cli.cli.options.limits import echo_over_limits, exit_by, gate_options, limits_of

OF_ALL = ("json", "csv", "junit", "markdown")
"""Views of any number of results."""

OF_ONE = ("html", "plot")
PICTURES = (".png", ".svg")


@click.command("report")
@click.argument("results", nargs=-1, type=PATH)
@click.option("--html", type=PATH, help="Write one result's page, which needs no other file.")
@click.option("--plot", type=PATH, help="Draw rms and volume over the frames, as .png or .svg.")
@click.option("--json", type=PATH, help="Write the record as JSON; - is stdout.")
@click.option("--csv", type=PATH, help="Write a line a frame as CSV; - is stdout.")
@click.option("--junit", type=PATH, help="Write a test case a limit as JUnit XML; - is stdout.")
@click.option("--markdown", type=PATH, help="Write a table of the results; - is stdout.")
@gate_options
@click.option("--overwrite", is_flag=True, help="Replace existing files.")
@common
def report_command(results: tuple[Path, ...], overwrite: bool, quiet: bool, **options: Any) -> None:
    """Report on RESULTS of cageik extract or pose; on cages.h5 in this folder if none is named.

    The text goes to stdout, or to stderr when another view goes there. Markdown is appended to
    the file that GITHUB_STEP_SUMMARY names, when it is set.
    """
    results = results or (Path("cages.h5"),)
    targets: dict[str, Path | None] = {name: options.pop(name) for name in OF_ONE + OF_ALL}
    is_stdout_taken = _is_stdout_taken(targets)
    _refuse_views_of_one(targets, len(results))

    from cageik_cli.report.overview import entry_of, overview_of
    from cageik_cli.report.record import report_of
    from cageik_cli.report.views.junit import as_junit
    from cageik_cli.report.views.markdown import as_markdown
    from cageik_cli.report.views.tables import as_csv, as_json
    from cageik_cli.report.views.text import as_text
    from cageik_cli.store.result import read_result
    from cageik_cli.util.outputs import keep_apart, prepare

    keep_apart(list(targets.values()), [*results, options["baseline"]])
    limits = limits_of(options)
    for path in targets.values():
        if path is not None and str(path) != "-":
            prepare(path, overwrite)
    names = _names(results)
    limits = limits.by_name() if len(results) > 1 else limits
    held = list(map(read_result, results))
    reports = [report_of(*given) for given in zip(held, [limits] * len(held), names, strict=True)]
    overview = overview_of([entry_of(report) for report in reports])
    views: dict[str, Callable[[], str | bytes]] = {
        "html": partial(_page, held[0], reports[0]),
        "plot": partial(_plot, reports[0], targets["plot"]),
        "json": partial(as_json, reports),
        "csv": partial(as_csv, reports),
        "junit": partial(as_junit, overview),
        "markdown": partial(as_markdown, overview),
    }
    for name, path in targets.items():
        if path is not None:
            write_or_print(views[name](), path, overwrite)
    append_step_summary(as_markdown(overview))
    if quiet:
        echo_over_limits(overview)
    else:
        click.echo("\n\n".join(map(as_text, reports)), err=is_stdout_taken)
    exit_by(overview)


def _is_stdout_taken(targets: dict[str, Path | None]) -> bool:
    """Whether a view goes to stdout; two are wrong usage."""
    there = [f"--{name}" for name, path in targets.items() if str(path) == "-"]
    if len(there) > 1:
        raise click.UsageError(f"{there[0]} and {there[1]} both go to stdout; name a file for one")
    return bool(there)


def _refuse_views_of_one(targets: dict[str, Path | None], results: int) -> None:
    """Refuse what shows one result, of several; and a picture of no kind that is drawn."""
    for name in OF_ONE:
        if targets[name] is not None and results > 1:
            raise click.UsageError(
                f"--{name} shows one result, {results} were named; name one, or use cageik batch"
            )
    plot = targets["plot"]
    if plot is not None and plot.suffix.lower() not in PICTURES:
        raise click.UsageError(
            f"--plot {plot}: expected a name that ends in {' or '.join(PICTURES)}"
        )


def _names(results: tuple[Path, ...]) -> list[str]:
    """What results are called: their files' names, or all their paths where two share a name."""
    names = [path.name for path in results]
    return names if len(set(names)) == len(names) else [path.as_posix() for path in results]


def _page(result: Any, report: Any) -> str:
    from cageik_cli.report.html.page import page_of

    return page_of(result, report)


def _plot(report: Any, path: Path | None) -> str | bytes:
    from cageik_cli.report.plots.error_plot import as_png, as_svg

    is_png = path is not None and path.suffix.lower() == ".png"
    return as_png(report) if is_png else as_svg(report)
