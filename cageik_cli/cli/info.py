"""`cageik info`: what a file holds."""

import click

from cageik_cli.cli.options.clip import layout_option
from cageik_cli.cli.options.common import common_options


@click.command("info")
@click.argument("files", nargs=-1, required=True)
@layout_option
@common_options
def info_command(files: tuple[str, ...], layout: str | None, quiet: bool) -> None:
    """Say what FILES hold: a result, a clip (files, folder, glob) or one mesh, such as a cage."""
    from cageik_cli.workflows.info import describe_files

    text = describe_files(list(files), layout)
    if not quiet:
        click.echo(text)
