"""Formats by the suffixes of their files.

Each module of `cageik_cli.formats` that has a class `Reader` or `Writer` is a format; nothing else
lists them.
"""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

import cageik_cli.formats


@cache
def discover_plugins(class_name: str) -> dict[str, Any]:
    """Return the classes called `class_name` of all formats, by the suffixes that they take.

    Modules without such a class are skipped.

    Raises
    ------
    ValueError
        When two formats take one suffix.
    """
    package = cageik_cli.formats
    found: dict[str, Any] = {}
    for name in sorted(module.name for module in iter_modules(package.__path__)):
        kind = getattr(import_module(f"{package.__name__}.{name}"), class_name, None)
        for suffix in kind.suffixes if kind is not None else ():
            if found.setdefault(suffix, kind) is not kind:
                raise ValueError(
                    f"{suffix}: both {found[suffix].__module__} and {kind.__module__} are a "
                    f"{class_name} of it"
                )
    return found
