"""Small runs of every command, each with its inputs and outputs in a folder of its own."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from cageik_cli.solver.memory_plan import MAX_BLOCK_FRAMES

FIXTURES = Path(__file__).resolve().parents[2] / "data_fixtures" / "posed" / "surface"
ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
OLD = "an older output\n"
BLOCKS = 2
"""Blocks of frames that a run solves, each of which it appends to its checkpoint."""


@dataclass(frozen=True)
class Command:
    """A run: its words, what it writes, and the option that lets it replace that."""

    name: str
    words: tuple[str, ...]
    outputs: tuple[str, ...]
    replace: tuple[str, ...] = ("--overwrite",)


EXTRACT = ("extract", "frames", "--cage", "cage.obj", "--jobs", "1")
COMMANDS = (
    Command("extract", (*EXTRACT, "-o", "out.h5"), ("out.h5",)),
    Command("bind", ("bind", "--cage", "cage.obj", "--rest", "rest.obj", "-o", "out.h5"),
            ("out.h5",)),
    Command("report", ("report", "r.h5", "--json", "out.json", "--csv", "out.csv"),
            ("out.json", "out.csv")),
    Command("export npz", ("export", "r.h5", "out.npz"), ("out.npz",)),
    Command("export obj", ("export", "r.h5", "out/c_####.obj"), ("out",)),
    Command("export usdc", ("export", "r.h5", "out.usdc"), ("out.usdc",)),
    Command("deform", ("deform", "r.h5", "-o", "out.pc2"), ("out.pc2",)),
    Command("pose", ("pose", "r.h5", "handles.json", "-o", "out.h5"), ("out.h5",)),
    Command("check", ("check", "--cage", "cage.obj", "--json", "out.json"), ("out.json",)),
    Command("batch", ("batch", "frames", "--cage", "cage.obj", "-o", "out", "--jobs", "1",
                      "--no-pages"), ("out",)),
)  # fmt: skip


def make_environment(folder: Path) -> dict[str, str]:
    return os.environ | ENVIRONMENT | {"CAGEIK_CACHE": str(folder.parent / "cache")}


def make_inputs(folder: Path) -> None:
    """Copy the inputs, and extract a result for the commands that read one."""
    folder.mkdir(parents=True)
    frames = sorted((FIXTURES / "frames").iterdir())
    (folder / "frames").mkdir()
    for k in range(BLOCKS * MAX_BLOCK_FRAMES):
        shutil.copy(frames[k % len(frames)], folder / "frames" / f"frame_{k + 1}.obj")
    shutil.copy(FIXTURES / "cage.obj", folder)
    shutil.copy(sorted((folder / "frames").iterdir())[0], folder / "rest.obj")
    (folder / "handles.json").write_text(
        '{"handles": [{"name": "a", "vertex": 0, "offset": [0.01, 0, 0]}]}'
    )
    run(folder, (*EXTRACT, "-o", "r.h5")).check_returncode()


def run(
    folder: Path, words: tuple[str, ...], before: tuple[str, ...] = ()
) -> "subprocess.CompletedProcess[str]":
    """Run the command in a folder, under another program if that is named."""
    return subprocess.run(
        [*before, sys.executable, "-m", "cageik_cli", *words],
        cwd=folder, env=make_environment(folder), capture_output=True, text=True, timeout=120,
    )  # fmt: skip


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all files in a folder, by their names."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def is_output(command: Command, name: str) -> bool:
    return any(name == place or name.startswith(f"{place}/") for place in command.outputs)
