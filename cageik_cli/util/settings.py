"""Settings, each declared once: options, checks, records, reports and batches read the declaration.

A record of settings is a frozen dataclass whose fields are made by `declare_setting`, or by
`declare_group` for a record in it. This module knows neither click nor numerics.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from enum import StrEnum
from math import inf
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import Hint, Text, say

DEFAULT_MEMORY = 1 << 30
"""Bytes of weights and frames in memory, if no limit is given."""


MAX_SHOWN = 60
"""Letters of a value that a message shows."""


class HelpGroup(StrEnum):
    """A group of options, by its title in the help; the help has them in this order."""

    FIRST = "Options"
    SOLVE = "Weights and solve"
    FIT = "Fit of the weights"
    CAPTURED = "Captured data"
    CLIP = "Clip and scene"
    WRITTEN = "What is written"
    LIMITS = "Limits"
    RUNNING = "Running"


Role = Literal["read", "read as a clip", "written"]
"""What a value names: a file that is read (a word in its place is none), one or several arguments
of `open_sequence`, or a path or an `Output` that is written."""


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """All that is said of a setting, besides its type and its default, which its field has.

    Attributes
    ----------
    help : str
        What the option does.
    name : str, optional
        In result files; a setting without it is not recorded.
    meaning : str
        What a report says that it is.
    is_recorded_unset : bool
        Whether result files have it also where it has its default.
    option : str, optional
        What is typed, such as `--for`, `-o/--output` or `--player/--no-player`; or an argument in
        capitals. By default it follows from the name in result files, else from that of the field.
    kind : str, optional
        How a value is typed, one of the kinds of `cli.options.types`; by default that of the type.
    is_share : bool
        Whether it is a share of a whole, which is typed and shown in percent.
    typed : str, optional
        The default as it is typed, where `kind` needs it.
    unset : str, optional
        What holds by default, in words: shown in place of the default.
    word : str, optional
        A word that may stand in place of a value; where None is meant by it, it is recorded.
    expected : str
        What the message on a value expects beside the word.
    bare : str, optional
        What an option that is typed without a value stands for.
    metavar : str, optional
        What the help shows in place of a value.
    group : HelpGroup, optional
        In the help; that of the record if absent.
    is_required : bool
        Whether a command line without it is refused, where the field has no default.
    is_off : bool
        Whether the option is a flag that sets it to False.
    choices : collection of str
        The values, if they are few.
    suffixes : collection of str
        In one of which the name of a file ends, in lower case.
    flags : mapping of str to (str, str)
        An option that is a flag, and its help, for each of some values, which exclude one another.
    minimum, maximum, above : float, optional
        Bounds of numbers, the last of which is no value itself.
    refusal : str, optional
        The message on another value, in which `{value}` and `{percent}` stand for it; the option
        then leaves the check of bounds to the record.
    needs : str, optional
        Another field, without which an option is refused.
    needs_message : str
        How; `{}` stands for the option, then for what it needs.
    excludes : tuple of (str, str)
        Fields that do not go together with it, and the messages.
    role : str, optional
        What its value names.
    is_per_clip : bool
        Whether a clip of a batch may have a value of its own.
    may_be_frame : bool
        Whether the file that it names may be a frame of the clip, too.
    """

    help: str
    name: str | None = None
    meaning: str = ""
    is_recorded_unset: bool = True
    option: str | None = None
    kind: str | None = None
    is_share: bool = False
    typed: str | None = None
    unset: str | None = None
    word: str | None = None
    expected: str = ""
    bare: str | None = None
    metavar: str | None = None
    group: HelpGroup | None = None
    is_required: bool = True
    is_off: bool = False
    choices: Collection[str] = ()
    suffixes: Collection[str] = ()
    flags: Mapping[str, tuple[str, str]] | None = None
    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None
    refusal: str | None = None
    needs: str | None = None
    needs_message: str = "{} needs {}; give both, or neither"
    excludes: tuple[tuple[str, str], ...] = ()
    role: Role | None = None
    is_per_clip: bool = True
    may_be_frame: bool = False

    def is_allowed(self, value: Any) -> bool:
        """Return whether a value is one of the choices, or in its bounds."""
        if _is_word(value, self):
            return True
        if self.choices:
            return value in self.choices
        if self.suffixes:
            return Path(value).suffix.lower() in self.suffixes
        if (self.minimum, self.maximum, self.above) == (None, None, None):
            return True
        least = self.minimum is None or value >= self.minimum  # nan is not
        most = self.maximum is None or value <= self.maximum
        return bool(least and most and (self.above is None or value > self.above) and value != inf)

    def describe_allowed(self, kind: type) -> str:
        """Return in words which values are allowed; "" for all of the type."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        if self.suffixes:
            return f"a name that ends in {' or '.join(self.suffixes)}"
        if (self.minimum, self.maximum, self.above) == (None, None, None):
            return ""
        if self.minimum is not None and self.maximum is not None:
            return f"{self.minimum:g} to {self.maximum:g}"
        if kind is int:
            return f"{self.minimum} or more"
        return "a finite number" + (
            ", zero or above" if self.above is None else f" above {self.above:g}"
        )


def declare_setting(
    default: Any,
    text: str,
    *,
    factory: Any = MISSING,
    **said: Any,
) -> Any:
    """Return a field of a record of settings, with all that is said of it.

    Parameters
    ----------
    default : object
        `MISSING` for a field that has to be given.
    text : str
        The help of the option.
    factory : callable, optional
        Makes the default, in its place.
    **said
        The other attributes of `Setting`.
    """
    setting = {"setting": Setting(text, **said)}
    if factory is not MISSING:
        return field(default_factory=factory, metadata=setting)
    return field(default=default, metadata=setting)


def repeat_setting(record: type, field_name: str, default: Any = ..., **changes: Any) -> Any:
    """Return a field as another record has it, with another default or with other words."""
    (known,) = (one for one in fields(record) if one.name == field_name)
    chosen = known.default if default is ... else default
    return field(
        default=chosen, metadata={"setting": replace(known.metadata["setting"], **changes)}
    )


def declare_group(
    default: Any, chosen: Mapping[str, Mapping[str, Any]] | None = None, *, kw_only: bool = False
) -> Any:
    """Return a field that is a record of settings, whose options a command has.

    Parameters
    ----------
    default : record
    chosen : mapping, optional
        The fields that have options here, in the order of the help, with what is said of them in
        other words; all by default.
    kw_only : bool
        Whether it is given by keyword.
    """
    return field(default=default, metadata={"chosen": chosen}, kw_only=kw_only)


def list_settings(record: Any) -> Iterator[tuple["Field[Any]", Setting]]:
    """Yield the fields of a record, or of a class, that are settings, and what is said of them."""
    for one in fields(record):
        if "setting" in one.metadata:
            yield one, one.metadata["setting"]


def find_kind(setting: "Field[Any]") -> type:
    """Return the type of the values of a setting, besides None and words."""
    kinds = [one for one in get_args(setting.type) or (setting.type,) if isinstance(one, type)]
    return next((one for one in kinds if one is not NoneType), str)


def _is_word(value: Any, setting: Setting) -> bool:
    """Return whether a value is the word that may stand in its place; an array is none."""
    return isinstance(value, str) and value == setting.word


def matches(value: Any, annotation: Any) -> bool:
    """Return whether a value is of a type; numbers of NumPy are numbers, and names are paths.

    A type that is stated by its name alone, and one that this module does not know, has any value.
    """
    kinds = get_args(annotation)
    if get_origin(annotation) in (Union, UnionType):
        return any(matches(value, kind) for kind in kinds)
    if get_origin(annotation) is Literal:
        return isinstance(value, str) and value in kinds
    if get_origin(annotation) is tuple:
        if not isinstance(value, tuple):
            return False
        ones = kinds[:1] * len(value) if kinds[-1] is ... else kinds
        return len(value) == len(ones) and all(map(matches, value, ones))
    if annotation in (None, NoneType):
        return value is None
    if get_origin(annotation) is Sequence:
        is_sequence = isinstance(value, Sequence) and not isinstance(value, str)
        return is_sequence and all(matches(one, kinds[0]) for one in value)
    annotation = get_origin(annotation) or annotation
    if annotation is Any or not isinstance(annotation, type):
        return True
    is_flag = isinstance(value, bool) or getattr(value, "dtype", None) == "bool"
    if annotation in (int, float):
        return isinstance(value, Integral if annotation is int else Real) and not is_flag
    if annotation is bool:
        return is_flag
    return isinstance(value, str | PathLike if annotation is Path else annotation)


def show_value(value: Any) -> str:
    """Return a value as messages show it: what is long, such as an array, by its type alone."""
    if isinstance(value, int) and abs(value) >= 10**MAX_SHOWN:  # Python writes no endless ones
        return f"a whole number of {value.bit_length()} bits"
    if isinstance(value, int | float):
        return str(value)
    shown = repr(value)
    return shown if len(shown) <= MAX_SHOWN and shown.isprintable() else f"a {type(value).__name__}"


def describe_type(annotation: Any) -> str:
    """Return in words which values are of a type."""
    kinds = get_args(annotation)
    if get_origin(annotation) in (Union, UnionType):
        return " or ".join(describe_type(kind) for kind in kinds)
    if get_origin(annotation) is Literal:
        return " or ".join(kinds)
    if get_origin(annotation) is tuple:
        kind = describe_type(kinds[0])
        return f"a tuple, each {kind}" if kinds[-1:] == (...,) else f"{len(kinds)} values, {kind}"
    words = {bool: "True or False", int: "a whole number", float: "a number", str: "text"}
    words |= {Path: "a path", NoneType: "None"}
    return words.get(annotation) or f"a {getattr(annotation, '__name__', annotation)}"


def check_settings(record: Any) -> None:
    """Refuse values that are not allowed, and settings that do not go together.

    Raises
    ------
    SettingError
        In the words of the declaration.
    """
    for one, setting in list_settings(record):
        value = getattr(record, one.name)
        kinds = {*(get_args(one.type) or (one.type,))}
        # Where the type has no words, None stands for the word of the command line.
        is_word = _is_word(value, setting) and not kinds <= {int, float, NoneType}
        is_misread = not (is_word or matches(value, one.type))
        is_unset = value is None and NoneType in kinds
        if is_misread or not (is_unset or setting.is_allowed(value)):
            if setting.refusal is not None and not is_misread:
                refusal = say(setting.refusal)
                raise SettingError(refusal.format(value=value, percent=100 * value))
            expected = setting.describe_allowed(find_kind(one)) or describe_type(one.type)
            raise SettingError(Hint(one.name) + f" is {show_value(value)}, expected {expected}")
    defaults = {one.name: one.default for one in fields(record)}
    for one, setting in list_settings(record):
        is_given = getattr(record, one.name) not in (None, defaults[one.name])
        if setting.needs is not None and is_given and not getattr(record, setting.needs):
            first, between, *after = setting.needs_message.split("{}")
            needed = Hint(setting.needs) if after else ""
            raise SettingError(Text(first, Hint(one.name), between, needed, *after))
        for other, message in setting.excludes:
            values = {name: getattr(record, name) for name in (one.name, other)}
            if all(value != defaults[name] for name, value in values.items()):
                raise SettingError(say(message).format(**values))


def describe_settings(record: Any) -> dict[str, Any]:
    """Return the settings of a record as result files have them, by their names there."""
    described = {}
    for one, setting in list_settings(record):
        value = getattr(record, one.name)
        if setting.name is not None and (setting.is_recorded_unset or value != one.default):
            recorded = setting.word if value is None else value
            # As it is read back from JSON, so that a resumed run knows its settings.
            described[setting.name] = list(recorded) if isinstance(recorded, tuple) else recorded
    return described


def restore_settings(record: type, described: Mapping[str, Any]) -> Any:
    """Return the settings of a record that `describe_settings` described among others.

    What is not described has its default.

    Raises
    ------
    SettingError
        When a value is not allowed.
    """
    values = {}
    for one, setting in list_settings(record):
        if setting.name is None or setting.name not in described:
            continue
        value = described[setting.name]
        if isinstance(value, list):
            value = tuple(value)
        # A word that the type does not have stands for None.
        values[one.name] = (
            None if _is_word(value, setting) and not matches(value, one.type) else value
        )
    return record(**values)


def show_settings(record: Any) -> dict[str, Any]:
    """Return all settings of a record by the names of its fields; shares in percent."""
    return {
        f"{one.name}_percent" if setting.is_share else one.name: (
            100 * getattr(record, one.name) if setting.is_share else getattr(record, one.name)
        )
        for one, setting in list_settings(record)
    }


def list_meanings(*records: type) -> dict[str, str]:
    """Return what the settings of some records are, by their names in result files."""
    return {
        setting.name: setting.meaning
        for record in records
        for _, setting in list_settings(record)
        if setting.name is not None
    }
