"""The import contracts hold, and each of them fails on a module that breaks it."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

VIOLATIONS = {
    "a higher floor": ("geometry/mesh.py", "import cageik_cli.solver.metrics", "folders below"),
    "a neighbour": ("posing/poser.py", "import cageik_cli.store.result", "folders below"),
    "click outside cli": ("workflows/bind.py", "import click", "owns click"),
    "a second owner": ("geometry/shape.py", "import h5py", "one owner"),
    "a server elsewhere": ("workflows/bind.py", "import http.server", "serves a page"),
    "a clock in the numerics": ("solver/metrics.py", "import time", "no clock"),
}

pytestmark = pytest.mark.slow


@pytest.fixture
def package(tmp_path):
    """A copy of the package that may be damaged."""
    shutil.copytree(
        ROOT / "cageik_cli", tmp_path / "cageik_cli", ignore=shutil.ignore_patterns("__pycache__")
    )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def lint(folder):
    # Without `folder` in front, the installed package would be analysed.
    code = (
        f"import sys; sys.path.insert(0, {str(folder)!r}); "
        "from importlinter.cli import lint_imports_command; lint_imports_command(['--no-cache'])"
    )
    return subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
    )


def test_the_package_keeps_its_contracts(package):
    done = lint(package)
    assert done.returncode == 0, done.stdout
    assert "0 broken" in done.stdout


@pytest.mark.parametrize(("module", "line", "contract"), VIOLATIONS.values(), ids=VIOLATIONS)
def test_each_contract_finds_a_violation(package, module, line, contract):
    path = package / "cageik_cli" / module
    path.write_text(path.read_text() + f"\n\n{line}  # noqa\n")
    done = lint(package)
    assert done.returncode == 1
    broken = [row for row in done.stdout.splitlines() if " BROKEN" in row]
    assert len(broken) == 1
    assert contract in broken[0]


def test_one_module_imports_the_compiled_core():
    """The linter cannot see it, for it is no Python."""
    owners = [
        path.name
        for path in (ROOT / "cageik_cli").rglob("*.py")
        if "import _kernel" in path.read_text() or "cageik_cli._kernel" in path.read_text()
    ]
    assert owners == ["compiled.py"]
