"""Results on disk, and the same numbers read from them by plain h5py."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.fit.settings import FitSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.limits import Limits, check_limits
from cageik_cli.report.record import Report, build_report
from cageik_cli.report.render.model_views import PoseSet, load_poses
from cageik_cli.run.edit import edit
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import EditSettings, ExtractSettings
from cageik_cli.store.result import Edit, Result, read_animation
from cageik_cli.view.player.clip import PlayerClip, load_player_clip
from tests.fitted import clip_of, small_binding, true_weights


@dataclass(frozen=True, eq=False)
class Case:
    """A result, its frames (F, m, 3), their reconstructions, and the faces."""

    result: Result
    frames: np.ndarray
    reconstruction: np.ndarray
    faces: np.ndarray


@pytest.fixture(scope="session")
def make_case(tmp_path_factory, animation, write_obj, weights_cache):
    """A function that extracts frames of the small model, with all or some of its faces."""

    def extracted(frames, faces, cage_vertices=None):
        folder = tmp_path_factory.mktemp("case")
        np.savez(folder / "clip.npz", verts=frames, faces=faces)
        given = animation.cage.vertices if cage_vertices is None else cage_vertices
        cage = write_obj(folder / "cage.obj", given, animation.cage.faces)
        clip, output = str(folder / "clip.npz"), folder / "cages.h5"
        result = extract(ExtractSettings((clip,), cage, output, cache=weights_cache))
        with h5py.File(result.path) as file:
            reconstruction = file["weights"][:] @ file["verts"][:]
        return Case(result, frames, reconstruction, faces)

    return extracted


@pytest.fixture(scope="session")
def closed(make_case, animation) -> Case:
    return make_case(animation.frames, animation.rest.faces)


@pytest.fixture(scope="session")
def report(closed) -> Report:
    return build_report(closed.result)


@pytest.fixture(scope="session")
def poses(closed) -> PoseSet:
    """What a page draws of a closed model."""
    return load_poses(closed.result)


@pytest.fixture(scope="session")
def clip(closed) -> PlayerClip:
    """What a player shows of a closed model."""
    return load_player_clip(closed.result)


@pytest.fixture(scope="session")
def opened(make_case, animation) -> Case:
    return make_case(animation.frames, animation.rest.faces[2:])


@pytest.fixture(scope="session")
def make_fitted(tmp_path_factory, write_obj):
    """A function that extracts 12 frames with weights fitted to them, from mean value ones."""

    def extracted(**options) -> Result:
        folder, binding = tmp_path_factory.mktemp("fitted"), small_binding()
        cage = write_obj(folder / "cage.obj", 1.6 * binding.cage.vertices, binding.cage.faces)
        rest = write_obj(folder / "rest.obj", binding.rest.vertices, binding.rest.faces)
        frames = clip_of(binding, true_weights(binding), 12)
        np.savez(folder / "clip.npz", verts=frames, faces=binding.rest.faces)
        return extract(
            ExtractSettings(
                (str(folder / "clip.npz"),),
                cage,
                folder / "cages.h5",
                rest=rest,
                bind=BindSettings("mean-value"),
                fit=FitSettings(**options),
            )
        )

    return extracted


@pytest.fixture(scope="session")
def fitted(make_fitted) -> Result:
    return make_fitted()


HANDLES = [
    {"name": "tip", "vertex": 0, "offset": [0.1, 0.2, -0.3]},
    *({"name": f"pin {k}", "vertex": k, "pin": True} for k in (3, 7, 11, 15)),
]


@pytest.fixture(scope="session")
def edited(closed) -> Edit:
    """The result of all faces with a vertex moved in the last two frames."""
    return _edited(closed.result)


@pytest.fixture(scope="session")
def edited_open(opened) -> Edit:
    return _edited(opened.result)


def _edited(result: Result) -> Edit:
    handles: Path = result.path.with_name("handles.json")
    handles.write_text(json.dumps({"handles": HANDLES, "frames": [4, 5]}))
    output = result.path.with_name("edited.h5")
    edit(EditSettings(result.path, handles, output))
    return read_animation(output)


@pytest.fixture(scope="session")
def make_report(report):
    """A function that makes a report of errors and volume changes; None is a skipped frame."""

    def make(errors, changes=None, names="frame_{}", limits=(), **time):
        clip = replace(report.clip, **time)
        changes = [None] * len(errors) if changes is None else changes
        frames = tuple(
            replace(
                report.frames[0],
                index=k,
                number=clip.frame_number(k),
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
        gates = check_limits("made", summary, Limits(tuple(limits)))
        return replace(report, clip=clip, frames=frames, summary=summary, gates=gates)

    return make
