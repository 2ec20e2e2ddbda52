"""`cageik info`: what a file contains."""

import click

from cageik_cli.cli.command import GroupedCommand
from cageik_cli.cli.group import word_options
from cageik_cli.cli.options import common_options
from cageik_cli.cli.options.clip import exclude_option, layout_option, rate_option


@click.command("info", cls=GroupedCommand)
@click.argument("files", nargs=-1, required=True)
@layout_option
@exclude_option
@rate_option
@common_options
def info_command(
    files: tuple[str, ...],
    layout: str | None,
    exclude: tuple[str, ...],
    fps: float | None,
    quiet: bool,
) -> None:
    """Describe files.

    FILES are a result, a binding, a clip (files, a folder, a glob) or one mesh, such as a cage.
    Files that are not frames of one clip are described one after another.
    """
    from cageik_cli.run.info import describe_files

    text = describe_files(list(files), layout, exclude, fps)
    if not quiet:
        click.echo(word_options(text, click.get_current_context().command))
