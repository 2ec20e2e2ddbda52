"""`cageik report`: what a result says about itself."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cageik_cli.cli.options import PATH, common, write_or_print

if TYPE_CHECKING:
    from cageik_cli.report import Report
    from cageik_cli.store.result import Result


@click.command("report")
@click.argument("results", nargs=-1, type=PATH)
@click.option("--json", type=PATH, help="Write the record as JSON; - is stdout.")
@click.option("--csv", type=PATH, help="Write a line a frame as CSV; - is stdout.")
@click.option("--html", type=PATH, help="Write one result's page, which needs no other file.")
@click.option("--overwrite", is_flag=True, help="Replace existing files.")
@common
def report_command(
    results: tuple[Path, ...],
    json: Path | None,
    csv: Path | None,
    html: Path | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Report on RESULTS of cageik extract; on cages.h5 in this folder if none is named.

    The text goes to stdout, or to stderr when another view goes there.
    """
    from cageik_cli.outputs import keep_apart, prepare
    from cageik_cli.report import as_csv, as_json, as_text, report_of
    from cageik_cli.store.result import read_result

    _refuse_two_on_stdout({"--json": json, "--csv": csv, "--html": html})
    results = results or (Path("cages.h5"),)
    if html is not None and len(results) > 1:
        raise click.UsageError(
            f"--html writes the page of one result, not of {len(results)}; name one, or use "
            "cageik batch"
        )
    keep_apart([json, csv, html], list(results))
    for path in (json, csv, html):
        if path is not None and str(path) != "-":
            prepare(path, overwrite)
    held = [read_result(path) for path in results]
    reports = list(map(report_of, held))
    for path, view in ((json, as_json), (csv, as_csv)):
        if path is not None:
            write_or_print(view(reports), path, overwrite)
    if html is not None:
        write_or_print(_page(held[0], reports[0]), html, overwrite)
    if not quiet:
        taken = "-" in (str(json), str(csv), str(html))
        click.echo("\n\n".join(map(as_text, reports)), err=taken)


def _refuse_two_on_stdout(views: dict[str, Path | None]) -> None:
    there = [option for option, path in views.items() if str(path) == "-"]
    if len(there) > 1:
        raise click.UsageError(f"{there[0]} and {there[1]} both go to stdout; name a file for one")


def _page(result: "Result", report: "Report") -> str:
    from cageik_cli.report import poses_of
    from cageik_cli.report.page import as_html
    from cageik_cli.report.pictures import pictures_of

    poses = poses_of(result)
    return as_html(report, None if poses is None else pictures_of(poses))
