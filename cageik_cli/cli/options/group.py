"""Options that follow from declared settings, and groups of options that become one record."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, Field, fields, replace
from functools import update_wrapper
from importlib import import_module
from pathlib import Path
from types import NoneType
from typing import Any, Generic, TypeVar, get_args

import click
from click.core import ParameterSource

from cageik_cli.cli.command import GroupedOption, option, spell_param
from cageik_cli.cli.group import spell_error
from cageik_cli.cli.options.types import KINDS, OrWord, PercentType, SuffixedPath
from cageik_cli.util.errors import SettingError
from cageik_cli.util.settings import HelpGroup, Setting, find_kind

Record = TypeVar("Record", covariant=True)
Command = TypeVar("Command", bound=Callable[..., Any])
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

PATH_TYPE = click.Path(path_type=Path)


class OptionGroup(Generic[Record]):
    """A decorator that adds options to a command and gives it the record that they make.

    Parameters
    ----------
    name : str
        Name of the command's argument that gets the record, or of the field of another record.
    make : callable or str
        Makes the record of the values of its members, by their names: usually the class of the
        record, whose fields have the names of click's parameters. A class that is slow to import is
        named by its place below `cageik_cli`.
    *members : option, argument or OptionGroup
        In the order in which the help lists them.
    group : HelpGroup, optional
        That of the members in the help, unless they name one.
    """

    def __init__(
        self,
        name: str,
        make: Callable[..., Record] | str,
        *members: "Decorator | OptionGroup[object]",
        group: HelpGroup | None = None,
    ) -> None:
        self.name, self._group = name, group
        self._make, self._members = make, members
        self._groups = [member for member in members if isinstance(member, OptionGroup)]
        options = [member for member in members if not isinstance(member, OptionGroup)]
        params = _list_params_of(options)
        self._own_names = {str(param.name) for param in params}
        self._needing = [
            (param.setting, str(param.name))
            for param in params
            if isinstance(param, GroupedOption) and param.setting.needs is not None
        ]

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
        """Make the record of the values of options, by the names of click's parameters.

        Raises
        ------
        click.UsageError
            When the record refuses the values.
        """
        own = {name: values[name] for name in self._own_names}
        nested = {group.name: group.make_record(values) for group in self._groups}
        make = _import_class(self._make) if isinstance(self._make, str) else self._make
        with usage_errors():
            record = make(**own, **nested)
        # Values that are wrong by themselves, or exclude each other, come before what is missing.
        self._check_needs(values)
        return record

    def _check_needs(self, values: Mapping[str, Any]) -> None:
        """Refuse options that are given without another that they need."""
        for setting, name in self._needing:
            needed = str(setting.needs)
            if is_given(name) and not values[needed]:
                words = name_option(name), name_option(needed)
                raise click.UsageError(setting.needs_message.format(*words))

    @property
    def option_names(self) -> frozenset[str]:
        """The names of the options of this group and of the groups in it."""
        nested = {name for group in self._groups for name in group.option_names}
        return frozenset(nested | self._own_names)

    def _add_options(self, command: Callable[..., Any]) -> None:
        before = len(_list_params(command))
        for member in reversed(self._members):
            if isinstance(member, OptionGroup):
                member._add_options(command)
            else:
                member(command)
        for param in _list_params(command)[before:]:
            if isinstance(param, GroupedOption):
                param.group = param.group or self._group


def _list_params_of(options: list[Decorator]) -> list[click.Parameter]:
    """Return the parameters that decorators of click add."""

    def command() -> None:
        pass

    for add_option in options:
        add_option(command)
    return _list_params(command)


def _list_params(command: Callable[..., Any]) -> list[click.Parameter]:
    """Return the parameters that decorators of click have added to a command, the last first."""
    return list(getattr(command, "__click_params__", ()))


def _import_class(place: str) -> Callable[..., Any]:
    module, _, name = place.rpartition(".")
    found: Callable[..., Any] = getattr(import_module(f"cageik_cli.{module}"), name)
    return found


@contextmanager
def usage_errors() -> Iterator[None]:
    """Make wrong usage (exit code 2) of errors of settings that are raised inside."""
    try:
        yield
    except SettingError as error:
        raise click.UsageError(spell_error(error)) from error


def list_options(
    record: type,
    chosen: Mapping[str, Mapping[str, Any]] | None = None,
    **made: "Decorator | OptionGroup[Any]",
) -> "Iterator[Decorator | OptionGroup[Any]]":
    """Yield the options of the settings of a record, and groups of those of the records in it.

    Parameters
    ----------
    chosen : mapping, optional
        The fields that have options, in the order of the help, with what is said of them in other
        words; all by default.
    **made : option or OptionGroup
        Those of fields whose values are made in another way.
    """
    known = {one.name: one for one in fields(record)}
    for one in (known[name] for name in chosen or known):
        if one.name in made:
            yield made[one.name]
        elif "setting" in one.metadata:
            said = (chosen or {}).get(one.name, {})
            yield _make_member(one, replace(one.metadata["setting"], **said))
        elif "chosen" in one.metadata:
            nested = type(one.default)
            members = list_options(nested, one.metadata["chosen"], **made)
            yield OptionGroup(one.name, nested, *members)


def _make_member(one: "Field[Any]", setting: Setting) -> "Decorator | OptionGroup[Any]":
    """Make the option of a setting, or the flags that it has in place of one."""
    typed = setting.option or f"--{(setting.name or one.name).replace('_', '-')}"
    shared: dict[str, Any] = {"setting": setting, "group": setting.group}
    if setting.flags is not None:
        flags = {name: value for value, (name, _) in setting.flags.items()}
        members = (
            option(*flag, is_flag=True, help=text, **shared)
            for *flag, text in setting.flags.values()
        )
        return OptionGroup(
            one.name, lambda **given: _choose_flag(flags, one.default, given), *members
        )
    if not typed.startswith("-"):
        return _make_argument(one, typed, setting.is_required)
    kind = find_kind(one)
    if setting.is_off:
        return OptionGroup(
            one.name, negate, option(typed, is_flag=True, help=setting.help, **shared)
        )
    words = [typed] if kind is bool else typed.split("/")
    if kind is bool and one.default is True and "/" not in typed:
        words = [f"{typed}/--no-{typed.removeprefix('--')}"]
    text = setting.help + (f"  [default: {setting.unset}]" if setting.unset else "")
    if kind is bool and "/" not in words[0]:
        return option(*words, one.name, is_flag=True, help=text, **shared)
    return option(*words, one.name, help=text, **shared, **_describe_value(one, setting))


def _make_argument(one: "Field[Any]", name: str, is_required: bool) -> Decorator:
    """Make the argument of a field."""
    return click.argument(
        one.name,
        metavar=None if name == one.name.upper() else name,
        type=PATH_TYPE if find_kind(one) is Path else None,
        nargs=-1 if _takes_many(one) else 1,
        required=is_required and one.default is MISSING,
    )


def _takes_many(one: "Field[Any]") -> bool:
    """Tell whether a field is a tuple of any number of values."""
    return get_args(one.type)[-1:] == (...,)


def _describe_value(one: "Field[Any]", setting: Setting) -> dict[str, Any]:
    """Return what click has to know of the values of an option."""
    default = one.default if setting.typed is None else setting.typed
    if setting.is_share:
        default = format_share(one.default)
    described: dict[str, Any] = {"type": _choose_type(one, setting), "metavar": setting.metavar}
    if _takes_many(one):
        return described | {"multiple": True}
    if one.default is MISSING and setting.typed is None:
        is_needed = setting.is_required and NoneType not in get_args(one.type)
        return described | {"required": is_needed}
    if setting.bare is not None:
        described |= {"is_flag": False, "flag_value": setting.bare}
    if default is None:
        return described
    return described | {"default": default, "show_default": not setting.unset}


def format_share(share: Any) -> str:
    """Return a share of a whole as it is typed."""
    return f"{100 * share:g}%"


def _choose_type(one: "Field[Any]", setting: Setting) -> Any:
    """Return the type of click for the values of a setting."""
    kind, is_checked = find_kind(one), setting.refusal is not None
    if setting.kind is not None:
        return KINDS[setting.kind]
    if setting.is_share:
        return PercentType(f"a {one.name}", format_share(one.default), unit=100)
    if setting.suffixes:
        return SuffixedPath(*setting.suffixes)
    if setting.choices:
        return click.Choice(setting.choices)
    known: Any = PATH_TYPE if kind is Path else click.types.convert_type(kind)
    if kind is int and not is_checked and (setting.minimum, setting.maximum) != (None, None):
        known = click.IntRange(setting.minimum, setting.maximum)  # type: ignore[arg-type]  # whole
    return known if setting.word is None else OrWord(known, setting.word, setting.expected)


def _choose_flag(flags: Mapping[str, str], default: Any, given: Mapping[str, bool]) -> Any:
    """Return the value that a flag sets; two flags are wrong usage."""
    typed = [name for name in flags if given[name.removeprefix("--").replace("-", "_")]]
    if len(typed) > 1:
        raise click.UsageError(f"{' and '.join(typed)} exclude each other; leave one out")
    return flags[typed[0]] if typed else default


def is_on_command_line(name: str) -> bool:
    """Tell whether an option was given on the command line."""
    source = click.get_current_context().get_parameter_source(name)
    return source is ParameterSource.COMMANDLINE


def is_given(name: str) -> bool:
    """Tell whether an option was given on the command line or in a file of options."""
    source = click.get_current_context().get_parameter_source(name)
    return source in (ParameterSource.COMMANDLINE, ParameterSource.DEFAULT_MAP)


def name_option(name: str) -> str:
    """Return how an option of the command that runs is typed."""
    params = click.get_current_context().command.params
    return next(spell_param(param) for param in params if param.name == name)


def refuse_options(
    names: Iterable[str], message: str, is_named: Callable[[str], bool] = is_given
) -> None:
    """Refuse options that are given where they mean nothing.

    Parameters
    ----------
    message : str
        Why, and what to do; `{}` stands for the option as it is typed.
    is_named : callable
        Tells whether an option is given: `is_on_command_line` lets files of options have it.
    """
    for name in filter(is_named, names):
        raise click.UsageError(message.replace("{}", name_option(name)))


def negate(**flag: bool) -> bool:
    """Return the opposite of a flag: `--no-X` sets X."""
    (is_set,) = flag.values()
    return not is_set
