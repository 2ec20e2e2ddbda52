"""`cageik report`: what a result says about itself."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cageik_cli.cli.options import PATH, common, write_or_print

if TYPE_CHECKING:
    from cageik_cli.report import Report

PLOTS = (".png", ".svg")


@click.command("report")
@click.argument("results", nargs=-1, type=PATH)
@click.option("--json", type=PATH, help="Write the record as JSON; - is stdout.")
@click.option("--csv", type=PATH, help="Write a line a frame as CSV; - is stdout.")
@click.option("--plot", type=PATH, help="Draw error and volume over the frames, as .png or .svg.")
@click.option("--overwrite", is_flag=True, help="Replace existing files.")
@common
def report_command(
    results: tuple[Path, ...],
    json: Path | None,
    csv: Path | None,
    plot: Path | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Report on RESULTS of cageik extract; on cages.h5 in this folder if none is named.

    The text goes to stdout, or to stderr when JSON or CSV goes there.
    """
    from cageik_cli.outputs import keep_apart, prepare
    from cageik_cli.report import as_csv, as_json, as_text, report_of
    from cageik_cli.store.result import read_result

    if str(json) == str(csv) == "-":
        raise click.UsageError("--json and --csv both go to stdout; name a file for one")
    results = results or (Path("cages.h5"),)
    if plot is not None:
        _check_plot(plot, len(results))
    keep_apart([json, csv, plot], list(results))
    for path in (json, csv, plot):
        if path is not None and str(path) != "-":
            prepare(path, overwrite)
    reports = [report_of(read_result(path)) for path in results]
    for path, view in ((json, as_json), (csv, as_csv)):
        if path is not None:
            write_or_print(view(reports), path, overwrite)
    if plot is not None:
        _write_plot(reports[0], plot, overwrite)
    if not quiet:
        taken = "-" in (str(json), str(csv))
        click.echo("\n\n".join(map(as_text, reports)), err=taken)


def _check_plot(path: Path, results: int) -> None:
    """Refuse a picture of no kind that is drawn, or of several results.

    Raises
    ------
    click.UsageError
    """
    if path.suffix.lower() not in PLOTS:
        raise click.UsageError(f"--plot {path}: expected a name that ends in {' or '.join(PLOTS)}")
    if results > 1:
        raise click.UsageError(f"--plot draws one result, {results} were named; report on each")


def _write_plot(report: "Report", path: Path, overwrite: bool) -> None:
    from cageik_cli.outputs import whole_file
    from cageik_cli.report.figure import as_png, as_svg

    drawn = as_png(report) if path.suffix.lower() == ".png" else as_svg(report).encode()
    with whole_file(path, overwrite) as file:
        file.write(drawn)
