"""Settings of commands as keywords of the Python API, which follow from their declarations.

A keyword has the name, the default and the meaning of the field that it sets. It takes what Python
has for what is typed: frames as a slice, several paths as a list.
"""

import inspect
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, replace
from os import PathLike, fspath
from pathlib import Path
from textwrap import fill, indent
from typing import Any, TypeVar, get_args

from cageik_cli.formats.settings import SceneHints
from cageik_cli.formats.timeline import parse_frames
from cageik_cli.formats.write import Output, frame_formats
from cageik_cli.util.calls import FilePath, ShownType, check_argument
from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import Hint
from cageik_cli.util.settings import Setting, show_value
from cageik_cli.util.threads import count_processors

Function = TypeVar("Function", bound=Callable[..., Any])
Record = TypeVar("Record")

SETTINGS_ENTRY = re.compile(r"^\*\*settings\n(?: +.*\n)*", re.MULTILINE)
"""The entry of the settings in a docstring, in whose place their own entries are shown."""


@dataclass(frozen=True, slots=True)
class Keyword:
    """A keyword: its type as help shows it, its default, and what it does."""

    name: str
    shown: str
    default: Any
    text: str


RUN_KEYWORDS = {
    "cache": Keyword("cache", "FilePath | None", None, "Folder of the cache; none by default."),
    "jobs": Keyword("jobs", "int | None", None, "Threads; the number of processors by default."),
}
"""The keywords of fields that have no declared option."""

OUTPUT_KEYWORDS = (
    Keyword("file_format", "str | None", None, "Of the files, if a folder is named; obj if None."),
    Keyword("recentre", "bool", False, "Move the animation to the origin, and write the offset."),
    Keyword("overwrite", "bool", False, "Replace existing outputs."),
)
"""Those of an animation that is written, beside its path."""


def takes_settings(record: type, *others: str) -> Callable[[Function], Function]:
    """Return a decorator for a function with `**settings`, those of a command.

    Its signature and its docstring list them as keywords.

    Parameters
    ----------
    record : type
        The settings of the command.
    *others : str
        Fields that the function sets by itself.
    """

    def decorate(function: Function) -> Function:
        plain = inspect.signature(function)
        own = [one for one in plain.parameters.values() if one.kind is not one.VAR_KEYWORD]
        named = {*others, *(one.name for one in own)}
        keywords = [one for one in list_keywords(record) if one.name not in named]
        parameters = (
            inspect.Parameter(
                one.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=one.default,
                annotation=ShownType(one.shown),
            )
            for one in keywords
        )
        function.__signature__ = plain.replace(  # type: ignore[attr-defined]  # which help reads
            parameters=[*own, *parameters]
        )
        entries = "".join(
            f"{one.name} : {one.shown}\n{indent(fill(one.text, 92), '    ')}\n" for one in keywords
        )
        doc = inspect.cleandoc(function.__doc__ or "")
        function.__doc__ = SETTINGS_ENTRY.sub(lambda _: entries, doc)
        return function

    return decorate


def list_keywords(record: type, chosen: Collection[str] | None = None) -> Iterator[Keyword]:
    """Yield the keywords of the fields of a record, and of the records in it.

    Parameters
    ----------
    chosen : collection of str, optional
        The fields that have keywords; all by default.
    """
    for one in _list_fields(record, chosen):
        setting = one.metadata.get("setting")
        if "chosen" in one.metadata:
            yield from list_keywords(type(one.default), one.metadata["chosen"])
        elif one.type == "Output":
            yield from OUTPUT_KEYWORDS
        elif setting is None:
            yield from (known for name, known in RUN_KEYWORDS.items() if name == one.name)
        elif setting.flags is not None:
            for flag, text in setting.flags.values():
                yield Keyword(_name_flag(flag), "bool", False, _spell_keywords(text))
        else:
            yield Keyword(one.name, _show_type(one, setting), *_describe(one, setting))


def _list_fields(record: type, chosen: Collection[str] | None) -> "list[Field[Any]]":
    return [one for one in fields(record) if chosen is None or one.name in chosen]


def _name_flag(flag: str) -> str:
    return flag.removeprefix("--").replace("-", "_")


def _spell_keywords(text: str) -> str:
    """Return the help of an option with keywords in place of the options that it names."""
    return re.sub(r"--([a-z][a-z-]*)", lambda found: f"`{_name_flag(found[1])}`", text)


def _show_type(one: "Field[Any]", setting: Setting) -> str:
    """Return the type of a keyword as help shows it."""
    if setting.kind == "unit and axis":
        return "str | None"
    if setting.kind == "frames":
        return "slice | str"
    if setting.role == "read as a clip":
        return "FilePath | None"
    if get_args(one.type)[-1:] == (...,):
        kind = "FilePath" if get_args(one.type)[0] is Path else "str"
        return f"{kind} | Sequence[{kind}]"
    return re.sub(r"pathlib\.(\w+\.)?Path", "FilePath", inspect.formatannotation(one.type))


def _describe(one: "Field[Any]", setting: Setting) -> tuple[Any, str]:
    """Return the default of a keyword, and what it does."""
    is_none = one.default is MISSING or isinstance(one.default, SceneHints)
    default = None if is_none else one.default
    text = setting.help
    if setting.is_off:
        text = f"If False: {text[0].lower()}{text[1:]}"
    if setting.choices:
        text += f" One of {', '.join(setting.choices)}."
    return default, _spell_keywords(text + (f" By default: {setting.unset}." * bool(setting.unset)))


def make_settings(record: type[Record], keywords: Mapping[str, Any], **own: Any) -> Record:
    """Make a record of settings of the keywords of a call; what is not given has its default.

    Parameters
    ----------
    keywords : mapping of str to object
        Those of the call.
    **own
        The fields that the function sets by itself.

    Raises
    ------
    SettingError
        When a value is not one of the setting.
    """
    values = _read_values(record, {**keywords, **own}, None)
    return record(**values)


def _read_values(
    record: type, keywords: Mapping[str, Any], chosen: Collection[str] | None
) -> dict[str, Any]:
    """Return the values of the fields that keywords give."""
    values: dict[str, Any] = {}
    for one in _list_fields(record, chosen):
        setting = one.metadata.get("setting")
        if "chosen" in one.metadata:
            nested = _read_values(type(one.default), keywords, one.metadata["chosen"])
            usual: Any = one.default
            values |= {one.name: replace(usual, **nested)} if nested else {}
        elif setting is None and one.name == "jobs":
            values["jobs"] = read_jobs(keywords.get("jobs"))
        elif setting is not None and setting.flags is not None:
            values |= _read_flags(one.name, setting.flags, keywords)
        elif one.name in keywords:
            values[one.name] = _read_value(one, setting, keywords)
    return values


def read_jobs(jobs: Any) -> int:
    """Return a number of threads as it is given, or that of the processors for None.

    Raises
    ------
    SettingError
        When it is not a whole number, or below 1.
    """
    check_argument("jobs", jobs, int | None, ShownType("int | None"))
    if jobs is not None and jobs < 1:
        raise SettingError(Hint("jobs") + f" is {jobs}, expected 1 or more")
    return count_processors() if jobs is None else int(jobs)


def _read_flags(
    name: str, flags: Mapping[str, tuple[str, str]], keywords: Mapping[str, Any]
) -> dict[str, str]:
    """Return the value that a keyword of a flag sets, if one does."""
    given = {value: _name_flag(flag) for value, (flag, _) in flags.items()}
    for word in given.values():
        check_argument(word, keywords.get(word, False), bool, ShownType("bool"))
    chosen = [value for value, word in given.items() if keywords.get(word)]
    if len(chosen) > 1:
        words = (Hint(given[value], True) for value in chosen)
        raise SettingError(next(words) + " and " + next(words) + " exclude each other")
    return {name: chosen[0]} if chosen else {}


def _read_value(one: "Field[Any]", setting: Setting | None, keywords: Mapping[str, Any]) -> Any:
    """Return the value of a field for that of its keyword; the record checks its type."""
    value = keywords[one.name]
    kinds = get_args(one.type) or (one.type,)
    if type(value) is int and float in kinds and int not in kinds:
        return float(value)  # as the command line has it, and files record it
    if one.name == "cache":
        check_argument(one.name, value, FilePath | None, ShownType("FilePath | None"))
    if one.type == "Output":
        return _make_output(value, keywords)
    if setting is not None and setting.kind == "unit and axis":
        if not isinstance(value, str | None):
            expected = "text, such as cm or m,z"
            raise SettingError(Hint(one.name) + f" is {show_value(value)}, expected {expected}")
        return SceneHints() if value is None else SceneHints.parse(value)
    if setting is not None and setting.kind == "frames" and isinstance(value, str | None):
        return slice(None) if value is None else parse_frames(value)
    is_path = Path in (one.type, *get_args(one.type))
    if get_args(one.type)[-1:] == (...,) or one.type == tuple[int, int]:
        listed = [value] if isinstance(value, str | PathLike) else value
        if not isinstance(listed, Sequence):
            return listed
        return tuple(Path(x) if is_path and isinstance(x, str | PathLike) else x for x in listed)
    if isinstance(value, PathLike):
        return Path(value) if is_path else fspath(value)
    return Path(value) if is_path and isinstance(value, str) else value


def _make_output(path: Any, keywords: Mapping[str, Any]) -> Output:
    """Make the output of an animation."""
    given = {one.name: keywords.get(one.name, one.default) for one in OUTPUT_KEYWORDS}
    for name in ("recentre", "overwrite"):
        check_argument(name, given[name], bool, ShownType("bool"))
    known = frame_formats()
    if not (given["file_format"] is None or str(given["file_format"]) in known):
        shown, expected = show_value(given["file_format"]), ", ".join(known)
        raise SettingError(Hint("file_format") + f" is {shown}, expected one of {expected}")
    return Output(Path(path), **given)
