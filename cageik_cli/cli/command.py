"""Commands whose help has its options in groups, and which refuse an option that is repeated."""

from collections import Counter
from collections.abc import Callable
from difflib import get_close_matches
from textwrap import wrap
from typing import Any

import click

from cageik_cli.util.settings import HelpGroup, Setting

MAX_HELP_LINES = 45
"""Lines of a help that shows all options; a longer one describes the first group, and names the
others."""

BLANK_VALUE = "given a value without any letter; give one, or leave it out"
"""What a message says of an option, typed or from a file."""


class GroupedOption(click.Option):
    """An option that stands in a group of the help.

    Attributes
    ----------
    group : HelpGroup, optional
        If absent, that of the `OptionGroup` that holds the option, or the
        first.
    setting : Setting
        What is said of the setting that it sets; of an option that sets none, little.
    """

    def __init__(
        self,
        *args: Any,
        group: HelpGroup | None = None,
        setting: Setting | None = None,
        is_per_clip: bool = True,
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, **kwargs)
        self.group = group
        self.setting = setting or Setting(self.help or "", is_per_clip=is_per_clip)


def option(*names: str, **attributes: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Make the decorator that adds an option to a command: as click does, but with `group`."""
    return click.option(*names, cls=GroupedOption, **attributes)


def find_help_group(param: click.Parameter) -> HelpGroup:
    """Return the group of an option; that of --help, which click adds, is the last."""
    return (
        (param.group or HelpGroup.FIRST) if isinstance(param, GroupedOption) else HelpGroup.RUNNING
    )


class GroupedCommand(click.Command):
    """A command with its options in groups; one that takes one value is given once."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        help_all = GroupedOption(
            ["--help-all"],
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=self._print_full_help,
            is_per_clip=False,
            help="Show what all options do and exit.",
            group=HelpGroup.RUNNING,
        )
        self.params.append(help_all)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words; repeated options are wrong usage, unless a help is asked for."""
        try:
            values, _, typed = self.make_parser(ctx).parse_args(args=list(args))
        except click.NoSuchOption as error:
            nearest = get_close_matches(error.option_name, error.possibilities or (), n=1)
            raise click.NoSuchOption(error.option_name, None, nearest, ctx) from error
        if any(param.is_eager and getattr(param, "is_flag", False) for param in typed):
            return super().parse_args(ctx, args)
        for param in dict.fromkeys(typed):
            held = values.get(str(param.name))
            words = held if isinstance(held, list | tuple) else [held]
            if any(isinstance(word, str) and not word.strip() for word in words):
                raise click.UsageError(f"{spell_param(param)}: {BLANK_VALUE}", ctx)
        counts = Counter(param for param in typed if _takes_one_value(param))
        for param, count in counts.items():
            if count > 1:
                message = f"given {count} times, expected once; leave out all but one"
                raise click.UsageError(f"{' or '.join(param.opts)}: {message}", ctx)
        return super().parse_args(ctx, args)

    def get_help(self, ctx: click.Context) -> str:
        """Return the help; if it is long, only the first group says what its options do."""
        text = super().get_help(ctx)
        if len(text.splitlines()) <= MAX_HELP_LINES:
            return text
        formatter = ctx.make_formatter()
        self.format_usage(ctx, formatter)
        self.format_help_text(ctx, formatter)
        groups = self._list_groups(ctx)
        _write_group(ctx, formatter, HelpGroup.FIRST, groups.pop(HelpGroup.FIRST))
        with formatter.section("More options, which --help-all describes"):
            _write_names(formatter, groups)
        return formatter.getvalue().rstrip("\n")

    def _print_full_help(self, ctx: click.Context, param: click.Parameter, value: bool) -> None:
        if value:
            click.echo(super().get_help(ctx))
            ctx.exit()

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write all options in their groups."""
        for title, params in self._list_groups(ctx).items():
            _write_group(ctx, formatter, title, params)

    def _list_groups(self, ctx: click.Context) -> dict[str, list[click.Option]]:
        """Return the options by their groups; no group is empty."""
        shown = [param for param in self.get_params(ctx) if isinstance(param, click.Option)]
        groups = {
            title: [param for param in shown if find_help_group(param) == title]
            for title in HelpGroup
        }
        return {title: params for title, params in groups.items() if params}


def _takes_one_value(param: click.Parameter) -> bool:
    """Tell whether only one of two values of an option would count; flags have none."""
    return isinstance(param, click.Option) and not (param.multiple or param.count or param.is_flag)


def _write_group(
    ctx: click.Context, formatter: click.HelpFormatter, title: str, params: list[click.Option]
) -> None:
    records = [param.get_help_record(ctx) for param in params]
    with formatter.section(title):
        formatter.write_dl([record for record in records if record is not None])


def _write_names(formatter: click.HelpFormatter, groups: dict[str, list[click.Option]]) -> None:
    """Write what is typed for the options of each group, but not for what prints a help."""
    indent = formatter.current_indent
    column = indent + max(map(len, groups)) + 2
    for title, params in groups.items():
        names = [max(param.opts, key=len) for param in params]
        text = ", ".join(name for name in names if not name.startswith("--help"))
        wrapped = wrap(text, formatter.width - column, break_on_hyphens=False)
        lines = ("\n" + " " * column).join(wrapped)
        formatter.write(f"{' ' * indent}{title:<{column - indent}}{lines}\n")


def spell_param(param: click.Parameter) -> str:
    """Return what is typed for a parameter: its longest option, or an argument in capitals."""
    return max(param.opts, key=len) if param.opts[0][0] == "-" else str(param.name).upper()


def get_verbosity() -> int:
    """Return how many -v were given."""
    return int(click.get_current_context().find_root().meta.get("verbosity", 0))
