"""Options in messages: the folders below name parameters in backticks, and options are words here.

`overwrite` in a message is shown as --overwrite, `outside=project` as --outside project.
"""

import re
from collections.abc import Mapping

import click

FURTHER_OPTIONS: Mapping[str, str] = {
    "keep_weights": "without --no-weights",
}
"""Words for parameters that no option sets to this value."""


def word_options(text: str, command: click.Command | None) -> str:
    """Return a message with the options of a command in place of parameters in backticks.

    Words in backticks that are no parameter, such as a suffix, are left as they are. A parameter
    that the command does not have is taken for one of extract.
    """

    def replace(match: re.Match[str]) -> str:
        name, value = match.groups()
        option = _find_option(name, command)
        return match[0] if option is None else " ".join(filter(None, [option, value]))

    return re.sub(r"`([a-z][a-z_]*)(?:=([^`]*))?`", replace, text)


def _find_option(name: str, command: click.Command | None) -> str | None:
    """Return what is typed for a parameter: an option, or an argument in capitals."""
    from cageik_cli.cli.extract import extract_command

    for known in (command, extract_command):
        for param in known.params if known is not None else ():
            if param.name == name:
                return max(param.opts, key=len) if param.opts[0][0] == "-" else name.upper()
    return FURTHER_OPTIONS.get(name)
