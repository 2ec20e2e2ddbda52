"""The files of a USD stage, checked before USD opens them: plain files only."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cageik_cli.util.errors import FormatError, error_context
from cageik_cli.util.input_files import check_input

MAX_LAYERS = 10_000
"""Layers of a stage; the value clips of a layer do not count."""


def check_layers(path: Path) -> list[Any]:
    """Open the layers that a stage is composed of, and check all files that they name.

    Returns
    -------
    list of Sdf.Layer

    Raises
    ------
    InputError
        When a file is a pipe, a device or a folder, or there are more than `MAX_LAYERS`. USD would
        wait for a pipe, and read a device without end.
    """
    from pxr import Sdf

    found: list[Any] = []
    check_input(path)
    seen, waiting = {str(path)}, [str(path)]
    while waiting:
        layer = Sdf.Layer.FindOrOpen(waiting.pop())
        if layer is None:
            continue  # USD says why
        found.append(layer)
        if len(found) > MAX_LAYERS:
            raise FormatError(f"is composed of more than {MAX_LAYERS} layers; export it as one")
        named = set(_list_named_files(layer)) - seen
        for file in sorted(named):
            with error_context(Path(_split_package(file)).name):
                check_input(Path(_split_package(file)))
        seen |= named
        waiting += sorted(named & set(_list_composed_files(layer)))
    return found


def _list_named_files(layer: Any) -> Iterator[str]:
    """List the files that exist of those that a layer names: layers, value clips, pictures."""
    from pxr import UsdUtils

    for group in UsdUtils.ExtractExternalReferences(layer.identifier):
        yield from _resolve(layer, group)


def _list_composed_files(layer: Any) -> Iterator[str]:
    """List the layers that exist of those that a layer is composed with: not its value clips."""
    from pxr import Sdf

    variables = layer.expressionVariables
    for name in layer.GetCompositionAssetDependencies():
        if Sdf.VariableExpression.IsExpression(name):
            name = Sdf.VariableExpression(name).Evaluate(dict(variables)).value
        if isinstance(name, str):
            yield from _resolve(layer, [name])


def _resolve(layer: Any, names: list[str]) -> Iterator[str]:
    """Return the paths of assets that exist."""
    from pxr import Ar, Sdf

    for name in names:
        if name:
            found = Ar.GetResolver().Resolve(Sdf.ComputeAssetPathRelativeToLayer(layer, name))
            if found:
                yield str(found)


def _split_package(file: str) -> str:
    """Return the file itself, without the name of a member of a package."""
    from pxr import Ar

    return str(Ar.SplitPackageRelativePathOuter(file)[0])
