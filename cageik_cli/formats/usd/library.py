"""Errors and warnings of USD: errors are converted, warnings kept instead of printed."""

import mmap
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cageik_cli.formats.base.files import require_unicode
from cageik_cli.util.errors import FormatError, error_context, require_optional
from cageik_cli.util.files import check_input, open_content, open_input
from cageik_cli.util.messages import Said
from cageik_cli.util.text import to_unicode
from cageik_cli.util.trial import trials

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")

MAX_LAYERS = 10_000
"""Layers of a stage; the value clips of a layer do not count."""

MAX_PRIMS = 1_000_000
"""Prims of a stage; references to references multiply them."""

MAX_NESTING = 500
"""Brackets inside each other in the text of a layer.

USD crashes at tens of thousands of braces, and does not end for as many others.
"""


def require_usd(purpose: str) -> None:
    """Raise MissingLibraryError without usd-core, which is needed for a purpose."""
    with require_optional("usd-core", purpose):
        import pxr  # noqa: F401


@contextmanager
def capture_diagnostics(make_error: Callable[[str], Exception]) -> Iterator[list[Said]]:
    """Yield a list that gets the warnings of USD when the block ends.

    An error that USD raises in the block is converted by `make_error`.
    """
    from pxr import Tf

    warnings: list[Said] = []
    with Tf.DiagnosticTrap() as trap:
        try:
            yield warnings
        except Tf.ErrorException as error:
            raise make_error(_format_diagnostic(error.args[0])) from error
        except Tf.CppException as error:  # with the calls that led to it, in many lines
            raise make_error(str(error).strip().split("\n")[0]) from error
        except UnicodeDecodeError as error:
            raise make_error("its text is not UTF-8") from error
        finally:
            warnings += (f"USD warns: {_format_diagnostic(each)}" for each in trap.GetWarnings())
            trap.Clear()


def _format_diagnostic(diagnostic: Any) -> str:
    """Return one line without folders, memory addresses and names of parser rules."""
    try:
        text = " ".join(diagnostic.commentary.split())
    except UnicodeDecodeError:
        return "its text is not UTF-8"
    return _format_diagnostic_text(text)


def _format_diagnostic_text(text: str) -> str:
    text = re.sub(r" matching pxrInternal.*? at ", " at ", text)
    text = re.sub(r" \(\w+ stage on stage .*\)$", "", text)
    return re.sub(r"@([^@]*)@", lambda layer: Path(layer[1]).name, text)


class _Variables:
    """The variables of the expressions that name files in the layers of one stack.

    A stack has those of its root layer, beside those of the stacks that refer to it, which are
    stronger. Sublayers have none of their own.
    """

    def __init__(self, values: dict[str, Any]) -> None:
        self._values, self.key = values, repr(sorted(values.items()))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Variables) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    def enter(self, layer: Any) -> "_Variables":
        """Return those of the stack whose root is a layer that a layer with these refers to."""
        own = layer.expressionVariables
        return _Variables({**own, **self._values}) if own else self

    def find_files(self, layer: Any, names: Iterable[Any]) -> Iterator[str]:
        """List the files that names in a layer are of, as far as they exist."""
        from pxr import Sdf

        for name in names:
            if Sdf.VariableExpression.IsExpression(name):
                name = Sdf.VariableExpression(name).Evaluate(self._values).value
            if isinstance(name, str):
                yield from _resolve(layer, [name])


def check_layers(path: Path) -> list[Any]:
    """Open the layers that a stage is composed of, and check all files that they name.

    Returns
    -------
    list of Sdf.Layer

    Raises
    ------
    InputError
        When a file is a pipe, a device or a folder, or there are more than `MAX_LAYERS` layers or
        `MAX_PRIMS` prims. USD would wait for a pipe, read a device without end, and compose prims
        until memory ends.
    """
    from pxr import UsdUtils

    open_content(path).close()
    _check_nesting(path)
    name = require_unicode(path)
    layers: dict[str, Any] = {}
    root = name, _Variables({}), False  # its file, the stronger variables, whether a sublayer
    checked, seen, waiting = {name}, {root}, [root]
    while waiting:
        name, variables, is_sublayer = waiting.pop()
        layer = layers[name] if name in layers else layers.setdefault(name, _open_layer(name, path))
        if layer is None:
            continue  # USD says why
        variables = variables if is_sublayer else variables.enter(layer)
        below = set(layer.subLayerPaths)
        others = set(layer.GetCompositionAssetDependencies()) - below
        composed = {(file, variables, True) for file in variables.find_files(layer, below)}
        composed |= {(file, variables, False) for file in variables.find_files(layer, others)}
        groups = UsdUtils.ExtractExternalReferences(layer.identifier)  # with clips and pictures
        named = {file for group in groups for file in _resolve(layer, group)}
        named |= {file for file, _, _ in composed}
        _check_named(named - checked)
        checked |= named
        waiting += sorted(composed - seen, key=lambda one: (one[0], one[1].key, one[2]))
        seen |= composed
        if len(seen) > MAX_LAYERS:
            raise _make_layers_error()
    found = [layer for layer in layers.values() if layer is not None]
    try:
        count = _PrimCounter().count_stage(found[0]) if found else 0
    except RecursionError as error:
        raise FormatError("its references are nested too deeply; export the mesh alone") from error
    if count > MAX_PRIMS:
        raise _make_prims_error()
    return found


def _make_layers_error() -> FormatError:
    return FormatError(f"is composed of more than {MAX_LAYERS} layers; export it as one")


def _open_layer(name: str, stage: Path) -> Any:
    """Open a layer as its file is now; None if it is that of the stage, and not sound."""
    from pxr import Sdf

    held = Sdf.Layer.Find(name)
    is_stage = name == require_unicode(stage)
    layer = Sdf.Layer.FindOrOpen(name) if is_stage else _open_named(name, stage)
    if held is not None and not held.dirty:  # edits of someone else stay
        held.Reload()  # the file may have changed since another clip opened it
    if layer is not None:
        layer.Reload()  # if it is open already, and its file was written again since
    return layer


def _open_named(name: str, stage: Path) -> Any:
    """Open a layer that others name; what is wrong with it is said of it."""
    from pxr import Sdf

    def make_error(cause: str) -> FormatError:
        if _split_package(name).lower().endswith(".abc"):  # some builds of USD read them
            return FormatError(
                "is an Alembic archive, which usd-core does not read; give the archive itself, or "
                "convert it to USD"
            )
        return FormatError(word_unsound(cause))

    file = Path(_split_package(name))
    with error_context(shorten_path(name, stage)), capture_diagnostics(make_error):
        if file.suffix.lower() in (*USD_SUFFIXES, ".abc"):  # others may well be XML
            open_content(file).close()
        return Sdf.Layer.FindOrOpen(name)


def word_unsound(cause: str) -> str:
    """Say what is wrong with a file that USD cannot read."""
    return f"is not a sound USD file ({cause}); export it again"


def shorten_path(name: str, stage: Path) -> str:
    """Return the path of a file that a stage is composed of, from the folder of the stage on."""
    file = Path(name)
    folder = stage.parent.resolve()
    return to_unicode(str(file.relative_to(folder) if file.is_relative_to(folder) else file))


def list_missing(stage: Any, path: Path) -> dict[str, str]:
    """Say which files and prims a stage is composed of are not there, by what USD says of each.

    These are the sublayers, the references and payloads of the variants that are chosen, and the
    value clips.
    """
    from pxr import Pcp, Usd

    missing: dict[str, str] = {}
    for error in stage.GetCompositionErrors():
        said = _format_diagnostic_text(str(error))
        names = re.search(r"@([^@]*)@(?:<([^>]*)>)?", str(error))
        if names is None:
            continue
        file, prim = shorten_path(names[1], path), names[2]
        if error.errorType == Pcp.ErrorType_UnresolvedPrimPath:
            what = (
                f"{'the default prim' if prim == 'defaultPrim' else f'the prim {prim}'} of {file}"
            )
        elif error.errorType in (
            Pcp.ErrorType_InvalidAssetPath,
            Pcp.ErrorType_InvalidSublayerPath,
        ):
            what = file
        else:
            continue
        above = str(error.rootSite.path)
        by = f"{above} refers to" if above != "/" else "has the sublayer"
        missing[said] = f"{by} {what}, which is not there"
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if not prim.HasAuthoredMetadata("clips"):
            continue
        clips = Usd.ClipsAPI(prim)
        for name in clips.GetClips() or ():
            for asset in clips.ComputeClipAssetPaths(name):
                if not asset.resolvedPath:
                    file = shorten_path(asset.path, path)
                    text = f"{prim.GetPath()} has the value clip {file}, which is not there"
                    missing[f"{prim.GetPath()} {file}"] = text
    return dict(sorted(missing.items()))  # USD composes in several threads


def _check_named(files: set[str]) -> None:
    """Refuse files that layers name, before USD opens them."""
    for file in sorted(files):
        named_file = Path(_split_package(file))
        with error_context(named_file.name):
            check_input(named_file)
            trials.allow(named_file.stat().st_size)
            _check_nesting(named_file)


def _check_nesting(path: Path) -> None:
    """Refuse a text whose brackets are nested more than `MAX_NESTING` levels deep."""
    with open_input(path) as file:
        if file.read(5) != b"#usda":
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as text:
            if _is_nested_deeply(text):
                raise FormatError(
                    f"is nested more than {MAX_NESTING} levels deep; export the mesh alone"
                )


def _is_nested_deeply(text: mmap.mmap) -> bool:
    """Tell whether the brackets of a text are nested more than `MAX_NESTING` levels deep."""
    # Texts, names of files and comments, which may hold braces; and braces.
    words = (
        rb"""\"""(?:[^\\]|\\.)*?\"""|\'\'\'(?:[^\\]|\\.)*?\'\'\'|"(?:[^"\\\n]|\\.)*"|"""
        rb"""\'(?:[^\'\\\n]|\\.)*\'|@@@.*?@@@|@[^@\n]*@|\#[^\n\r]*|\{|\}"""
    )
    depth = 0
    for brace in re.finditer(words, text, re.DOTALL):
        depth += (brace[0] == b"{") - (brace[0] == b"}")
        if depth > MAX_NESTING:
            return True
    open_brackets = rb"(?:[(\[][^()\[\]]*+){%d}" % (MAX_NESTING + 1)  # one after another
    return re.search(open_brackets, text) is not None


class _PrimCounter:
    """Bounds the prims of composed layers, without composing them, and refuses cycles.

    Each prim counts once in its stack of layers and once for each reference, payload, inherit,
    specialize and variant that brings it in. USD composes every way through a cycle that meets no
    prim twice, and these may be any number.
    """

    def __init__(self) -> None:
        self._prims: dict[tuple[str, str, _Variables], int | None] = {}  # None while one is counted
        self._places: dict[tuple[str, str, _Variables], int | None] = {}
        self._stacks: dict[tuple[str, _Variables], list[Any]] = {}

    def count_stage(self, layer: Any) -> int:
        """Bound the prims of a stage by its root layer."""
        return self._count_at(layer, layer.pseudoRoot.path, _Variables({}).enter(layer))

    def _count_at(self, root: Any, path: Any, variables: _Variables) -> int:
        """Bound the prims at and below a path in the stack of a root layer; 0 for none there."""
        key = root.identifier, str(path), variables
        return _count_once(self._places, key, self._count_ways(root, path, variables))

    def _count_ways(self, root: Any, path: Any, variables: _Variables) -> Iterator[int]:
        """Yield a bound for each way in which prims come to a path in the stack of a root layer.

        They may be there because layers or variants say so; because a prim above refers to others,
        which have them at the rest of the path; and because they are relocated to there.
        """
        stack = self._find_stack(root, variables)
        for old, new in (pair for layer in stack for pair in layer.relocates):
            if new and path.HasPrefix(new):
                yield self._count_at(root, path.ReplacePrefix(new, old), variables)
        specs = [layer.pseudoRoot for layer in stack]
        for prefix in path.GetPrefixes():
            specs = _add_variants(specs)
            for target, place, values in self._list_targets(root, specs, variables):
                moved = path.ReplacePrefix(prefix.GetParentPath(), place)
                yield self._count_at(target, moved, values)
            specs = [part for spec in specs if (part := spec.nameChildren.get(prefix.name))]
        for parts in _group_by_path(specs):
            yield self._count(root, parts, variables)

    def _find_stack(self, root: Any, variables: _Variables) -> list[Any]:
        key = root.identifier, variables
        if key not in self._stacks:
            self._stacks[key] = self._list_stack(root, variables, ())
        return self._stacks[key]

    def _list_stack(self, layer: Any, variables: _Variables, above: tuple[str, ...]) -> list[Any]:
        """List a layer and its sublayers, each once for every layer that has it."""
        from pxr import Sdf

        if layer.identifier in above:
            raise FormatError(
                f"{Path(layer.identifier).name} is a sublayer of itself; export it as one layer"
            )
        stack = [layer]
        for file in variables.find_files(layer, layer.subLayerPaths):
            below = Sdf.Layer.Find(file)
            if below is not None:
                stack += self._list_stack(below, variables, (*above, layer.identifier))
            if len(stack) > MAX_LAYERS:
                raise _make_layers_error()
        return stack

    def _count(self, root: Any, specs: list[Any], variables: _Variables) -> int:
        """Bound the prims at and below one, by what the layers of a stack say of it."""
        key = root.identifier, str(specs[0].path), variables
        return _count_once(self._prims, key, self._count_parts(root, specs, variables))

    def _count_parts(self, root: Any, specs: list[Any], variables: _Variables) -> Iterator[int]:
        """Yield 1 for a prim, and a bound for each child, each arc and each variant of it."""
        yield 1
        parts = [child for spec in specs for child in spec.nameChildren]
        for group in _group_by_path(parts + _list_variants(specs)):
            yield self._count(root, group, variables)
        for target, path, values in self._list_targets(root, specs, variables):
            yield self._count_at(target, path, values)

    def _list_targets(
        self, root: Any, specs: list[Any], variables: _Variables
    ) -> Iterator[tuple[Any, Any, _Variables]]:
        """List what prims of a stack refer to: root layer, path in its stack, and its variables.

        A reference or a payload without a path names the default prim.
        """
        from pxr import Sdf

        for spec in specs:
            for arcs in (spec.referenceList, spec.payloadList):
                for arc in arcs.GetAddedOrExplicitItems():
                    target, values = root, variables
                    if arc.assetPath:
                        files = variables.find_files(spec.layer, [arc.assetPath])
                        found = (layer for file in files if (layer := Sdf.Layer.Find(file)))
                        target = next(found, None)
                        if target is None:
                            continue  # USD says that it is not there
                        values = variables.enter(target)
                    path = arc.primPath or target.GetDefaultPrimAsPath()
                    if path:
                        yield target, path, values
            for paths in (spec.inheritPathList, spec.specializesList):
                for path in paths.GetAddedOrExplicitItems():
                    yield root, path, variables


def _count_once(
    counts: dict[tuple[str, str, _Variables], int | None],
    key: tuple[str, str, _Variables],
    parts: Iterator[int],
) -> int:
    """Add up the parts of a prim or a path of a layer, at most `MAX_PRIMS` of either."""
    if key not in counts:
        if len(counts) >= MAX_PRIMS:
            raise _make_prims_error()
        counts[key] = None
        counts[key] = sum(parts)
    count = counts[key]
    if count is None:
        raise FormatError(
            f"{key[1]} of {Path(key[0]).name} refers to itself, or to what holds it; "
            "export the mesh alone"
        )
    return count


def _make_prims_error() -> FormatError:
    return FormatError(f"its references make more than {MAX_PRIMS} prims; export the mesh alone")


def _list_variants(specs: list[Any]) -> list[Any]:
    """List what the variants of prims say of them, but not the variants inside of those."""
    groups = (group for spec in specs for group in spec.variantSets.values())
    return [variant.primSpec for group in groups for variant in group.variantList]


def _add_variants(specs: list[Any]) -> list[Any]:
    """Return prims with all variants of theirs."""
    found = [*specs]
    while specs := _list_variants(specs):
        found += specs
    return found


def _group_by_path(specs: list[Any]) -> Iterable[list[Any]]:
    """Put together what several layers say of one prim or variant."""
    groups: dict[str, list[Any]] = {}
    for spec in specs:
        groups.setdefault(str(spec.path), []).append(spec)
    return groups.values()


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
