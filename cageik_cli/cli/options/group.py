"""Groups of options that become one record, which the command gets as one argument."""

from collections.abc import Callable, Mapping, Sequence
from functools import update_wrapper
from inspect import signature
from typing import Any, Generic, TypeVar

Record = TypeVar("Record", covariant=True)
Command = TypeVar("Command", bound=Callable[..., Any])
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


class OptionGroup(Generic[Record]):
    """A decorator that adds options to a command and gives it the record that they make.

    Parameters
    ----------
    name : str
        Name of the command's argument that gets the record.
    make : callable
        Makes the record. The names of its parameters are those of the options, and of the groups,
        whose values it gets: click's type of each option is the type of the parameter.
    names : sequence of str, optional
        The names, if they are not those of the parameters.
    *members : option, argument or OptionGroup
        In the order in which the help lists them.
    """

    def __init__(
        self,
        name: str,
        make: Callable[..., Record],
        *members: "Decorator | OptionGroup[object]",
        names: Sequence[str] | None = None,
    ) -> None:
        self.name = name
        self._names = tuple(names or signature(make).parameters)
        self._make, self._members = make, members
        self._groups = [member for member in members if isinstance(member, OptionGroup)]

    def __call__(self, command: Command) -> Command:
        """Add the options to a command."""

        def invoke(**values: Any) -> Any:
            own = self.option_names
            others = {name: value for name, value in values.items() if name not in own}
            return command(**others, **{self.name: self.make_record(values)})

        update_wrapper(invoke, command)
        self._add_options(invoke)
        return invoke  # type: ignore[return-value]  # called by click alone

    def make_record(self, values: Mapping[str, Any]) -> Record:
        """Make the record of the values of options, by the names of click's parameters."""
        known = {**values, **{group.name: group.make_record(values) for group in self._groups}}
        return self._make(**{name: known[name] for name in self._names})

    @property
    def option_names(self) -> frozenset[str]:
        """The names of the options of this group and of the groups in it."""
        nested = {name for group in self._groups for name in group.option_names}
        group_names = {group.name for group in self._groups}
        return frozenset(nested | (set(self._names) - group_names))

    def _add_options(self, command: Callable[..., Any]) -> None:
        for member in reversed(self._members):
            if isinstance(member, OptionGroup):
                member._add_options(command)
            else:
                member(command)
