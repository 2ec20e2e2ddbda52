"""Run the command in a subprocess, and measure what it takes.

It is started by a small process: one that is started by the tests would count their memory as its
own, as the peak of a process begins with that of the one it was forked from.
"""

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

SCRIPT = """
import json, os, resource, subprocess, sys
command, limits, path = json.loads(sys.argv[1])
def limit():
    for name, most in limits.items():
        resource.setrlimit(getattr(resource, name), (most, most))
process = subprocess.Popen(command, stderr=subprocess.STDOUT, preexec_fn=limit)
_, status, usage = os.wait4(process.pid, 0)
found = [os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, usage.ru_maxrss]
with open(path, "w") as file:
    json.dump(found, file)
"""


@dataclass(frozen=True)
class Measured:
    """What a command said and took: its exit code, seconds of a processor, and bytes."""

    code: int
    text: str
    seconds: float
    size: int


def run_measured(words, **limits: int) -> Measured:
    """Run the command; limits are those of the module `resource`, as `RLIMIT_CPU=60`."""
    command = [sys.executable, "-m", "cageik_cli", *map(str, words)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "used.json"
        script = [sys.executable, "-c", SCRIPT, json.dumps([command, limits, str(path)])]
        done = subprocess.run(script, capture_output=True, text=True, check=True)
        code, seconds, size = json.loads(path.read_text())
    return Measured(code, done.stdout, seconds, size << 10)
