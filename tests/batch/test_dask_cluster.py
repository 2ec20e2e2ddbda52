"""A batch on a cluster of two processes: the same bytes as one process, whoever dies."""

import logging
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import dask
import distributed
import numpy as np
import pytest

import cageik_cli
from cageik_cli.batch import dask_cluster as module
from cageik_cli.batch.dask_cluster import (
    ClipContext,
    DaskScheduler,
    pickle_without_weights,
    split_into_pieces,
    unpickle_with_weights,
    wait_for_checkpoint,
)
from cageik_cli.batch.jobs import ClipJob, ClipState, bind_clip, check_clip, run_clip
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.method.solve.blocks import BlockSolver
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.run.executor import MemoryPlan
from cageik_cli.run.extraction import Extraction
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.store.binding_file import write_binding
from cageik_cli.store.checkpoint import checkpoint_progress
from cageik_cli.store.result import checkpoint_path, read_result
from cageik_cli.util.errors import ClusterError, FileAccessError, InputError
from cageik_cli.util.files import open_locked
from cageik_cli.util.progress import ProgressListener

pytestmark = pytest.mark.slow

SINGLE_FRAME_BLOCKS = "from cageik_cli.run import executor; executor.MAX_BLOCK_FRAMES = 1"
"""What worker processes run first, so that little clips have several blocks."""


@pytest.fixture(autouse=True)
def _small_blocks(single_frame_blocks):
    """Clips are also solved in this process, to compare."""


def two_processes():
    """Two worker processes of one thread, and their scheduler, which is in this process."""
    return distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",
        silence_logs=False,
        preload=SINGLE_FRAME_BLOCKS,
    )


@pytest.fixture(scope="module")
def workers():
    with two_processes() as local:
        yield local


@pytest.fixture
def job(tmp_path, animation, write_obj):
    """Make the job of a clip of so many frames."""
    write_obj(tmp_path / "cage.obj", animation.cage.vertices, animation.cage.faces)

    def made(name, count=5, **options):
        frames = tmp_path / name / "frames"
        for k in range(count):
            vertices = animation.frames[k % 5] * (1 + k // 5 / 100)
            write_obj(frames / f"frame_{k}.obj", vertices, animation.rest.faces)
        settings = {
            "frames": (str(frames),),
            "cage": tmp_path / "cage.obj",
            "output": tmp_path / name / "cluster.h5",
            "bind": BindSettings("mean-value"),
            "resume": True,
            "overwrite": True,
        }
        return ClipJob(name, ExtractSettings(**settings | options), has_page=False)

    return made


def outcomes(workers, jobs, **options):
    """What came of each job, by its name."""
    with DaskScheduler(workers.scheduler_address, **options) as cluster:
        return {outcome.entry.name: outcome for outcome in cluster.run_jobs(jobs)}


def local_bytes(job):
    """What the result's file holds when one process makes it."""
    output = job.settings.output.with_name("local.h5")
    outcome = run_clip(replace(job, settings=replace(job.settings, output=output)))
    assert outcome.state is ClipState.DONE, outcome.entry.fault
    return output.read_bytes()


def tasks_done(workers, prefix):
    """Keys of tasks that have ended, once for each time."""
    log = list(workers.scheduler.transition_log)
    return [key for key, _, end, *_ in log if end == "memory" and str(key).startswith(prefix)]


def test_results_are_the_bytes_of_one_process(workers, job):
    jobs = [job("a"), job("b", 7), job("long", 60)]
    found = outcomes(workers, jobs, piece_seconds=0.0)
    assert {outcome.state for outcome in found.values()} == {ClipState.DONE}, found
    for each in jobs:
        assert each.settings.output.read_bytes() == local_bytes(each)
        assert found[each.name].entry == replace(run_clip(each).entry)
    assert tasks_done(workers, "solve_piece")


def test_a_long_clip_is_solved_in_pieces_with_few_at_once(workers, job):
    workers.scheduler.transition_log.clear()
    found = outcomes(workers, [job("long", 100)], piece_seconds=0.0)
    assert found["long"].state is ClipState.DONE
    assert len(tasks_done(workers, "solve_piece")) == 99
    alive, most = set(), 0
    for key, _, end, *_ in workers.scheduler.transition_log:
        if str(key).startswith("solve_piece"):
            (alive.discard if end == "forgotten" else alive.add)(key)
            most = max(most, len(alive))
    assert most <= 12  # four, and those of which the scheduler has not heard yet


def test_short_clips_are_not_divided(workers, job):
    workers.scheduler.transition_log.clear()
    found = outcomes(workers, [job("short", 20)], piece_seconds=60.0)
    assert found["short"].state is ClipState.DONE
    assert tasks_done(workers, "solve_piece") == []


def test_weights_are_computed_once_and_sent_once(job, animation, write_obj, tmp_path):
    other = write_obj(tmp_path / "other.obj", 1.1 * animation.cage.vertices, animation.cage.faces)
    jobs = [job(name, 50) for name in "abc"] + [job("d", cage=other)]
    # Workers that know nothing yet of how quick such clips are share them evenly, and a scheduler
    # without its memory manager takes no copy back for which no task waits at the moment it looks.
    with (
        dask.config.set({"distributed.scheduler.active-memory-manager.start": False}),
        two_processes() as fresh,
        distributed.Client(fresh.scheduler_address) as client,
    ):
        for some in (jobs[:3], jobs[3:]):
            found = outcomes(fresh, some, piece_seconds=0.0)
            assert {outcome.state for outcome in found.values()} == {ClipState.DONE}
        weights = tasks_done(fresh, "weights-")
        assert len(weights) == len(set(weights)) == 2
        travelled = [
            [key for key in keys if key in weights] for keys in client.run(received).values()
        ]
    assert any(travelled)
    assert [len(set(keys)) for keys in travelled] == [len(keys) for keys in travelled]


def received(dask_worker):
    return [str(key) for entry in dask_worker.transfer_incoming_log for key in entry["keys"]]


def test_a_cage_is_built_once_for_clips_of_one_rest_pose(workers, job, tmp_path):
    workers.scheduler.transition_log.clear()
    options = {"cage": None, "build": BuildSettings(20), "fit": False, "cache": tmp_path / "kept"}
    jobs = [job("a", **options), job("b", 7, **options), job("c", **options)]
    found = outcomes(workers, jobs)
    assert {outcome.state for outcome in found.values()} == {ClipState.DONE}, found
    assert len(tasks_done(workers, "weights-")) == 1
    assert len(list((tmp_path / "kept").glob("*.cage"))) == 1
    results = [read_result(each.settings.output) for each in jobs]
    assert len({result.sources["cage"]["sha256"] for result in results}) == 1
    for each in jobs:
        assert each.settings.output.read_bytes() == local_bytes(each)
    again = outcomes(workers, jobs)
    assert {outcome.state for outcome in again.values()} == {ClipState.UNCHANGED}


def test_the_rest_frame_of_a_clip_in_pieces_is_chosen(workers, job):
    chosen = job("chosen", 60, rest_frame="auto")
    found = outcomes(workers, [chosen], piece_seconds=0.0)
    assert found["chosen"].state is ClipState.DONE, found
    assert chosen.settings.output.read_bytes() == local_bytes(chosen)


def test_existing_results_are_kept(workers, job):
    jobs = [job("a"), job("b", 7)]
    first = outcomes(workers, jobs)
    stamps = [each.settings.output.stat().st_mtime_ns for each in jobs]
    workers.scheduler.transition_log.clear()
    again = outcomes(workers, jobs)
    assert {outcome.state for outcome in again.values()} == {ClipState.UNCHANGED}
    assert {name: o.entry for name, o in again.items()} == {n: o.entry for n, o in first.items()}
    assert [each.settings.output.stat().st_mtime_ns for each in jobs] == stamps
    assert tasks_done(workers, "weights-") == []


def test_a_worker_is_killed_in_the_middle(workers, job):
    """First the one that keeps the log of the clip, then another of those that solve pieces."""
    jobs = [job("long", 250), job("short")]
    killed = []

    def kill():
        while len(killed) < 2:
            time.sleep(0.02)
            done = len(tasks_done(workers, "solve_piece"))
            holders = [
                task.processing_on
                for key, task in list(workers.scheduler.tasks.items())
                if str(key).startswith("run_clip_task") and task.processing_on
            ]
            if done > 30 * (1 + len(killed)) and holders:
                pid = workers.workers[holders[0].name].pid
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)

    workers.scheduler.transition_log.clear()
    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    found = outcomes(workers, jobs, piece_seconds=0.0)
    killer.join(1)
    assert len(set(killed)) == 2
    for each in jobs:
        assert found[each.name].entry.fault is None
        assert each.settings.output.read_bytes() == local_bytes(each)


def test_clips_of_one_file_and_binding_files(workers, job, animation, tmp_path):
    """What is read once for all frames, and weights that nobody computes."""
    clip = tmp_path / "clip.npz"
    np.savez(clip, verts=np.concatenate([animation.frames] * 6), tris=animation.rest.faces)
    stored = tmp_path / "binding.h5"
    first = job("first")
    write_binding(stored, bind_clip(first), overwrite=False)
    jobs = [
        job("packed", 0, frames=(str(clip),)),
        job("bound", 30, cage=None, binding=stored),
        job("again", cage=None, binding=stored),
    ]
    (tmp_path / "packed").mkdir()
    workers.scheduler.transition_log.clear()
    found = outcomes(workers, jobs, piece_seconds=0.0)
    assert [found[each.name].entry.fault for each in jobs] == [None] * 3
    assert len(tasks_done(workers, "solve_piece")) == 29 * 2 + 4
    assert len(tasks_done(workers, "weights-")) == 2
    for each in jobs:
        assert each.settings.output.read_bytes() == local_bytes(each)


def test_a_bad_frame_far_into_a_clip(workers, job):
    """It ends the clip with the sentence of a local run, or is skipped as there."""
    jobs = [job("stops", 40), job("skips", 40, on_bad_frame="skip"), job("sound")]
    for each in jobs[:2]:
        Path(each.settings.frames[0], "frame_33.obj").write_text("v 1 2 3\n")
    found = outcomes(workers, jobs, piece_seconds=0.0)
    assert [found[each.name].state.value for each in jobs] == ["failed", "done", "done"]
    fault = found["stops"].entry.fault
    assert "frame_33.obj" in fault
    assert checkpoint_progress(checkpoint_path(jobs[0].settings.output)) == (33, 40)
    assert run_clip(jobs[0]).entry.fault == fault
    assert jobs[1].settings.output.read_bytes() == local_bytes(jobs[1])


def test_failures_are_those_of_a_local_run(workers, job, animation, write_obj, tmp_path):
    small = write_obj(tmp_path / "small.obj", animation.cage.vertices / 4, animation.cage.faces)
    jobs = [
        job("nothing", frames=(str(tmp_path / "no.obj"),)),
        job("outside", cage=small),
        job("sound"),
        job("also outside", cage=small),
    ]
    found = outcomes(workers, jobs)
    assert [found[each.name].state.value for each in jobs] == ["failed", "failed", "done", "failed"]
    for each in (jobs[0], jobs[1], jobs[3]):
        assert found[each.name] == run_clip(each)


def test_a_clip_that_crashes_every_worker_fails_alone(workers, job, monkeypatch):
    monkeypatch.setattr(module, "check_clip", deadly)
    monkeypatch.setattr(workers.scheduler, "allowed_failures", 1)
    found = outcomes(workers, [job("deadly"), job("sound")])
    assert found["sound"].state is ClipState.DONE
    fault = found["deadly"].entry.fault
    assert found["deadly"].state is ClipState.FAILED
    assert fault.startswith("2 workers crashed")
    assert "tcp://" in fault
    assert "memory" in fault


def deadly(job):
    if job.name == "deadly":
        os._exit(1)
    return check_clip(job)


def test_a_stopped_batch_ends_its_tasks(workers, job):
    """What is done stays; the worker that keeps a log lets it go, and its result is not written."""
    short, long = job("short"), job("long", 400)
    with DaskScheduler(workers.scheduler_address, piece_seconds=0.0) as cluster:
        stopped = cluster.run_jobs([short, long])
        assert next(stopped).entry.name == "short"
        stopped.close()  # as when an interrupt unwinds it
    assert short.settings.output.exists()
    log = checkpoint_path(long.settings.output)
    wait_for_checkpoint(log, 20.0)
    assert checkpoint_progress(log)[0] < 400
    assert not long.settings.output.exists()
    found = outcomes(workers, [short, long])
    assert (found["short"].state, found["long"].state) == (ClipState.UNCHANGED, ClipState.DONE)
    assert long.settings.output.read_bytes() == local_bytes(long)


@pytest.fixture
def threaded():
    """Make a cluster in this process, which has so many workers of so many threads."""
    with ExitStack() as stack:

        def made(workers, threads=1):
            local = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=threads,
                processes=False,
                dashboard_address="127.0.0.1:0",
            )
            return stack.enter_context(local)

        yield made


def test_pieces_that_crash_every_worker(threaded, job, monkeypatch):
    monkeypatch.setattr("cageik_cli.batch.dask_cluster.solve_piece", killing)
    long = job("long", 30)
    found = outcomes(threaded(1), [long], piece_seconds=0.0)
    fault = found["long"].entry.fault
    assert fault.startswith("4 workers crashed")
    assert "tcp://w:1" in fault
    assert checkpoint_progress(checkpoint_path(long.settings.output)) == (1, 30)


def killing(common, bound, starts):
    last = SimpleNamespace(address="tcp://w:1")
    raise distributed.KilledWorker("solve_piece", last, 3)


def test_an_error_of_a_task_is_a_failure_of_its_clip(threaded, job, monkeypatch):
    monkeypatch.setattr(module, "run_clip_task", faulty)
    found = outcomes(threaded(1), [job("a")])
    assert found["a"].state is ClipState.FAILED
    assert "ZeroDivisionError" in found["a"].entry.fault


def faulty(*arguments):
    raise ZeroDivisionError("by zero")


def refusal(address, kind=ClusterError, **options):
    with pytest.raises(kind) as caught, DaskScheduler(address, **options):
        pass
    return str(caught.value)


@pytest.mark.parametrize(
    ("address", "reason"),
    [
        ("tcp://127.0.0.1:1", "Timed out"),
        ("127.0.0.1", "missing port number"),
        ("odd://127.0.0.1:8786", "unknown address scheme"),
    ],
)
def test_no_scheduler_answers(monkeypatch, address, reason):
    monkeypatch.setattr(module, "CONNECT_TIMEOUT", 0.3)
    found = refusal(address)
    assert found.startswith(f"{address}: ")
    assert reason in found


def test_no_worker_comes(threaded):
    address = threaded(0).scheduler_address
    found = refusal(address, worker_timeout=0.2)
    assert found.startswith(f"{address}: no worker for 0.2 s")
    assert f"dask worker {address} --nthreads 1" in found


def test_workers_have_one_thread(threaded):
    found = refusal(threaded(1, 3).scheduler_address)
    assert "has 3 threads, expected 1" in found
    assert found.endswith("`dask worker --nthreads 1 --nworkers 3`")


def test_workers_have_this_version(workers, monkeypatch):
    monkeypatch.setattr(module, "__version__", "9.9")
    found = refusal(workers.scheduler_address)
    assert found.startswith("worker tcp://")
    assert f"has cageik {cageik_cli.__version__}, expected cageik 9.9" in found


def test_workers_have_cageik_at_all(workers, monkeypatch):
    monkeypatch.setattr(module, "PACKAGE_NAME", "no-such-package")
    assert "has no cageik (No package metadata was found" in refusal(workers.scheduler_address)


def test_distributed_is_not_installed(monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "distributed"]:
        monkeypatch.setitem(sys.modules, name, None)
    found = refusal("tcp://127.0.0.1:8786", InputError)
    assert found == (
        "the scheduler tcp://127.0.0.1:8786 needs distributed, which is not "
        "installed: pip install distributed"
    )


OTHER_CLUSTER = """
import sys, time
from distributed import LocalCluster
with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0") as local:
    print(local.scheduler_address, flush=True)
    time.sleep({seconds})
    local.scale(0)
    time.sleep(60)
"""


@pytest.fixture
def elsewhere():
    """Start a cluster in a process of its own, whose worker leaves after some seconds."""
    started = []

    def start(seconds):
        words = [sys.executable, "-c", OTHER_CLUSTER.format(seconds=seconds)]
        process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        started.append(process)
        return process, process.stdout.readline().strip()

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_the_scheduler_is_lost(elsewhere, job):
    process, address = elsewhere(60)
    with DaskScheduler(address, piece_seconds=0.0) as cluster:
        found = cluster.run_jobs([job("short"), job("long", 300)])
        assert next(found).entry.name == "short"
        process.kill()
        with pytest.raises(ClusterError, match=f"{address}: .*resume"):
            next(found)


def test_the_last_worker_leaves(elsewhere, job):
    _, address = elsewhere(1.5)
    with DaskScheduler(address, worker_timeout=0.5, piece_seconds=0.0) as cluster:
        found = cluster.run_jobs([job("long", 3000)])
        with pytest.raises(ClusterError, match=r"no worker for 0\.5 s"):
            next(found)


def test_a_checkpoint_in_use_is_waited_for(job):
    clip = job("a")
    log = checkpoint_path(clip.settings.output)
    held = open_locked(log)
    wait_for_checkpoint(log, 0.2)
    assert "another run is writing it" in run_clip(clip).entry.fault
    timer = threading.Timer(0.3, held.close)
    timer.start()
    wait_for_checkpoint(log, 20.0)
    timer.join()
    assert run_clip(clip).state is ClipState.DONE


def test_files_that_changed_since_the_start_are_refused(job):
    settings = job("a").settings
    extraction = Extraction(settings)
    extraction.open()
    bound = extraction.bind()
    solver = DualLaplacianSolver(bound.binding, settings.solve)
    work = BlockSolver(extraction.sequence, solver, ProgressListener())
    common = ClipContext(settings, work, MemoryPlan(1, 1, 1, 1))
    copy = pickle.loads(pickle.dumps(common))
    assert copy.build_block_solver(bound.binding).sequence.names == extraction.sequence.names
    Path(settings.frames[0], "frame_4.obj").unlink()
    with pytest.raises(FileAccessError, match="found 4, expected 5"):
        pickle.loads(pickle.dumps(common)).build_block_solver(bound.binding)


def test_a_solver_is_pickled_without_its_weights(job, animation):
    binding = bind_clip(job("a")).binding
    solver = DualLaplacianSolver(binding, SolveSettings())
    data = pickle_without_weights(binding, solver)
    assert binding.weights.tobytes() not in data
    again = unpickle_with_weights(binding, data)
    assert again.binding is binding
    assert np.array_equal(again.solve(animation.frames).cages, solver.solve(animation.frames).cages)


@pytest.mark.parametrize("size", [1, 2, 3, 50])
@pytest.mark.parametrize("starts", [range(0, 50, 16), range(32, 50, 1), range(7, 8, 5)])
def test_pieces_hold_every_block_once(starts, size):
    pieces = list(split_into_pieces(starts, size))
    assert [start for piece in pieces for start in piece] == list(starts)
    assert [piece.start for piece in pieces[1:]] == [piece.stop for piece in pieces[:-1]]
    assert pieces[-1].stop == starts.stop
    assert max(map(len, pieces)) <= size


def test_logs_of_libraries_are_kept_off_the_terminal(workers):
    names = ("distributed", "distributed.client", "tornado", "asyncio")
    loggers = [logging.getLogger(name) for name in names]
    before = [logger.level for logger in loggers]
    with DaskScheduler(workers.scheduler_address):
        assert not any(logger.isEnabledFor(logging.CRITICAL) for logger in loggers)
    assert [logger.level for logger in loggers] == before
