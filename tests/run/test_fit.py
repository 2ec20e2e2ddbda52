"""Fitted weights through whole runs: the cache, the files, and what reads them."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.fit.fit import Fitter
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.write import Output
from cageik_cli.inputs.settings import WeightSettings
from cageik_cli.method.weights.binding import Poses, reconstruct_frames
from cageik_cli.report.fit_rows import list_fit_notes
from cageik_cli.report.html.page import build_quality_rows
from cageik_cli.report.overview import Overview, build_clip_entry
from cageik_cli.report.record import build_report
from cageik_cli.report.views.data import format_overview_csv
from cageik_cli.report.views.markdown import format_markdown
from cageik_cli.report.views.text import format_text
from cageik_cli.run.bind import bind_files
from cageik_cli.run.deform import deform
from cageik_cli.run.edit import edit
from cageik_cli.run.export import export
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import (
    BindRunSettings,
    DeformSettings,
    EditSettings,
    ExportSettings,
    ExtractSettings,
)
from cageik_cli.store.binding_file import read_binding
from cageik_cli.store.checkpoint import Checkpoint, checkpoint_progress
from cageik_cli.store.result import (
    checkpoint_path,
    read_animation,
    read_cages,
    read_key_frames,
    read_rotations,
)
from cageik_cli.store.result import read_binding as read_result_binding
from cageik_cli.util.errors import CheckpointError, InputError, SettingError
from tests.fitted import small_binding, smooth_motion
from tests.listeners import Listener
from tests.texts import texts

FORMS = {
    "dense": FitSettings(),
    "low rank": FitSettings(rank=3),
    "few": FitSettings(influences=4),
}
BINDING = small_binding()


FRAMES = smooth_motion(BINDING, 20)


def count_hits(listener):
    """How many fits were in the cache."""
    hits = [text for topic, text in listener.notes if topic == "fit"]
    return sum(text.startswith("cache hit") for text in hits)


@pytest.fixture
def clip(tmp_path, monkeypatch, write_obj, coarse_panels):
    """The current folder, with frames, a rest pose and a cage with room around it."""
    monkeypatch.chdir(tmp_path)
    for k, frame in enumerate(FRAMES):
        write_obj(tmp_path / "frames" / f"f_{k:03}.obj", frame, BINDING.rest.faces)
    write_obj(tmp_path / "rest.obj", BINDING.rest.vertices, BINDING.rest.faces)
    write_obj(tmp_path / "cage.obj", 1.6 * BINDING.cage.vertices, BINDING.cage.faces)
    return tmp_path


@pytest.fixture
def settings(clip):
    return ExtractSettings(
        ("frames",),
        Path("cage.obj"),
        Path("cages.h5"),
        rest=Path("rest.obj"),
        cache=Path("cache"),
        overwrite=True,
        fit=FitSettings(),
    )


def meshes_of(result):
    binding = read_result_binding(result)
    cages = np.concatenate(list(read_cages(result, 64)))
    return reconstruct_frames(binding, Poses(cages, read_rotations(result)))


def read_objs(folder):
    return np.array(
        [
            [line.split()[1:4] for line in path.read_text().splitlines() if line[:2] == "v "]
            for path in sorted(Path(folder).iterdir())
        ],
        float,
    )


def test_fitted_weights_are_nearer_and_say_so(settings):
    plain = extract(replace(settings, fit=None, output=Path("plain.h5")))
    result = extract(settings)
    errors = [np.sqrt(np.mean(one.metrics.rms**2)) for one in (result, plain)]
    assert errors[0] < 0.5 * errors[1]
    report = result.fit.report
    percent = 100 / result.rest.diagonal
    assert report.fitted.fitted.rms == pytest.approx(percent * errors[0], rel=1e-6)
    assert report.fitted.unfitted.rms == pytest.approx(percent * errors[1], rel=1e-6)
    assert [clip.frames for clip in result.fit.clips] == [20]
    assert result.settings["fit_regularization"] == "auto"
    assert result.bound.rms_percent == plain.bound.rms_percent < report.fitted.fitted.rms


@pytest.mark.parametrize("form", FORMS)
def test_binding_result_and_deform_give_the_same_meshes(settings, form):
    """From the fit to the file of the binding, to a result of it, to frames on disk."""
    fit = FORMS[form]
    direct = extract(replace(settings, fit=fit))
    expected = meshes_of(direct)
    rms = np.sqrt(np.square(expected - FRAMES).sum(axis=2).mean(axis=1))
    np.testing.assert_allclose(rms, direct.metrics.rms, rtol=1e-9)
    bind_files(
        BindRunSettings(
            Path("cage.obj"), Path("rest.obj"), Path("b.h5"), clips=("frames",), fit=fit
        )
    )
    stored = read_binding(Path("b.h5"))
    assert stored.fit.settings == fit
    assert stored.binding.has_offsets == (form == "few")
    through = extract(
        replace(settings, cage=None, fit=None, binding=Path("b.h5"), output=Path("through.h5"))
    )
    assert through.fit == direct.fit
    np.testing.assert_array_equal(meshes_of(through), expected)
    assert through.settings == direct.settings
    deform(DeformSettings(through.path, Output(Path("out"))))
    np.testing.assert_allclose(read_objs("out"), expected, rtol=0, atol=1e-6)
    key_frames = read_key_frames(through, read_result_binding(through))
    np.testing.assert_allclose(
        key_frames.reconstructed, expected[key_frames.indices], rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("form", FORMS)
def test_an_edit_moves_what_it_shall_and_nothing_else(settings, form):
    result = extract(replace(settings, fit=FORMS[form]))
    before = meshes_of(result)
    Path("handles.json").write_text(
        '{"handles": [{"name": "a", "vertex": 3, "offset": [0.1, 0, 0], "hard": true}],'
        ' "frames": [4, 6]}'
    )
    edit(EditSettings(result.path, Path("handles.json"), Path("edited.h5")))
    edited = read_animation(Path("edited.h5"))
    after = meshes_of(edited)
    np.testing.assert_allclose(after[5, 3] - before[5, 3], [0.1, 0, 0], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(after[:4], before[:4])
    assert edited.fit == result.fit
    assert edited.has_offsets == result.has_offsets


@pytest.mark.parametrize("form", FORMS)
def test_the_cache_gives_what_the_fit_gave(settings, form):
    settings = replace(settings, fit=FORMS[form])
    kept, computed = extract(settings).path.read_bytes(), Listener()
    assert extract(settings, computed).path.read_bytes() == kept
    assert count_hits(computed)
    assert extract(replace(settings, cache=None)).path.read_bytes() == kept


def test_the_name_of_a_folder_does_not_matter_to_the_cache(settings):
    extract(settings)
    Path("frames").rename("renamed")
    notes = Listener()
    extract(replace(settings, frames=("renamed",)), notes)
    assert count_hits(notes)


@pytest.mark.parametrize(
    "change",
    ["a frame", "fewer frames", "strength", "alpha", "vertex weights", "memory", "coordinates"],
)
def test_what_the_fit_depends_on_is_fitted_again(settings, write_obj, change):
    extract(settings)
    if change == "a frame":
        write_obj(Path("frames/f_007.obj"), 1.01 * FRAMES[7], BINDING.rest.faces)
    elif change == "fewer frames":
        Path("frames/f_019.obj").unlink()
    elif change == "strength":
        settings = replace(settings, fit=FitSettings(0.2))
    elif change == "alpha":
        settings = replace(settings, solve=replace(settings.solve, alpha=1e-2))
    elif change == "vertex weights":
        np.save("weights.npy", np.linspace(1, 2, len(BINDING.rest.vertices)))
        settings = replace(settings, vertex_weights=Path("weights.npy"))
    elif change == "memory":
        settings = replace(settings, memory=1 << 29)
    else:
        settings = replace(settings, bind=replace(settings.bind, coordinates="mean-value"))
    notes = Listener()
    extract(settings, notes)
    assert not count_hits(notes)


def test_jobs_do_not_change_a_byte(settings):
    settings = replace(settings, cache=None)
    data = [extract(replace(settings, jobs=jobs)).path.read_bytes() for jobs in (1, 2, 5)]
    assert data[0] == data[1] == data[2]


@pytest.fixture
def interrupted(settings, monkeypatch):
    """Settings to resume a run that has ended after its first block."""
    append = Checkpoint.append

    def stop_at_second(checkpoint, block):
        if block.start:
            raise KeyboardInterrupt
        append(checkpoint, block)

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "append", stop_at_second)
        with pytest.raises(KeyboardInterrupt):
            extract(settings)
    assert checkpoint_progress(checkpoint_path(settings.output)) == (16, 20)
    return replace(settings, overwrite=False, resume=True)


@pytest.mark.parametrize("cache", [Path("cache"), None])
def test_a_resumed_run_gives_the_same_bytes(interrupted, cache):
    expected = extract(replace(interrupted, output=Path("whole.h5"))).path.read_bytes()
    notes = Listener()
    assert extract(replace(interrupted, cache=cache), notes).path.read_bytes() == expected
    assert ("resumed", "after 16 of 20 frames") in notes.notes


@pytest.mark.parametrize("frame", [3, 18])
def test_a_frame_that_changed_before_a_run_is_resumed_changes_the_fit(
    interrupted, write_obj, frame
):
    """All frames are solved again, those before the changed one too: their weights are others."""
    write_obj(Path(f"frames/f_{frame:03}.obj"), 1.01 * FRAMES[frame], BINDING.rest.faces)
    expected = extract(replace(interrupted, output=Path("whole.h5"))).path.read_bytes()
    notes = Listener()
    assert extract(interrupted, notes).path.read_bytes() == expected
    text = "after 0 of 20 frames (its weights were fitted to other frames)"
    assert ("resumed", text) in notes.notes


def test_a_run_with_other_settings_of_the_fit_is_not_continued(interrupted):
    with pytest.raises(CheckpointError, match="`fit_regularization=auto`"):
        extract(replace(interrupted, fit=FitSettings(0.2)))


def test_a_frame_that_changes_while_weights_are_fitted_is_refused(settings, write_obj, monkeypatch):
    whole = Fitter.fit

    def slow_fit(*arguments):
        write_obj(Path("frames/f_003.obj"), 1.01 * FRAMES[3], BINDING.rest.faces)
        return whole(*arguments)

    monkeypatch.setattr(Fitter, "fit", slow_fit)
    with pytest.raises(InputError, match=r"f_003\.obj: changed during the run"):
        extract(settings)


@pytest.mark.parametrize("form", FORMS)
def test_missing_vertices_do_not_count(settings, write_obj, form):
    weights = np.ones(len(BINDING.rest.vertices))
    weights[10:14] = 0
    np.save("weights.npy", weights)
    settings = replace(settings, fit=FORMS[form], vertex_weights=Path("weights.npy"))
    clean = extract(settings)
    for k, frame in enumerate(FRAMES):
        wild = frame.copy()
        wild[10:14] += 50
        write_obj(Path(f"frames/f_{k:03}.obj"), wild, BINDING.rest.faces)
    damaged = extract(settings)
    assert damaged.fit.report == clean.fit.report
    np.testing.assert_allclose(damaged.metrics.rms, clean.metrics.rms, rtol=1e-9)


def test_a_binding_is_fitted_to_several_clips(settings, write_obj):
    for k, frame in enumerate(smooth_motion(BINDING, 6, seed=9)):
        write_obj(Path(f"other/f_{k}.obj"), frame, BINDING.rest.faces)
    run = BindRunSettings(
        Path("cage.obj"), Path("rest.obj"), Path("b.h5"), clips=("frames", "other"),
        weights=WeightSettings(cache=Path("cache")),
    )  # fmt: skip
    first, again = Listener(), Listener()
    stored = bind_files(run, first)
    assert [clip.frames for clip in stored.fit.clips] == [20, 6]
    bind_files(replace(run, overwrite=True), again)
    assert count_hits(again)
    result = extract(
        replace(settings, cage=None, fit=None, binding=Path("b.h5"), frames=("other",))
    )
    # Figures of other clips are not those of this one.
    assert build_report(result).summary.gap_closed_percent is None
    assert "closes" not in format_text(build_report(result))


def test_a_clip_of_another_model_is_refused(settings, write_obj):
    write_obj(Path("other/f_1.obj"), BINDING.cage.vertices, BINDING.cage.faces)
    run = BindRunSettings(Path("cage.obj"), Path("rest.obj"), Path("b.h5"), clips=("other",))
    with pytest.raises(InputError, match="other: 18 vertices"):
        bind_files(run)


def test_frames_of_one_file_are_told_apart_by_their_selection(settings):
    from cageik_cli.formats.settings import ClipSettings

    np.savez("clip.npz", verts=FRAMES, faces=BINDING.rest.faces)
    settings = replace(settings, frames=("clip.npz",))
    extract(replace(settings, clip=ClipSettings(slice(0, 10))))
    notes = Listener()
    extract(replace(settings, clip=ClipSettings(slice(10, 20))), notes)
    assert not count_hits(notes)


def test_frames_that_cannot_be_read_are_left_out(settings):
    Path("frames/f_004.obj").write_text("v 0 0\n")
    with pytest.raises(InputError, match=r"f_004\.obj"):
        extract(settings)
    result = extract(replace(settings, on_bad_frame="skip"))
    assert list(result.skipped) == [4]
    assert result.fit.report.fitted_frames == 19


def test_without_weights_a_low_rank_result_is_deformed_as_with_them(settings):
    settings = replace(settings, fit=FORMS["low rank"])
    expected = meshes_of(extract(settings))
    result = extract(replace(settings, keep_weights=False))
    with h5py.File(result.path) as file:
        assert "weights" not in file
    deform(DeformSettings(result.path, Output(Path("out"))))
    np.testing.assert_allclose(read_objs("out"), expected, rtol=0, atol=1e-6)


def test_fitted_weights_are_not_replaced_by_others_in_silence(settings, write_obj):
    """A result without its weights is refused; another mesh is moved, with a note."""
    bind_files(BindRunSettings(Path("cage.obj"), Path("rest.obj"), Path("b.h5"), clips=("frames",)))
    bare = extract(replace(settings, cage=None, fit=None, binding=Path("b.h5"), keep_weights=False))
    with pytest.raises(SettingError, match="fitted to a clip and not in it"):
        deform(DeformSettings(bare.path, Output(Path("out"))))
    write_obj(Path("inner.obj"), 0.9 * BINDING.rest.vertices, BINDING.rest.faces)
    notes = Listener()
    deform(DeformSettings(bare.path, Output(Path("out")), mesh=(Path("inner.obj"),)), notes)
    assert any("the fit is not transferred" in str(text) for _, text in notes.notes)


def test_few_influences_need_the_rotation_of_each_cage(settings):
    result = extract(replace(settings, fit=FORMS["few"]))
    export(ExportSettings((result.path,), Output(Path("edited/c_###.obj"))))
    expected = meshes_of(result)
    deform(DeformSettings(result.path, Output(Path("out")), cages="edited"))
    np.testing.assert_allclose(read_objs("out"), expected, rtol=0, atol=1e-5)
    sorted(Path("edited").iterdir())[-1].unlink()
    with pytest.raises(SettingError, match=r"has 19 cages, expected 20"):
        deform(DeformSettings(result.path, Output(Path("more")), cages="edited"))


def test_contradicting_settings_are_refused(settings):
    with pytest.raises(SettingError, match="brings its weights"):
        replace(settings, cage=None, binding=Path("b.h5"))
    with pytest.raises(SettingError, match="keep_weights"):
        replace(settings, keep_weights=False)
    assert replace(settings, keep_weights=False, fit=FitSettings(rank=2)).fit.rank == 2


def test_a_repeated_clip_is_noted(settings, write_obj):
    for k in range(20):
        write_obj(Path(f"frames/f_{k + 20:03}.obj"), FRAMES[(k + 2) % 20], BINDING.rest.faces)
    report = build_report(extract(settings))
    assert report.fit.report.is_repetitive
    assert any("copies of fitted ones" in note for note in texts(report.notes))
    assert not build_report(
        extract(replace(settings, frames=("frames/f_00*.obj", "frames/f_01*.obj")))
    ).fit.report.is_repetitive


def test_frames_that_were_not_held_out_are_noted(settings):
    report = build_report(extract(replace(settings, frames=("frames/f_003.obj",))))
    assert report.fit.report.held_out_blocks is None
    assert any("no frames were kept aside" in note for note in texts(report.notes))
    assert "  kept aside     none" in format_text(report)


@pytest.mark.parametrize("distinct", [1, len(BINDING.cage.vertices) // 3])
def test_no_bound_is_stated_where_it_is_zero_by_counting(settings, write_obj, distinct):
    """Few poses have no more dimensions than the cage has vertices, however often they repeat."""
    poses = smooth_motion(BINDING, distinct, seed=9)
    for k in range(12):
        write_obj(Path(f"few/f_{k}.obj"), poses[k % distinct], BINDING.rest.faces)
    result = extract(replace(settings, frames=("few/*.obj",), fit=FitSettings()))
    assert result.bound.rms_percent < 1e-3
    report = build_report(result)
    assert report.summary.best_possible_percent is None
    assert report.summary.gap_closed_percent is None
    assert "best possible" not in format_text(report)


def test_every_view_tells_what_the_fit_gains(settings, write_obj):
    """What no cage of 18 vertices can follow is added: there is a bound above zero."""
    noise = 0.01 * np.random.default_rng(0).normal(size=FRAMES.shape)
    for k, frame in enumerate(FRAMES + noise):
        write_obj(Path(f"rough/f_{k:03}.obj"), frame, BINDING.rest.faces)
    result = extract(replace(settings, frames=("rough",), fit=FitSettings(use="play")))
    report = build_report(result)
    fit, summary = result.fit.report, report.summary
    text = format_text(report)
    for shown in (
        f"  fitted frames  {fit.fitted.fitted.rms:.4f} % (99 % of deviations below",
        f"  kept aside     {fit.held_out_blocks.fitted.rms:.4f} % (",
        f"unfitted {fit.held_out_blocks.unfitted.rms:.4f} % (",
        f"  last third     {fit.unseen_third.fitted.rms:.4f} % (",
        f"negative ones sum to {fit.negative_per_row:.3f} per vertex, smallest",
        f"  best possible  {result.bound.rms_percent:.4f} % with any weights and cages",
        f"the fit takes {summary.gap_closed_percent:.0f} % of the way",
        f"  edits          of the cage are {fit.edits.smooth:.2f} times as rough as with the",
    ):
        assert shown in text
    assert "  tried " not in text
    told = format_text(report, is_verbose=True)
    for one in fit.ladder:
        assert f"smoothness {one.smoothness:g}: kept aside {one.held_out_blocks:.4f} %" in told
    assert len(fit.ladder) > 1
    overview = Overview([build_clip_entry(report)])
    assert "### Fitted weights" in format_markdown(overview)
    header, line = format_overview_csv(overview).splitlines()
    row = dict(zip(header.split(","), line.split(","), strict=True))
    assert float(row["held_out_rms_percent"]) == fit.held_out_blocks.fitted.rms
    assert float(row["best_possible_percent"]) == result.bound.rms_percent


@pytest.mark.parametrize(("form", "floats"), [("low rank", 3 * (66 + 18)), ("few", None)])
def test_the_size_counts_what_must_be_stored(settings, form, floats):
    report = build_report(extract(replace(settings, fit=FORMS[form])))
    count = report.summary.fixed_floats
    assert count == (floats or report.fit.report.fixed_floats) < 66 * 18
    assert f"plus {count:,} floats of fitted weights".replace(",", " ") in format_text(report)


def test_offsets_are_not_called_an_error(settings):
    report = build_report(extract(replace(settings, fit=FORMS["few"])))
    assert "offsets of the rest pose up to" in format_text(report)
    assert "rest pose error" not in format_text(report)
    labels = [label for label, *_ in build_quality_rows(report)]
    assert "Rest pose error" not in labels
    assert "Smallest weight" in labels


def test_held_out_frames_that_are_far_off_are_warned_of(settings):
    report = build_report(extract(settings))
    fit = report.fit.report
    near = replace(fit, held_out_blocks=replace(fit.fitted))
    far = replace(fit, fitted=replace(fit.fitted, fitted=replace(fit.fitted.fitted, rms=1e-9)))
    for record, is_warned in ((near, False), (far, True)):
        notes = list_fit_notes(replace(report.fit, report=record))
        assert any("times that of fitted ones" in str(note) for note in notes) == is_warned
