"""Check the rules of CONTRIBUTING.md that a program can check: `python -m tests.rules`."""

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "cageik_cli"

MAX_LINES = 700
"""Lines of a module; a longer one has a second subject. There is no lower limit."""

TOP_LEVEL = {
    "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "MANIFEST.in", "Makefile",
    "README.md", "cageik_cli", "data_fixtures", "docs", "mkdocs.yml", "pyproject.toml", "tests",
}  # fmt: skip
"""What the top level holds, beside names that begin with a dot."""

CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]+")
OPTION = re.compile(r"(?<![\w-])(?:--(?!nthreads|nworkers)[a-z][a-z-]*|-[oqv](?![\w-]))")
"""An option of ours, such as --rest or -o; those of `dask worker` are not."""

FOREIGN = re.compile(r"\bblender --[^`;\n]*")
"""The command line of another program that a text tells, up to its end."""

DOTTED = re.compile(r"`(?:cageik_cli\.)?([a-z_]+(?:\.(?!py\b|json\b)\w+)+)")
"""What may be a module, or a name in it: `cages.push`, `cages.push.push`, and `result.frames`."""

Module = tuple[str, str]
"""The path of a module below the package, and its source."""


def read_modules(package: Path = PACKAGE) -> list[Module]:
    """Read all modules of the package."""
    paths = sorted(package.rglob("*.py"))
    return [(path.relative_to(package).as_posix(), path.read_text()) for path in paths]


@cache
def list_nodes(source: str) -> list[ast.AST]:
    """List all nodes of a module, the module itself first."""
    return list(ast.walk(ast.parse(source)))


def list_constants(source: str) -> Iterator[tuple[str, int]]:
    """Yield name and line of each constant of a module."""
    for node in list_nodes(source)[0].body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        if isinstance(node, ast.AnnAssign):
            targets = [node.target]
        names = [name for target in targets for name in ast.walk(target)]
        for name in names:
            if isinstance(name, ast.Name) and CONSTANT.fullmatch(name.id):
                yield name.id, node.lineno


def find_repeated_constants(modules: list[Module]) -> Iterator[str]:
    """Find constants of the same name in several modules: one number has one name and one home."""
    places: Mapping[str, list[str]] = defaultdict(list)
    for path, source in modules:
        for name, line in list_constants(source):
            places[name].append(f"{path}:{line}")
    for name, found in sorted(places.items()):
        if len(found) > 1:
            yield f"{found[1]}: {name} is also a constant of {found[0]}; rename one, or import it"


def find_long_modules(modules: list[Module]) -> Iterator[str]:
    """Find modules that hold more than one subject, as their length tells."""
    for path, source in modules:
        lines = source.count("\n")
        if lines > MAX_LINES:
            yield f"{path}: {lines} lines, expected at most {MAX_LINES}; look for a second subject"


def find_option_words(modules: list[Module]) -> Iterator[str]:
    """Find options of the command line in texts below `cli`, which words them.

    An option that is a string of its own is a word of a command that is told, and no message. The
    help of an option may name others: what is said in a declaration of a setting is the help.
    """
    for path, source in modules:
        if path.startswith("cli/"):
            continue
        nodes = list_nodes(source)
        passed = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        for node in nodes:
            if isinstance(node, ast.Call) and getattr(node.func, "id", "").startswith("declare_"):
                passed.update(map(id, ast.walk(node)))
        for node in nodes:
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                text = "" if id(node) in passed else FOREIGN.sub("", node.value)
                found = OPTION.search(text)
                if found and found[0] != node.value:
                    yield f"{path}:{node.lineno}: names {found[0]}; name the parameter in backticks"


def find_lost_modules(modules: list[Module]) -> Iterator[str]:
    """Find names in backticks in docstrings that begin with a folder, or with what only a module
    is called, and lead nowhere.
    """
    names: dict[tuple[str, ...], set[str]] = {}
    for path, source in modules:
        place = tuple(path.removesuffix(".py").removesuffix("/__init__").split("/"))
        names[place] = {getattr(node, "name", "") for node in list_nodes(source)[0].body}
    folders = {folder for place in names for folder in place[:-1]}
    ends = {place[k:] for place in names for k in range(len(place))}
    for path, source in modules:
        for text in list_docstrings(source):
            for parts in (tuple(found.split(".")) for found in DOTTED.findall(text)):
                *above, last = parts
                homes = [place for place in names if place[-len(above) :] == tuple(above)]
                is_known = parts in ends or any(last in names[place] for place in homes)
                if (parts[0] in folders or "_" in parts[0]) and not is_known and last != "NAME":
                    yield f"{path}: names {'.'.join(parts)}, which is not there; mend the name"


def list_docstrings(source: str) -> Iterator[str]:
    """Yield all docstrings of a module."""
    for node in list_nodes(source):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            yield ast.get_docstring(node) or ""


RULES = (find_repeated_constants, find_long_modules, find_option_words, find_lost_modules)


def main() -> int:
    """Print what breaks a rule; return how the process ends."""
    modules = read_modules()
    faults = [fault for rule in RULES for fault in rule(modules)]
    print("\n".join(faults) or f"{len(modules)} modules keep the rules")
    return bool(faults)


def find_stray_entries(paths: Iterable[bytes]) -> Iterator[bytes]:
    """Yield the paths of files whose first part is not agreed on for the top level."""
    agreed = {name.encode() for name in TOP_LEVEL}
    for path in paths:
        first = path.split(b"/")[0]
        if first not in agreed and not first.startswith(b"."):
            yield path


if __name__ == "__main__":
    sys.exit(main())
