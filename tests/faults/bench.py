"""What a run must keep whatever fails: judged by the files that it and the next run leave."""

import os
import shutil
import signal
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

from tests.faults.commands import EXTRACT, STIFF, Command, make_inputs, read_files
from tests.faults.interception import OPENS, SIZES, SYNCS, WRITES
from tests.faults.process import (
    KILL,
    Point,
    Run,
    learn_modules,
    make_environment,
    run_cold,
    run_warm,
)

FOLDERS = ("work", "cache", "tmp", "home")
"""Below the folder of a run: where it works, and all else that it may write to."""

MAIN = "cageik_cli.__main__:main"
UNEXPECTED = ("Traceback", "internal error", "Exception ignored", "hangs")
RETRIED = {**WRITES, **SIZES, **SYNCS, **OPENS}
"""Calls about files that are repeated when a signal interrupts them.

Python does not repeat the opening of a folder, nor the system that of a library that is imported.
"""


@dataclass(frozen=True)
class Case:
    """A run of a command, with or without an older output that it replaces."""

    command: Command
    is_over_older: bool

    @property
    def words(self) -> tuple[str, ...]:
        """The words of the run."""
        return self.command.words + (("--overwrite",) if self.is_over_older else ())

    @property
    def next_words(self) -> tuple[str, ...]:
        """The words of the run after it, which continues it or starts again."""
        if self.command.resumes and not self.is_over_older:
            return (*self.command.words, "--resume")
        return self.command.words + (("--overwrite",) if self.command.outputs else ())


@dataclass(frozen=True)
class Trial:
    """One fault in a run: a call that fails, or none and a kill at a part of its time."""

    case: Case
    point: Point | None
    fault: str
    is_cold: bool = False
    part: float = 0.0

    def __str__(self) -> str:
        name = self.case.command.name + (" over an older output" if self.case.is_over_older else "")
        if self.point is None:
            return f"{name}: killed at {self.part:.3f}"
        return f"{name}: {self.point.call} {self.point.count} of {self.point.path} {self.fault}"


@dataclass(frozen=True)
class Wanted:
    """What a run without faults leaves."""

    older: dict[str, bytes]
    outputs: dict[str, bytes]
    stdout: bytes
    others: frozenset[str]
    seconds: float


@dataclass
class Verdict:
    """What is violated, whether the call was made, and whether a killed run left something."""

    violations: list[str] = field(default_factory=list)
    is_hit: bool = False
    has_left: bool = False
    is_aborted: bool = False


class Bench:
    """A folder for runs of commands, and what each leaves without faults."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._name, self._count = folder, "main", 0
        self._inputs = folder / "inputs"
        self._cache: dict[str, bytes] = {}
        self._wanted: dict[Case, Wanted] = {}
        make_inputs(self._inputs)

    def begin_worker(self, number: int) -> None:
        """Use names of its own from now on, in a fork."""
        self._name, self._count = f"worker{number}", 0

    def make_results(self) -> None:
        """Add two results to the inputs, for the commands that read one."""
        folder = self._make_folder({})
        for name, more in (("r.h5", ()), ("s.h5", STIFF)):
            _check(run_warm(folder, MAIN, (*EXTRACT, "-o", name, *more)))
            shutil.copy(folder / "work" / name, self._inputs)
        self._cache = read_files(folder / "cache")
        shutil.rmtree(folder)

    def warm_up(self, commands: Iterable[Command]) -> None:
        """Import what the commands import."""
        os.environ.update(make_environment(self._folder / "main"))
        for command in commands:
            folder = self._make_folder({})
            for name in learn_modules(folder, command.main, command.words):
                with suppress(ImportError):
                    import_module(name)
            shutil.rmtree(folder)

    def prepare(self, case: Case) -> Run:
        """Run a case without faults and keep what it leaves; return the run with all its calls."""
        command = case.command
        older: dict[str, bytes] = {}
        if case.is_over_older:
            folder = self._make_folder({})
            _check(run_warm(folder, command.main, command.other_words))
            older = _read_outputs(command, folder)
            shutil.rmtree(folder)
        folder = self._make_folder(older, command)
        start = time.perf_counter()
        run = _check(run_warm(folder, command.main, case.words))
        self._wanted[case] = Wanted(
            older=older,
            outputs=_read_outputs(command, folder),
            stdout=run.output,
            others=frozenset(self._find_others(case, folder)),
            seconds=time.perf_counter() - start,
        )
        if case.is_over_older and older == self._wanted[case].outputs:
            raise ValueError(f"{command.name}: the older output is the same as the new one")
        shutil.rmtree(folder)
        return run

    def run_cold(self, case: Case) -> Run:
        """Run a case in an interpreter of its own, without faults; return it with all its calls."""
        folder = self._make_folder(self._wanted[case].older, case.command)
        run = _check(run_cold(folder, case.words))
        shutil.rmtree(folder)
        return run

    def judge(self, trial: Trial) -> Verdict:
        """Run a case with a fault, and the run after it; return what is violated."""
        case, wanted = trial.case, self._wanted[trial.case]
        folder = self._make_folder(wanted.older, case.command)
        before = _read_state(folder)
        main = case.command.main
        if trial.point is None:
            run = run_warm(folder, main, case.words, kill_after=trial.part * wanted.seconds)
        elif trial.is_cold:
            run = run_cold(folder, case.words, trial.point, trial.fault)
        else:
            run = run_warm(folder, main, case.words, trial.point, trial.fault)
        verdict = Verdict(is_hit=run.is_hit, is_aborted=run.code == -signal.SIGABRT)
        verdict.has_left = bool(self._find_others(case, folder) - wanted.others)
        found = (
            _find_faults_of_end(trial, run, wanted),
            self._find_faults_of_files(trial, folder, run),
        )
        verdict.violations = [fault for faults in found for fault in faults]
        # A run that leaves exactly what it found changes nothing for the next one.
        if _read_state(folder) != before:
            verdict.violations += self._find_faults_of_next_run(case, folder)
        shutil.rmtree(folder)
        return verdict

    def _find_faults_of_files(self, trial: Trial, folder: Path, run: Run) -> Iterator[str]:
        """Yield what is wrong with the files that a run has left."""
        command, wanted = trial.case.command, self._wanted[trial.case]
        found = read_files(folder / "work")
        for name, data in read_files(self._inputs).items():
            if found.get(name) != data:
                yield f"the input {name} has changed"
        outputs = _read_outputs(command, folder)
        if run.code == 0 and outputs != wanted.outputs:
            yield "exit code 0, and the output is not the expected one"
        for place in command.outputs:
            if command.is_folder_of_many:
                yield from _find_damaged_results(outputs, wanted)
                continue
            mine = _select(outputs, place)
            if mine not in (_select(wanted.older, place), _select(wanted.outputs, place)):
                yield f"the output {place} is neither the older one nor the new one"

    def _find_faults_of_next_run(self, case: Case, folder: Path) -> Iterator[str]:
        """Yield what is wrong with the run after it."""
        wanted = self._wanted[case]
        run = run_warm(folder, case.command.main, case.next_words)
        if run.code != 0:
            yield f"the next run ends with {run.code}: {run.said.strip()[-300:]}"
        elif _read_outputs(case.command, folder) != wanted.outputs:
            yield "the next run writes something else"
        left = self._find_others(case, folder) - wanted.others
        if left:
            yield f"left over after the next run: {', '.join(sorted(left))}"

    def _find_others(self, case: Case, folder: Path) -> set[str]:
        """Return the names of files and folders that are neither inputs nor outputs."""
        names = {
            str(path.relative_to(folder)) for top in FOLDERS for path in (folder / top).rglob("*")
        }
        known = {f"work/{path.relative_to(self._inputs)}" for path in self._inputs.rglob("*")}
        finished = {f"work/{name}" for name in _read_outputs(case.command, folder)}
        finished |= {str(Path(name).parent) for name in finished}
        return names - known - finished

    def _make_folder(self, older: dict[str, bytes], command: Command | None = None) -> Path:
        """Make the folder of a run, with the inputs, an older output and a cache of weights."""
        self._count += 1
        folder = self._folder / f"{self._name}-{self._count}"
        shutil.copytree(self._inputs, folder / "work")
        for name in FOLDERS[1:]:
            (folder / name).mkdir()
        cache = self._cache if command is not None and not command.fills_cache else {}
        for top, files in (("work", older), ("cache", cache)):
            for name, data in files.items():
                path = folder / top / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)
        return folder


def find_unsynced(points: Iterable[Point]) -> Iterator[str]:
    """Yield the outputs that are renamed before the disk has all that was written to them.

    After a power cut, such an output may be neither the older one nor the new one. Entries of the
    cache have digests instead.
    """
    unsynced: set[str] = set()
    for point in points:
        if point.path.endswith(".partial.RANDOM"):
            continue  # USD's own: it becomes the unfinished file, which is synced and renamed later
        if point.call in {**WRITES, **SIZES}:
            unsynced.add(point.path)
        elif point.call in SYNCS or point.call.startswith("unlink"):
            unsynced.discard(point.path)
        elif point.call.startswith("rename") and point.path.startswith("work/"):
            inside = f"{point.path.rstrip('/')}/"
            for path in sorted(unsynced):
                if path == point.path or path.startswith(inside):
                    yield f"{path} is renamed before the disk has it"


def _read_state(folder: Path) -> dict[str, bytes | None]:
    """Return all files and folders that a run may change, with the bytes of the files."""
    paths = [path for name in FOLDERS for path in (folder / name).rglob("*")]
    return {str(path): path.read_bytes() if path.is_file() else None for path in paths}


def _check(run: Run) -> Run:
    """Return a run that has ended well; raise an error for another."""
    if run.code != 0:
        raise RuntimeError(f"a run without faults ended with {run.code}: {run.said}")
    return run


def _select(outputs: dict[str, bytes], place: str) -> dict[str, bytes]:
    """Return the files of one output, which is a file or a folder."""
    return {k: v for k, v in outputs.items() if k == place or k.startswith(f"{place}/")}


def _read_outputs(command: Command, folder: Path) -> dict[str, bytes]:
    """Return the bytes of all outputs that are under their final names."""
    found = {k: v for k, v in read_files(folder / "work").items() if "partial" not in k}
    return {k: v for place in command.outputs for k, v in _select(found, place).items()}


def _find_damaged_results(outputs: dict[str, bytes], wanted: Wanted) -> Iterator[str]:
    """Yield the results of a batch that are not whole; its reports tell of failed clips."""
    for name, data in outputs.items():
        is_whole = data in (wanted.older.get(name), wanted.outputs.get(name))
        if not is_whole and name.endswith(".h5"):
            yield f"the output {name} is neither the older one nor the new one"


def _find_faults_of_end(trial: Trial, run: Run, wanted: Wanted) -> Iterator[str]:
    """Yield what is wrong with the exit code and the messages of a run."""
    is_many = trial.case.command.is_folder_of_many
    allowed = {0, 1, *([4] if is_many else []), *([-9] if trial.fault == KILL else [])}
    said = run.said.strip()
    if trial.case.command.may_abort and run.code == -signal.SIGABRT:
        return
    if run.code not in allowed or any(word in said for word in UNEXPECTED):
        yield f"exit code {run.code}: {said[-300:]}"
    can_speak = run.code in (1, 4) and trial.point is not None and trial.point.path != "stderr"
    if can_speak and "Error: " not in said and not is_many:
        yield f"exit code {run.code}, and no error: {said[-300:]}"
    if run.code == 0 and run.output != wanted.stdout:
        yield "exit code 0, and stdout is not the expected one"
    if trial.fault == "EINTR" and _is_retried(trial) and run.code != 0:
        yield f"a signal ends the run: {said[-300:]}"


def _is_retried(trial: Trial) -> bool:
    """Tell whether the call of a trial is repeated when a signal interrupts it."""
    point = trial.point
    if point is None or trial.is_cold or not trial.case.command.repeats_calls:
        return False
    return point.call in RETRIED and not point.path.endswith("/")
