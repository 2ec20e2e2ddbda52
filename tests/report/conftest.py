"""A result on disk, and the same numbers taken from it by plain h5py."""

from dataclasses import dataclass, replace

import h5py
import numpy as np
import pytest

from cageik_cli.extraction import extract
from cageik_cli.inputs import ExtractSettings
from cageik_cli.report import Limits, report_of
from cageik_cli.report.gates import judged
from cageik_cli.store.result import Result


@dataclass(frozen=True, eq=False)
class Case:
    """A result, its frames (F, m, 3), their reconstructions, and the faces."""

    result: Result
    frames: np.ndarray
    rebuilt: np.ndarray
    faces: np.ndarray


@pytest.fixture(scope="session")
def case_of(tmp_path_factory, animation, write_obj):
    """Extract frames of the little model, all or some of its faces."""

    def extracted(frames, faces):
        folder = tmp_path_factory.mktemp("case")
        np.savez(folder / "clip.npz", verts=frames, faces=faces)
        cage = write_obj(folder / "cage.obj", animation.cage.vertices, animation.cage.faces)
        result = extract(ExtractSettings((str(folder / "clip.npz"),), cage, folder / "cages.h5"))
        with h5py.File(result.path) as file:
            rebuilt = file["weights"][:] @ file["verts"][:]
        return Case(result, frames, rebuilt, faces)

    return extracted


@pytest.fixture(scope="session")
def closed(case_of, animation) -> Case:
    return case_of(animation.frames, animation.rest.faces)


@pytest.fixture(scope="session")
def opened(case_of, animation) -> Case:
    return case_of(animation.frames, animation.rest.faces[2:])


@pytest.fixture(scope="session")
def made(closed):
    """A report of these errors, changes of volume and deviations; None is a skipped frame."""
    report = report_of(closed.result)

    def make(errors, changes=None, names="frame_{}", limits=()):
        changes = [None] * len(errors) if changes is None else changes
        frames = tuple(
            replace(
                report.frames[0],
                index=k,
                name=names.format(k),
                rms_percent=error,
                max_deviation_percent=None if error is None else 3 * error,
                volume_change=change,
                skipped="it is bad" if error is None else None,
            )
            for k, (error, change) in enumerate(zip(errors, changes, strict=True))
        )
        known = [-1.0 if error is None else error for error in errors]
        worst = int(np.argmax(known))
        summary = replace(
            report.summary,
            worst_frame=frames[worst].name,
            worst_frame_index=worst,
            worst_frame_rms_percent=known[worst],
            rms_percent=known[worst] / 2,
        )
        gates = judged("made", summary, Limits(tuple(limits)))
        return replace(report, frames=frames, summary=summary, gates=gates)

    return make
