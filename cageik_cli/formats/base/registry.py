"""Formats, each a module of its own in `formats`, found by the suffixes that they take."""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

PACKAGE = "cageik_cli.formats"


@cache
def discover_plugins(class_name: str) -> dict[str, Any]:
    """The classes called `class_name` of all modules in `formats`, by the suffixes that they take.

    Modules without one are skipped.
    """
    package = import_module(PACKAGE)
    modules = sorted(module.name for module in iter_modules(package.__path__))
    found = [getattr(import_module(f"{PACKAGE}.{module}"), class_name, None) for module in modules]
    return {suffix: kind for kind in found if kind is not None for suffix in kind.suffixes}
