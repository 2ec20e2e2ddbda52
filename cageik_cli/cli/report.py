"""`cageik report`: what a result says about itself."""

from functools import partial
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.gate_options import echo_over_limits, exit_by, gate_options, limits_of
from cageik_cli.cli.options import PATH, common, write_or_print
from cageik_cli.cli.step_summary import append_step_summary

VIEWS = ("json", "csv", "junit", "markdown")


@click.command("report")
@click.argument("results", nargs=-1, type=PATH)
@click.option("--json", type=PATH, help="Write the record as JSON; - is stdout.")
@click.option("--csv", type=PATH, help="Write a line a frame as CSV; - is stdout.")
@click.option("--junit", type=PATH, help="Write a test case a limit as JUnit XML; - is stdout.")
@click.option("--markdown", type=PATH, help="Write a table of the results; - is stdout.")
@gate_options
@click.option("--overwrite", is_flag=True, help="Replace existing files.")
@common
def report_command(results: tuple[Path, ...], overwrite: bool, quiet: bool, **options: Any) -> None:
    """Report on RESULTS of cageik extract; on cages.h5 in this folder if none is named.

    The text goes to stdout, or to stderr when JSON, CSV, JUnit or Markdown goes there. Markdown
    is appended to the file that GITHUB_STEP_SUMMARY names, when it is set.
    """
    from cageik_cli.outputs import keep_apart, prepare
    from cageik_cli.report import (
        as_csv,
        as_json,
        as_junit,
        as_markdown,
        as_text,
        entry_of,
        overview_of,
        report_of,
    )
    from cageik_cli.store.result import read_result

    targets: dict[str, Path | None] = {name: options.pop(name) for name in VIEWS}
    is_stdout_taken = _is_stdout_taken(targets)
    results = results or (Path("cages.h5"),)
    keep_apart(list(targets.values()), [*results, options["baseline"]])
    limits = limits_of(options)
    for path in targets.values():
        if path is not None and str(path) != "-":
            prepare(path, overwrite)
    names = _names(results)
    limits = limits.by_name() if len(results) > 1 else limits
    reports = [
        report_of(read_result(path), limits, name)
        for path, name in zip(results, names, strict=True)
    ]
    overview = overview_of([entry_of(report) for report in reports])
    views = {
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


def _names(results: tuple[Path, ...]) -> list[str]:
    """What results are called: their files' names, or all their paths where two share a name."""
    names = [path.name for path in results]
    return names if len(set(names)) == len(names) else [path.as_posix() for path in results]
