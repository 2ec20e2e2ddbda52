"""Processes of this machine: as good as one, whatever becomes of them."""

import multiprocessing
import os
import signal
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from cageik_cli.batch import run as local
from cageik_cli.batch.jobs import ClipJob, ClipState, run_clip
from cageik_cli.batch.run import ProcessScheduler
from cageik_cli.report.limits import Limits
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.util.errors import ClusterError


@dataclass(frozen=True)
class Deadly(Limits):
    """Limits that kill the process that looks at them, the first so many times."""

    log: Path = Path()
    parent: int = 0
    times: int = 0

    def __getattribute__(self, name):
        if name == "baseline" or name == "limits":
            log, parent, times = (
                object.__getattribute__(self, key) for key in ("log", "parent", "times")
            )
            deaths = len(log.read_text()) if log.exists() else 0
            if os.getpid() != parent and deaths < times:
                log.write_text("x" * (deaths + 1))
                os.kill(os.getpid(), signal.SIGKILL)
        return object.__getattribute__(self, name)


@pytest.fixture
def jobs(folder):
    """Three jobs of the little animation; the second cannot be done."""

    def job(name, **changes):
        settings = ExtractSettings(
            frames=(str(folder / "frames"),),
            cage=folder / "cage.obj",
            output=folder / f"{name}.h5",
            cache=folder / "weights",
            resume=True,
        )
        return ClipJob(name, replace(settings, **changes), has_page=False)

    return [job("a"), job("b", cage=folder / "none.obj"), job("c")]


def by_name(outcomes):
    return {outcome.entry.name: outcome for outcome in outcomes}


@pytest.mark.slow
def test_processes_give_the_results_of_one_process(jobs, folder):
    with ProcessScheduler(2) as processes:
        found = by_name(processes.run_jobs(jobs))
    assert multiprocessing.active_children() == []
    states = {name: outcome.state for name, outcome in found.items()}
    assert states == {"a": ClipState.DONE, "b": ClipState.FAILED, "c": ClipState.DONE}
    assert "none.obj: no such file" in found["b"].entry.fault
    data = (folder / "a.h5").read_bytes()
    assert (folder / "c.h5").read_bytes() == data
    again = by_name(run_clip(job) for job in jobs)
    assert again["a"].state is ClipState.UNCHANGED
    assert {name: outcome.entry for name, outcome in again.items()} == {
        name: outcome.entry for name, outcome in found.items()
    }
    assert len(list((folder / "weights").iterdir())) == 1


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="processes are ended otherwise here")
@pytest.mark.parametrize("times", [1, 5])
def test_a_crashed_process_costs_its_clip_one_attempt(jobs, tmp_path, times):
    deadly = Deadly(log=tmp_path / "deaths", parent=os.getpid(), times=times)
    with ProcessScheduler(1) as processes:
        found = by_name(processes.run_jobs([replace(jobs[0], limits=deadly), jobs[2]]))
    assert found["c"].state is ClipState.DONE
    if times == 1:
        assert found["a"].state is ClipState.UNCHANGED  # the result was whole when it died
    else:
        assert found["a"].entry.fault.startswith("worker process crashed twice")
        assert (tmp_path / "deaths").read_text() == "xx"


def test_an_error_of_the_caller_ends_the_processes(jobs):
    def asked():
        with ProcessScheduler(2) as processes:
            for _ in processes.run_jobs(jobs):
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        asked()
    assert multiprocessing.active_children() == []


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="processes are ended otherwise here")
def test_a_process_that_crashed_between_clips_costs_the_next_one_attempt(jobs, monkeypatch):
    with ProcessScheduler(1) as processes:
        start = processes._start

        def start_and_kill(preload):
            process = start(preload)
            if len(processes._processes) == 1:
                process._process.kill()
                process._process.join()
            return process

        monkeypatch.setattr(processes, "_start", start_and_kill)
        found = by_name(processes.run_jobs([jobs[0], jobs[2]]))
        assert len(processes._processes) == 2
    assert {name: outcome.state for name, outcome in found.items()} == {
        "a": ClipState.DONE,
        "c": ClipState.DONE,
    }


def test_processes_that_cannot_be_started_are_an_error_of_the_machine(jobs, monkeypatch):
    def die(*_):
        raise EOFError("unexpected EOF")

    monkeypatch.setattr(multiprocessing.context.ForkServerProcess, "_Popen", die)
    monkeypatch.setattr(multiprocessing.context.SpawnProcess, "_Popen", die)
    with pytest.raises(ClusterError, match="no process can be started on this machine"):
        list(ProcessScheduler(1).run_jobs(jobs))


@pytest.mark.parametrize(
    ("module", "error"),
    [
        (local.PRELOAD, "OSError(5, 'no')"),
        (local.PRELOAD_PAGE, "ImportError('no')"),
        (local.PRELOAD, "MemoryError()"),
    ],
)
def test_what_cannot_be_imported_in_advance_ends_nothing(run_process, module, error):
    """The process from which others are forked would print a traceback and die."""
    script = (
        "import sys\n"
        "class Failing:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name in ('numpy', 'jinja2'):\n"
        f"            raise {error}\n"
        "sys.meta_path.insert(0, Failing())\n"
        f"import {module}\n"
        "print('numpy' in sys.modules)\n"
    )
    outcome = run_process("-c", script)
    assert (outcome.code, outcome.err) == (0, "")


def test_what_is_imported_in_advance_is_what_the_jobs_need(run_process):
    script = f"import sys, {local.PRELOAD}, {local.PRELOAD_PAGE}; print(*sys.modules)"
    found = run_process("-c", script).out.split()
    assert {"cageik_cli.batch.jobs", "cageik_cli.report.html.page"} <= {*found}
