"""Let every call of every command fail once, kill runs, and look at what they leave.

`python -m tests.faults.harness [SECONDS] [KILLS]` prints how much was tried and what was violated.
"""

import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from multiprocessing import connection, get_context
from pathlib import Path

from tests.faults.bench import Bench, Case, Trial, Verdict, find_unsynced
from tests.faults.commands import COMMANDS
from tests.faults.interception import NAMES, OPENS
from tests.faults.process import FULL, KILL, Point, Run

WORKERS = 2
IMPORT_ERRORS = ("ENOSPC", "EIO", "EMFILE", "ENOMEM", "EINTR")
ALSO_FRESH = ("extract", "bind", "export obj", "batch")
"""Commands that are tried without an older output, too; the others never look at it."""


@dataclass
class Figures:
    """What was tried, per command, and what was violated."""

    calls: Counter[str] = field(default_factory=Counter)
    foreign: Counter[str] = field(default_factory=Counter)
    trials: Counter[str] = field(default_factory=Counter)
    tried: Counter[str] = field(default_factory=Counter)
    imports: Counter[str] = field(default_factory=Counter)
    kills: Counter[str] = field(default_factory=Counter)
    missed: int = 0
    aborted: int = 0
    left: int = 0
    seconds: float = 0.0
    violations: list[str] = field(default_factory=list)

    def show(self) -> str:
        """Return a table, and the violations."""
        columns = {
            "calls": self.calls + self.foreign, "interpreter": self.foreign, "own": self.calls,
            "faults": self.trials, "tried": self.tried, "imports": self.imports,
            "kills": self.kills,
        }  # fmt: skip
        rows = ["command        " + "".join(f"{name:>12}" for name in columns)]
        for name in [command.name for command in COMMANDS]:
            rows += [f"{name:<15}" + "".join(f"{column[name]:>12}" for column in columns.values())]
        totals = "".join(f"{sum(column.values()):>12}" for column in columns.values())
        rows += [f"{'all':<15}{totals}"]
        rows += [f"faults whose call was not made again: {self.missed}"]
        rows += [f"ended by a library, which may do so: {self.aborted}"]
        rows += [f"left by killed runs, before the next run: {self.left}"]
        rows += [f"seconds: {self.seconds:.0f}"]
        return "\n".join([*rows, f"violations: {len(self.violations)}", *self.violations])


def choose_faults(point: Point) -> tuple[str, ...]:
    """Return what is done to a call, one after the other."""
    if point.call in OPENS:
        return ("ENOSPC", "EIO", "EINTR", "EMFILE", KILL)
    if point.call == "renameat2":
        return ("ENOSPC", "EIO", "EINTR", "EINVAL", KILL)
    if point.call in NAMES or point.path in ("stdout", "stderr"):
        return ("ENOSPC", "EIO", "EINTR", KILL)
    return ("ENOSPC", "EIO", "EINTR", KILL, FULL)


def choose_cases() -> list[Case]:
    """Return the runs of all commands, over an older output and without one."""
    cases = [Case(command, is_over_older=bool(command.outputs)) for command in COMMANDS]
    return cases + [Case(c, is_over_older=False) for c in COMMANDS if c.name in ALSO_FRESH]


def choose_imports(run: Run, case: Case, order: random.Random) -> list[Trial]:
    """Choose one call of the interpreter per error, made while it imports the command."""
    paths = [point.path for point in run.foreign]
    first = 1 + next(k for k, path in enumerate(paths) if "/__main__." in path)
    opened = [point for point in run.foreign[first:] if point.call in OPENS]
    return [Trial(case, order.choice(opened), error, is_cold=True) for error in IMPORT_ERRORS]


def try_trials(bench: Bench, trials: list[Trial], figures: Figures, seconds: float) -> None:
    """Try all in two processes until the time is over."""
    context, end = get_context("fork"), time.monotonic() + seconds
    pipes, done = [], 0
    for k in range(WORKERS):
        ours, theirs = context.Pipe(duplex=False)
        context.Process(target=_work, args=(bench, trials[k::WORKERS], theirs, k, end)).start()
        theirs.close()
        pipes.append(ours)
    while pipes:
        for pipe in connection.wait(pipes):
            try:
                trial, verdict = pipe.recv()
            except EOFError:
                pipes.remove(pipe)
                continue
            _count(figures, trial, verdict)
            done += 1
            if done % 500 == 0:
                print(f"{done} of {len(trials)} tried", file=sys.stderr, flush=True)


def _work(
    bench: Bench, trials: list[Trial], pipe: connection.Connection, number: int, end: float
) -> None:
    bench.begin_worker(number)
    for trial in trials:
        if time.monotonic() > end:
            return
        pipe.send((trial, bench.judge(trial)))


def _count(figures: Figures, trial: Trial, verdict: Verdict) -> None:
    name = trial.case.command.name
    if trial.point is None:
        figures.kills[name] += 1
    elif trial.is_cold:
        figures.imports[name] += 1
    else:
        figures.tried[name] += 1
    figures.missed += trial.point is not None and not verdict.is_hit
    figures.aborted += verdict.is_aborted
    figures.left += trial.point is None and verdict.has_left
    for violation in verdict.violations:
        print(f"{trial}: {violation}", file=sys.stderr, flush=True)
        figures.violations.append(f"{trial}: {violation}")


def choose_trials(bench: Bench, figures: Figures, order: random.Random) -> list[Trial]:
    """Return all faults of all cases, and a few at imports, in random order."""
    trials: list[Trial] = []
    for case in choose_cases():
        name, points = case.command.name, bench.prepare(case).points
        figures.violations += [f"{name}: {violation}" for violation in find_unsynced(points)]
        made = [Trial(case, point, fault) for point in points for fault in choose_faults(point)]
        figures.calls[name] += len(points)
        figures.trials[name] += len(made)
        trials += made
        if case.is_over_older or name not in ALSO_FRESH:
            run = bench.run_cold(case)
            figures.foreign[name] = len(run.foreign)
            trials += choose_imports(run, case, order)
    order.shuffle(trials)
    return trials


def choose_kills(count: int, order: random.Random) -> list[Trial]:
    """Return kills at random moments, of all cases in turn."""
    cases = choose_cases()
    return [
        Trial(cases[k % len(cases)], None, KILL, part=order.uniform(0.0, 1.1)) for k in range(count)
    ]


def try_faults(seconds: float, kills: int, seed: int = 0) -> Figures:
    """Try all faults until the time is over, then kill runs."""
    figures, order, start = Figures(), random.Random(seed), time.monotonic()
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None
    # A TemporaryDirectory would be removed by each fork that ends.
    folder = Path(tempfile.mkdtemp(dir=memory)).resolve()
    try:
        bench = Bench(folder)
        bench.make_results()
        bench.warm_up(COMMANDS)
        try_trials(bench, choose_trials(bench, figures, order), figures, seconds)
        try_trials(bench, choose_kills(kills, order), figures, float("inf"))
    finally:
        shutil.rmtree(folder)
    figures.seconds = time.monotonic() - start
    return figures


if __name__ == "__main__":
    words = [*sys.argv[1:], *("inf", "200")[len(sys.argv) - 1 :]]
    print(try_faults(float(words[0]), int(words[1])).show())
