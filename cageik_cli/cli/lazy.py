"""Commands that are imported when they run: the help of all commands needs none of them."""

from collections.abc import Iterator, Mapping, MutableMapping
from importlib import import_module

import click


class LazyCommands(MutableMapping[str, click.Command]):
    """The commands by their names; command NAME is `NAME_command` in the module `cli.NAME`.

    Parameters
    ----------
    summaries : mapping of str to str
        What each command does, in one line; the first line of its own help.
    """

    def __init__(self, summaries: Mapping[str, str]) -> None:
        self.summaries = summaries
        self._others: dict[str, click.Command] = {}

    def __getitem__(self, name: str) -> click.Command:
        if name in self._others:
            return self._others[name]
        if name not in self.summaries:
            raise KeyError(name)
        module = import_module(f"cageik_cli.cli.{name}")
        command: click.Command = getattr(module, f"{name}_command")
        return command

    def __contains__(self, name: object) -> bool:
        return name in self.summaries or name in self._others

    def __setitem__(self, name: str, command: click.Command) -> None:
        self._others[name] = command

    def __delitem__(self, name: str) -> None:
        del self._others[name]

    def __iter__(self) -> Iterator[str]:
        return iter([*self.summaries, *self._others])

    def __len__(self) -> int:
        return len(self.summaries) + len(self._others)
