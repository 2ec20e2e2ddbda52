"""One set of weights for all clips of a model: fitted once, before the clips are extracted."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cageik_cli.batch.jobs import ClipJob
from cageik_cli.fit.fitted import FittedWeights
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.report.overview import ClipEntry
from cageik_cli.run.extraction import Extraction
from cageik_cli.run.fit import choose_norm, fit_to_clips
from cageik_cli.store.binding_file import StoredBinding, write_binding
from cageik_cli.store.cache import compute_key
from cageik_cli.util.errors import InputError, describe_error, join_truncated
from cageik_cli.util.messages import Spelling, spell
from cageik_cli.util.outputs import make_folder
from cageik_cli.util.progress import ProgressListener, note_all
from cageik_cli.util.text import format_count, number_file_names, to_unicode

BINDINGS_FOLDER = "bindings"
"""The folder of the bindings that clips share, inside the output folder."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenedClip:
    """A clip that was opened, and its job."""

    job: ClipJob
    extraction: Extraction


def share_fits(
    jobs: Sequence[ClipJob],
    output: Path,
    progress: ProgressListener,
    *,
    spelling: Spelling,
    count: int,
) -> tuple[list[ClipJob], list[ClipEntry]]:
    """Fit weights to all clips of each model; return jobs that take them, and clips without any.

    Clips are of one model if they have the same faces, unit, up axis and options. Its rest pose is
    that of the first clip. A clip that cannot be read is left out of the fit; its job says why.
    Where a fit fails, its clips are listed with the reason, as of any other clip that fails.

    Parameters
    ----------
    output : Path
        The folder of the batch, where the bindings go.
    count : int
        Threads.
    """
    groups: dict[str, list[OpenedClip]] = {}
    shared: dict[str, ClipJob] = {job.name: job for job in jobs}
    for job in jobs:
        extraction = Extraction(replace(job.settings, fit=False, resume=False))
        try:
            extraction.open()
        except Exception:
            continue  # its job says so, in its own process
        groups.setdefault(_find_model(extraction), []).append(OpenedClip(job, extraction))
    names = number_file_names(clips[0].job.settings.output.stem for clips in groups.values())
    rejected = []
    for name, clips in zip(names, groups.values(), strict=True):
        path = output / BINDINGS_FOLDER / f"{name}.h5"
        try:
            with progress.stage("fit"):
                make_folder(path.parent)
                stored, fitted = _fit_readable(clips, progress, count)
                write_binding(path, stored, overwrite=True)
        except Exception as error:
            fault = to_unicode(spell(describe_error(error), spelling))
            rejected += [ClipEntry(clip.job.name, fault=fault) for clip in clips]
            for clip in clips:
                del shared[clip.job.name]
            continue
        place = f"{BINDINGS_FOLDER}/{path.name}"
        members = join_truncated(clip.job.name for clip in fitted)
        text = f"{place}: one set of weights for {format_count(len(fitted), 'clip')}: {members}"
        progress.note("fit", text)
        for clip in clips:
            shared[clip.job.name] = _take_binding(clip.job, path)
    return list(shared.values()), rejected


def _find_model(extraction: Extraction) -> str:
    """Return a digest of what clips of one model have in common."""
    plain = replace(
        extraction.settings,
        frames=(),
        output=Path(),
        clip=ClipSettings(exclude=extraction.settings.clip.exclude),
        scene=SceneHints(),
    )
    recorded = {"settings": repr(plain), "space": repr(extraction.scene.space)}
    rest = extraction.rest.mesh
    return compute_key(recorded, rest.faces, np.array(len(rest.vertices)))


def _take_binding(job: ClipJob, path: Path) -> ClipJob:
    """Return a job with the weights, the cage and the rest pose of a binding."""
    settings = replace(job.settings, binding=path, cage=None, fit=None, rest=path, rest_frame=0)
    return replace(job, settings=settings)


def _fit_readable(
    clips: Sequence[OpenedClip], progress: ProgressListener, count: int
) -> tuple[StoredBinding, list[OpenedClip]]:
    """Fit the weights of a model to all its clips but those that cannot be read; return these."""
    first = clips[0].extraction
    first.settings = replace(first.settings, jobs=count)
    stored, left = first.bind(), list(clips)
    while True:
        try:
            return stored.with_fit(_fit(stored, left, progress, count)), left
        except InputError as error:
            readable = [clip for clip in left if not _fails_at(clip, error.locations[:1])]
            if len(readable) in (0, len(left)):
                raise
            left = readable


def _fails_at(clip: OpenedClip, locations: Iterable[object]) -> bool:
    """Return whether a frame of a clip at some locations cannot be read; other clips have alike."""
    sequence, places = clip.extraction.sequence, set(map(str, locations))
    for k in range(len(sequence)):
        if sequence.location(k) in places:
            try:
                sequence.read_frame(k)
            except InputError:
                return True
    return False


def _fit(
    stored: StoredBinding, clips: Sequence[OpenedClip], progress: ProgressListener, count: int
) -> FittedWeights:
    first, asked = clips[0].extraction, clips[0].job.settings
    fit = asked.fit if isinstance(asked.fit, FitSettings) else FitSettings()
    sequences = [clip.extraction.sequence for clip in clips]
    fitted, notes = fit_to_clips(
        stored.binding,
        sequences,
        fit,
        progress,
        solve=choose_norm(asked.solve, fit, sequences),
        vertex_weights=first.vertex_weights.vertices,
        memory=asked.memory,
        jobs=count,
        skips_bad_frames=asked.skips_bad_frames,
        cache=asked.cache,
    )
    note_all(progress, notes)
    return fitted
