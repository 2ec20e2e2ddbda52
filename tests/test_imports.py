"""The order of the modules, and who may use what: read from the imports of every module."""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import cageik_cli

PACKAGE = Path(cageik_cli.__file__).parent

ORDER = (
    "errors", "optional", "layout", "threads", "observer", "kinds", "scene", "mesh", "scratch",
    "coordinates.weights", "coordinates.polynomials", "coordinates.panel_geometry",
    "coordinates.panels", "coordinates.higher_terms", "coordinates.boundary_mesh",
    "coordinates.surface", "coordinates.boundary_equation", "coordinates.error_estimate",
    "coordinates.harmonic", "coordinates.mean_value",
    "shape", "findings", "intersections", "soundness", "enclosure", "weaknesses", "diagnosis",
    "binding", "rotations", "alignment", "dual_laplacian", "camera", "anchors", "ties",
    "cage_field", "rigidity", "posing", "rebuilding", "metrics",
    "locks", "outputs", "hdf5", "handles", "layers", "edited_block", "pose_figures", "usd",
    "sequence", "store.parts", "store.result_figures", "store.result", "store.result_writer",
    "store.solved_block", "store.told",
    "store.partial", "store.binding_file", "store.cache_entry",
    "store.cache", "export", "binding_run", "inputs", "resuming", "solving", "extraction",
    "exporting", "deforming", "posing_run", "editing", "report", "batch", "checking", "describing",
    "cli", "__main__",
)  # fmt: skip
"""Each imports only from those before it; a folder named here keeps its own order."""

OWNERS = {
    "click": {"cli"},
    "tqdm": {"cli"},
    "h5py": {
        "hdf5",
        "store.parts",
        "store.result",
        "store.result_figures",
        "store.result_writer",
        "store.binding_file",
    },
    "platformdirs": {"cli.options"},
    "igl": {"coordinates.surface", "soundness", "intersections"},
    "pyarrow": {"sequence.obj_words"},
    "trimesh": {"sequence.mesh_file"},
    "pygltflib": {"export.writers.gltf"},
    "jinja2": {"report.templating"},
    "jsonschema": {"handles.schema"},
    "distributed": {"batch.cluster", "batch.pieces"},
    "natsort": {"sequence.opening"},
    "threadpoolctl": {"threads"},
    "pxr": {
        "usd",
        "sequence.readers.usd",
        "export.usd_file",
        "export.writers.usd",
        "export.skeleton",
    },
    "alembic3d": {"sequence.readers.alembic", "export.writers.alembic"},
    "imath": {"export.writers.alembic"},
    "matplotlib": {
        "report.anchor_marks",
        "report.figure",
        "report.limit_lines",
        "report.pose_picture",
        "report.style",
    },
    "PIL": {"report.pictures"},
}
"""Who may import a library, `imath` being alembic3d's; numpy and scipy are for all."""

NUMERICS = (
    "mesh",
    "scratch",
    "coordinates",
    "findings",
    "intersections",
    "soundness",
    "enclosure",
    "binding",
    "rotations",
    "alignment",
    "dual_laplacian",
    "camera",
    "anchors",
    "ties",
    "cage_field",
    "rigidity",
    "posing",
    "rebuilding",
    "metrics",
    "export.skinning",
    "report.drawing",
    "report.labels",
    "report.name_places",
    "report.raster",
    "report.shading",
)
NO_NUMERICS = {"click", "io", "logging", "os", "pathlib", "sys", "time", "tqdm", "warnings"}
LOUD = {"print", "open", "input"}


def modules_of(package: Path) -> dict[str, ast.Module]:
    """The modules of a package by name, without the package's own; a folder's `__init__` is it."""
    found = {}
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package).with_suffix("").parts
        found[".".join(part for part in parts if part != "__init__")] = ast.parse(path.read_text())
    return found


def faults_of(package: Path) -> list[str]:
    """Everything in a package that breaks a rule, a line each."""
    modules = modules_of(package)
    found = []
    for name, tree in modules.items():
        for imported in _imports(tree, name, package.name):
            found += _order_faults(name, imported, modules, package.name)
            found += _owner_faults(name, imported.split(".")[0], package.name)
        if _is_within(name, *NUMERICS):
            found += _loud_faults(name, tree)
    return found


def _imports(tree: ast.Module, name: str, package: str) -> Iterator[str]:
    """Full names that a module imports, wherever in it: `package.module.thing`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = f"{package}.{name}".split(".")[: -node.level] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _order_faults(name, imported, modules, package):
    if imported.split(".")[0] != package:
        return []
    target = imported.split(".")[1:]
    while target and ".".join(target) not in modules:
        target = target[:-1]
    here, there = _place(name), _place(".".join(target))
    if here is None or there is None:
        unknown = name if here is None else ".".join(target)
        return [f"{unknown}: not in the order of modules"] if unknown else []
    if there <= here:
        return []
    return [f"{name}: imports {'.'.join(target)}, which stands below it"]


def _place(name: str) -> int | None:
    return next((k for k, entry in enumerate(ORDER) if _is_within(name, entry)), None)


def _is_within(name: str, *entries: str) -> bool:
    return any(f"{name}.".startswith(f"{entry}.") for entry in entries)


def _owner_faults(name, library, package):
    if library in OWNERS:
        if not _is_within(name, *OWNERS[library]):
            return [f"{name}: imports {library}, which only {', '.join(OWNERS[library])} may"]
    elif library not in sys.stdlib_module_names | {"numpy", "scipy", package}:
        return [f"{name}: imports {library}, which has no owner"]
    if _is_within(name, *NUMERICS) and library in NO_NUMERICS:
        return [f"{name}: imports {library}, which numerics do without"]
    return []


def _loud_faults(name: str, tree: ast.Module) -> list[str]:
    calls = (node.func for node in ast.walk(tree) if isinstance(node, ast.Call))
    named = {func.id for func in calls if isinstance(func, ast.Name)}
    return [f"{name}: calls {word}()" for word in sorted(named & LOUD)]


def test_every_module_keeps_the_rules():
    assert faults_of(PACKAGE) == []


def test_every_module_has_its_place():
    """Also one that imports nothing and is imported by none."""
    placeless = [name for name in modules_of(PACKAGE) if _place(name) is None]
    assert placeless == ["", "coordinates", "store"]


def test_every_entry_is_still_a_module():
    names = set(modules_of(PACKAGE))
    owners = {owner for owned in OWNERS.values() for owner in owned}
    assert set(ORDER) | set(NUMERICS) | owners <= names


def test_every_owner_still_uses_its_library():
    used = {
        (imported.split(".")[0], owner)
        for name, tree in modules_of(PACKAGE).items()
        for imported in _imports(tree, name, "cageik_cli")
        for owners in OWNERS.values()
        for owner in owners
        if _is_within(name, owner)
    }
    assert {(library, owner) for library, owners in OWNERS.items() for owner in owners} <= used


@pytest.mark.parametrize("folder", ["sequence.readers", "export.writers"])
def test_readers_and_writers_are_not_imported_by_name(folder):
    """A new kind of clip is one file among the readers or writers, and nothing else."""
    users = {
        name
        for name, tree in modules_of(PACKAGE).items()
        for imported in _imports(tree, name, "cageik_cli")
        if imported.startswith(f"cageik_cli.{folder}.")
    }
    assert users == set()


BROKEN = {
    "upward": ("mesh", "from cageik_cli.store.result import x", "mesh: imports store.result"),
    "upward inside a function": (
        "metrics",
        "def f():\n    import cageik_cli.extraction",
        "metrics: imports extraction",
    ),
    "upward by the package": (
        "binding",
        "from cageik_cli.store import result",
        "binding: imports store.result",
    ),
    "upward, relative": ("binding", "from .store import result", "binding: imports store.result"),
    "upward, relative, out of a folder": (
        "sequence/obj",
        "from ..report.text import as_text",
        "sequence.obj: imports report.text",
    ),
    "within numerics": (
        "coordinates/panels",
        "from cageik_cli.coordinates.harmonic import x",
        "coordinates.panels: imports coordinates.harmonic",
    ),
    "not in the order": ("extras", "import cageik_cli.mesh", "extras: not in the order"),
    "another's library": (
        "store/result",
        "import click",
        "store.result: imports click, which only cli may",
    ),
    "another's library, later": (
        "sequence/clip",
        "def f():\n    from h5py import File",
        "sequence.clip: imports h5py",
    ),
    "a library of nobody": ("report/text", "import pandas.io", "report.text: imports pandas"),
    "a path in numerics": ("enclosure", "from pathlib import Path", "enclosure: imports pathlib"),
    "a bar in numerics": ("binding", "from tqdm import tqdm", "binding: imports tqdm"),
    "print": ("dual_laplacian", "def f():\n    print(1)", "dual_laplacian: calls print()"),
    "open": ("coordinates/surface", "open('x')", "coordinates.surface: calls open()"),
}


@pytest.mark.parametrize(("module", "text", "fault"), BROKEN.values(), ids=BROKEN)
def test_the_checker_finds(tmp_path, module, text, fault):
    package = tmp_path / "cageik_cli"
    for path in PACKAGE.rglob("*.py"):
        copy = package / path.relative_to(PACKAGE)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.touch()
    (package / f"{module}.py").write_text(text)
    (found,) = faults_of(package)
    assert found.startswith(fault)
