"""`cageik info`: what a file contains."""

import click

from cageik_cli.cli.command import GroupedCommand
from cageik_cli.cli.options import common_options
from cageik_cli.cli.options.group import OptionGroup, list_options
from cageik_cli.formats.settings import ClipSettings


@click.command("info", cls=GroupedCommand)
@click.argument("files", nargs=-1, required=True)
@OptionGroup(
    "clip", ClipSettings, *list_options(ClipSettings, {"layout": {}, "exclude": {}, "fps": {}})
)
@common_options
def info_command(files: tuple[str, ...], clip: ClipSettings, quiet: bool) -> None:
    """Describe files.

    FILES are a result, a binding, a clip (files, a folder, a glob) or one mesh, such as a cage.
    Files that are not frames of one clip are described one after another.
    """
    from cageik_cli.cli.output import spell_rows
    from cageik_cli.run.info import describe_files
    from cageik_cli.util.text import format_block

    described = describe_files(list(files), clip.layout, clip.exclude, clip.fps)
    if not quiet:
        blocks = (format_block(name, spell_rows(rows, info_command)) for name, rows in described)
        click.echo("\n\n".join(blocks))
