"""Inject errors of the system into runs, kill runs, and look at what they leave.

`python -m tests.faults.harness SECONDS` prints how much was tried and what was violated.
"""

import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults.commands import (
    COMMANDS,
    Command,
    is_output,
    make_environment,
    make_inputs,
    read_files,
    run,
)

ERRORS = {
    "write": ("ENOSPC", "EIO", "EINTR"),
    "pwrite64": ("ENOSPC", "EIO"),
    "fsync": ("EIO", "ENOSPC"),
    "ftruncate": ("EIO", "ENOSPC"),
    "rename": ("EIO", "ENOSPC"),
    "renameat2": ("EIO", "EINVAL"),
    "openat": ("EIO", "ENOSPC", "EINTR", "EMFILE"),
    "mkdir": ("ENOSPC", "EIO"),
    "unlink": ("EIO",),
    "rmdir": ("EIO",),
}
"""Errors per call of the system. EINTR is repeated by Python, so that runs must succeed."""

_CALL = re.compile(r"^(\d+) +(\w+)\((.*)")


@dataclass(frozen=True)
class Point:
    """The `count`-th call of a kind in a thread, which concerns a file in the folder."""

    command: Command
    call: str
    count: int
    error: str


@dataclass
class Figures:
    """What was tried, per command, and what was violated."""

    points: Counter[str] = field(default_factory=Counter)
    tried: Counter[str] = field(default_factory=Counter)
    kills: Counter[str] = field(default_factory=Counter)
    left: int = 0
    violations: list[str] = field(default_factory=list)

    def show(self) -> str:
        rows = [f"{'command':<12} {'points':>7} {'tried':>7} {'kills':>7}"]
        rows += [
            f"{c.name:<12} {self.points[c.name]:>7} {self.tried[c.name]:>7} {self.kills[c.name]:>7}"
            for c in COMMANDS
        ]
        total = sum(self.points.values()), sum(self.tried.values()), sum(self.kills.values())
        rows += ["{:<12} {:>7} {:>7} {:>7}".format("all", *total)]
        rows += [f"left by killed runs, before the next run: {self.left}"]
        rows += [f"violations: {len(self.violations)}", *self.violations]
        return "\n".join(rows)


class Bench:
    """A folder of inputs, and what each command writes without faults."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._copies = folder / "work", 0
        make_inputs(self._folder)
        self.inputs = read_files(self._folder)
        self.wanted: dict[str, dict[str, bytes]] = {}
        self.seconds: dict[str, float] = {}
        for command in COMMANDS:
            work = self.copy()
            start = time.perf_counter()
            run(work, command.words).check_returncode()
            self.seconds[command.name] = time.perf_counter() - start
            self.wanted[command.name] = self.read_outputs(command, work)
            shutil.rmtree(work)

    def copy(self) -> Path:
        self._copies += 1
        return Path(shutil.copytree(self._folder, self._folder.with_name(f"w{self._copies}")))

    def read_outputs(self, command: Command, work: Path) -> dict[str, bytes]:
        return {k: v for k, v in read_files(work).items() if is_output(command, k)}

    def find_points(self, command: Command) -> Iterator[Point]:
        """Yield all points of a run that concern the folder."""
        work = self.copy()
        log = work.with_suffix(".log")
        calls = ",".join(f"?{call}" for call in ERRORS)
        run(work, command.words, ("strace", "-f", "-y", "-o", str(log), "-e", f"trace={calls}"))
        counts: Counter[tuple[str, str]] = Counter()
        found: set[tuple[str, int]] = set()
        for line in log.read_text(errors="replace").splitlines():
            match = _CALL.match(line)
            if match is None:
                continue
            thread, call, words = match.groups()
            counts[thread, call] += 1
            is_here = str(work) in words or (call != "write" and '"/' not in words)
            if is_here and call in ERRORS:
                found.add((call, counts[thread, call]))
        shutil.rmtree(work)
        log.unlink()
        for call, count in sorted(found):
            for error in ERRORS[call]:
                yield Point(command, call, count, error)

    def inject(self, point: Point) -> str | None:
        """Run with one fault; return what is violated."""
        work = self.copy()
        how = f"inject={point.call}:error={point.error}:when={point.count}"
        before = ("strace", "-f", "-qq", "-o", "/dev/null", "-e", f"trace={point.call}", "-e", how)
        try:
            done = run(work, point.command.words, before)
            fault = self._judge(point.command, work, done.returncode, done.stderr)
        except subprocess.TimeoutExpired:
            fault = "hangs"
        shutil.rmtree(work)
        return fault and f"{point.command.name}: {point.call} {point.count} {point.error}: {fault}"

    def kill(self, command: Command, part: float) -> tuple[str | None, bool]:
        """Kill a run over an older output; return what is violated, and whether it left a file."""
        work = self.copy()
        run(work, command.words)
        words = [sys.executable, "-m", "cageik_cli", *command.words, *command.replace]
        with subprocess.Popen(
            words, cwd=work, env=make_environment(work),
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        ) as process:  # fmt: skip
            time.sleep(part * self.seconds[command.name])
            process.kill()
        is_left = any("partial" in name for name in read_files(work))
        fault = self._judge(command, work, 1, "")
        shutil.rmtree(work)
        return fault and f"{command.name}: killed at {part:.3f}: {fault}", is_left

    def _judge(self, command: Command, work: Path, code: int, said: str) -> str | None:
        """Return what is wrong with what a run left, and with the run after it."""
        found, wanted = read_files(work), self.wanted[command.name]
        if code not in (0, 1, 4) or "internal error" in said or "Traceback" in said:
            return f"exit code {code}: {said.strip()[-200:]}"
        for name, data in self.inputs.items():
            if found.get(name) != data:
                return f"the input {name} has changed"
        finished = {k: v for k, v in found.items() if is_output(command, k) and "partial" not in k}
        if command.name != "batch":
            for name, data in finished.items():
                if wanted.get(name) != data:
                    return f"the output {name} is damaged"
            if code == 0 and finished != wanted:
                return "exit code 0, and an output is missing"
        again = run(work, (*command.words, *command.replace))
        if again.returncode != 0:
            return f"the next run fails: {again.stderr.strip()[-200:]}"
        if self.read_outputs(command, work) != wanted:
            return "the next run writes something else"
        more = set(read_files(work)) - set(self.inputs) - set(wanted)
        return f"left over: {', '.join(sorted(more))}" if more else None


def try_faults(seconds: float, kills: int, seed: int = 0) -> Figures:
    """Try points in random order until the time is over, then kill runs."""
    figures, order = Figures(), random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder))
        points = [point for command in COMMANDS for point in bench.find_points(command)]
        figures.points.update(point.command.name for point in points)
        order.shuffle(points)
        end = time.monotonic() + seconds
        for point in points:
            if time.monotonic() > end:
                break
            figures.tried[point.command.name] += 1
            fault = bench.inject(point)
            figures.violations += [fault] if fault else []
        for k in range(kills):
            command = COMMANDS[k % len(COMMANDS)]
            fault, is_left = bench.kill(command, order.uniform(0.1, 1.1))
            figures.kills[command.name] += 1
            figures.left += is_left
            figures.violations += [fault] if fault else []
    return figures


if __name__ == "__main__":
    print(try_faults(float(sys.argv[1]), int(sys.argv[2])).show())
