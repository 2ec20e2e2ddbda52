"""A batch on a cluster of two processes: the same bytes as one process, whoever dies."""

from dataclasses import replace

import pytest

distributed = pytest.importorskip("distributed")

from cageik_cli.batch.cluster import Cluster
from cageik_cli.batch.jobs import ClipJob, State
from cageik_cli.batch.work import work_on
from cageik_cli.binding import BindSettings
from cageik_cli.inputs import ExtractSettings

ONE_FRAME = 16_000
"""Bytes that the weights, and blocks of one frame of the little animation, have room for."""


@pytest.fixture(scope="module")
def workers():
    """Two worker processes of one thread, and their scheduler, which is in this process."""
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        silence_logs=False,
    ) as local:
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
            "memory": ONE_FRAME,
        }
        return ClipJob(name, ExtractSettings(**settings | options), has_page=False)

    return made


def outcomes(workers, jobs, **options):
    """What came of each job, by its name."""
    with Cluster(workers.scheduler_address, **options) as cluster:
        return {outcome.entry.name: outcome for outcome in cluster.outcomes(jobs)}


def local_bytes(job):
    """What the result's file holds when one process makes it."""
    output = job.settings.output.with_name("local.h5")
    outcome = work_on(replace(job, settings=replace(job.settings, output=output)))
    assert outcome.state is State.DONE, outcome.entry.fault
    return output.read_bytes()


def tasks_done(workers, prefix):
    """Keys of tasks that have ended, once for each time."""
    log = list(workers.scheduler.transition_log)
    return [key for key, _, end, *_ in log if end == "memory" and str(key).startswith(prefix)]


def test_results_are_the_bytes_of_one_process(workers, job):
    jobs = [job("a"), job("b", 7), job("long", 60)]
    found = outcomes(workers, jobs, piece_seconds=0.0)
    assert {outcome.state for outcome in found.values()} == {State.DONE}, found
    for each in jobs:
        assert each.settings.output.read_bytes() == local_bytes(each)
        assert found[each.name].entry == replace(work_on(each).entry)
    assert tasks_done(workers, "solved_piece")
