"""Kinds of file, each with a module of its own in a folder."""

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import Any


def by_suffix(folder: ModuleType, name: str) -> dict[str, Any]:
    """The classes called `name` of a package's modules, by the suffixes that they take."""
    modules = sorted(module.name for module in iter_modules(folder.__path__))
    found = [getattr(import_module(f"{folder.__name__}.{module}"), name) for module in modules]
    return {suffix: kind for kind in found for suffix in kind.suffixes}
