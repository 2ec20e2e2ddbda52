"""`cageik report`: what a result says about itself."""

from pathlib import Path

import click

from cageik_cli.cli.options import PATH, common, write_or_print


@click.command("report")
@click.argument("results", nargs=-1, type=PATH)
@click.option("--json", type=PATH, help="Write the record as JSON; - is stdout.")
@click.option("--csv", type=PATH, help="Write a line a frame as CSV; - is stdout.")
@click.option("--overwrite", is_flag=True, help="Replace existing files.")
@common
def report_command(
    results: tuple[Path, ...],
    json: Path | None,
    csv: Path | None,
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
    keep_apart([json, csv], list(results))
    for path in (json, csv):
        if path is not None and str(path) != "-":
            prepare(path, overwrite)
    reports = [report_of(read_result(path)) for path in results]
    for path, view in ((json, as_json), (csv, as_csv)):
        if path is not None:
            write_or_print(view(reports), path, overwrite)
    if not quiet:
        taken = "-" in (str(json), str(csv))
        click.echo("\n\n".join(map(as_text, reports)), err=taken)
