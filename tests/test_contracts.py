"""The import contracts hold, and each of them fails on a module that breaks it."""

import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

VIOLATIONS = [
    ("geometry.mesh", "cageik_cli.method.solve.metrics", "A folder imports only from the folders"),
    ("method.pose.poser", "cageik_cli.store.result", "A folder imports only from the folders"),
    ("run.bind", "click", "The command line alone owns click"),
    ("geometry.shape", "h5py", "Each library has one owner"),
    ("run.bind", "http", "The view alone serves a page"),
    ("method.solve.metrics", "time", "Numerics take and return arrays"),
]
"""Modules, what they must not import, and the contract that says so."""

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


def test_each_contract_finds_a_violation(package):
    for module, name, _ in VIOLATIONS:
        path = package / "cageik_cli" / f"{module.replace('.', '/')}.py"
        path.write_text(path.read_text() + f"\n\nimport {name}  # noqa\n")
    done = lint(package)
    assert done.returncode == 1
    told = done.stdout.split("\nBroken contracts\n")[1]
    found, contract = [], ""
    for line, below in pairwise(told.splitlines()):
        contract = line if set(below) == {"-"} else contract
        if " -> " in line:
            found.append((line, contract))
    assert len(found) == len(VIOLATIONS)
    for module, name, expected in VIOLATIONS:
        wanted = f"cageik_cli.{module} -> {name} "
        (contract,) = [contract for line, contract in found if wanted in line]
        assert contract.startswith(expected)


def test_one_module_imports_the_compiled_core():
    """The linter cannot see it, for it is no Python."""
    owners = [
        path.name
        for path in (ROOT / "cageik_cli").rglob("*.py")
        if "import _kernel" in path.read_text() or "cageik_cli._kernel" in path.read_text()
    ]
    assert owners == ["compiled.py"]
