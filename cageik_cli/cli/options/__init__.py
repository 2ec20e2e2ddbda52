"""Options that commands share, and groups of options that become one record."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import update_wrapper
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, TypeVar

import click
from click.core import ParameterSource

from cageik_cli.cli.command import GroupedOption, HelpGroup, option, spell_param
from cageik_cli.cli.config import apply_config
from cageik_cli.cli.options.types import FrameFormatType, SizeType
from cageik_cli.method.weights.settings import (
    ACCURACIES,
    COORDINATES,
    OUTSIDE_POLICIES,
    BindSettings,
)
from cageik_cli.util.errors import SettingError

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
        self._own_names = _list_names(options)

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
            return make(**own, **nested)

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


def _list_names(options: list[Decorator]) -> set[str]:
    """Return the names of the parameters that decorators of click add."""

    def command() -> None:
        pass

    for add_option in options:
        add_option(command)
    return {str(param.name) for param in _list_params(command)}


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
        raise click.UsageError(str(error)) from error


def common_options(command: Command) -> Command:
    """Add -v, -q and --config."""
    for add_option in (
        option(
            "--config",
            type=PATH_TYPE,
            is_eager=True,
            expose_value=False,
            callback=apply_config,
            help="TOML file with options under [COMMAND]; the command line wins.",
            group=HelpGroup.RUNNING,
        ),
        option(
            "-q",
            "--quiet",
            is_flag=True,
            help="Print only errors and exceeded limits.",
            group=HelpGroup.RUNNING,
        ),
        option(
            "-v",
            "--verbose",
            count=True,
            expose_value=False,
            callback=_remember_verbosity,
            help="Print more; -vv prints the traceback of an error.",
            group=HelpGroup.RUNNING,
        ),
    ):
        add_option(command)
    return command


def _remember_verbosity(ctx: click.Context, param: click.Parameter, value: int) -> None:
    ctx.find_root().meta["verbosity"] = value


def count_processors() -> int:
    """Return how many processors this process may use; the module that knows is slow to import."""
    from cageik_cli.util.threads import count_processors

    return count_processors()


jobs_option = option(
    "--jobs",
    type=click.IntRange(min=1),
    default=count_processors,
    show_default="processors",
    help="Number of threads, or of processes.",
    group=HelpGroup.RUNNING,
)


memory_option = option(
    "--memory",
    type=SizeType(),
    default="1GiB",
    show_default=True,
    help="Memory limit for weights and frame buffers; one block of frames is always held.",
    group=HelpGroup.RUNNING,
)


timings_option = option(
    "--timings",
    type=PATH_TYPE,
    help="Write the seconds of each stage to this JSON file.",
    group=HelpGroup.RUNNING,
)


json_option = option(
    "--json", "json_path", type=PATH_TYPE, help="Write the record as JSON; - is stdout."
)


posed_cage_option = option(
    "--cage-out", "cage_output", type=PATH_TYPE, help="Also write the posed cage (.obj, .ply)."
)


overwrite_option = option("--overwrite", is_flag=True, help="Replace existing outputs.")


output_options = (
    option(
        "--format",
        "file_format",
        type=FrameFormatType(),
        metavar="[obj|ply]",
        help="File format when OUT is a folder.  [default: obj]",
        group=HelpGroup.WRITTEN,
    ),
    option(
        "--recentre",
        is_flag=True,
        help="Move the animation to the origin, and write the offset beside it (OUT.offset.json).",
        group=HelpGroup.WRITTEN,
    ),
    overwrite_option,
)
"""Options of an animation that is written."""


def make_binding_options(defaults: BindSettings | None) -> tuple[Decorator, ...]:
    """Make --coordinates, --accuracy and --outside; without defaults, those of a result hold."""
    tolerances = ", ".join(f"{known.tolerance} {name}" for name, known in ACCURACIES.items())

    def default(name: str) -> dict[str, Any]:
        if defaults is None:
            return {"show_default": "that of the result"}
        return {"default": getattr(defaults, name), "show_default": True}

    return (
        option(
            "--coordinates",
            type=click.Choice(COORDINATES),
            help="Type of coordinates.",
            group=HelpGroup.SOLVE,
            **default("coordinates"),
        ),
        option(
            "--accuracy",
            type=click.Choice(list(ACCURACIES)),
            help="Tolerance of the weights, the mean L1 error of a row: " + tolerances + ".",
            group=HelpGroup.SOLVE,
            **default("accuracy"),
        ),
        option(
            "--outside",
            type=click.Choice(OUTSIDE_POLICIES),
            help="Vertices outside the cage: refuse them, or project them to the nearest point "
            "of the cage.",
            group=HelpGroup.SOLVE,
            **default("outside"),
        ),
    )


BIND_OPTIONS = OptionGroup("bind", BindSettings, *make_binding_options(BindSettings()))


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


def choose_cache_folder(cache: Path | None, no_cache: bool) -> Path | None:
    """Return the folder of the cache; None for none.

    The command line comes before the file of options, then the environment, then the folder of
    the user.
    """
    if is_on_command_line("cache") and is_on_command_line("no_cache"):
        raise click.UsageError("--cache and --no-cache exclude each other; leave one out")
    if no_cache and not is_on_command_line("cache"):
        return None
    named = cache or os.environ.get("CAGEIK_CACHE")
    if named:
        return Path(named)

    from platformdirs import user_cache_path

    return user_cache_path("cageik", appauthor=False)


CACHE_OPTIONS = OptionGroup(
    "cache",
    choose_cache_folder,
    option(
        "--cache",
        type=PATH_TYPE,
        help="Folder of the cache of weights and built cages.  [default: CAGEIK_CACHE, or the "
        "cache folder of the user]",
    ),
    option("--no-cache", is_flag=True, help="Do not use the cache."),
    group=HelpGroup.RUNNING,
)


WEIGHT_OPTIONS: OptionGroup[Any] = OptionGroup(
    "weights", "inputs.weights.WeightSettings", BIND_OPTIONS, CACHE_OPTIONS, jobs_option
)
