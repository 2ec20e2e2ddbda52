"""Formats, each a module of its own in `formats`, found by the suffixes that they take."""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

PACKAGE = "cageik_cli.formats"


@cache
def by_suffix(name: str) -> dict[str, Any]:
    """The classes called `name` of all modules in `formats`, by the suffixes that they take.

    Modules without one are skipped.
    """
    folder = import_module(PACKAGE)
    modules = sorted(module.name for module in iter_modules(folder.__path__))
    found = [getattr(import_module(f"{PACKAGE}.{module}"), name, None) for module in modules]
    return {suffix: kind for kind in found if kind is not None for suffix in kind.suffixes}
