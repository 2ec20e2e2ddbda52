"""Captured clips, end to end: outliers, missing vertices, weights of frames, and what is said."""

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.captured.settings import MAX_SMOOTHING_PERIOD, CaptureSettings
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.geometry.shape import lumped_areas
from cageik_cli.method.solve.regions import Cause
from cageik_cli.method.solve.summary import OcclusionTracker
from cageik_cli.report.html.page import render_result_page
from cageik_cli.report.record import build_report
from cageik_cli.report.views.data import format_csv, format_json
from cageik_cli.report.views.text import format_text
from cageik_cli.run import executor
from cageik_cli.run.bind import bind_files
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import BindRunSettings, ExtractSettings
from cageik_cli.store.checkpoint import Checkpoint
from cageik_cli.store.result import placed_path, read_cages, read_result, smoothed_path
from cageik_cli.util.errors import CheckpointError, FormatError, InputError, SettingError
from cageik_cli.view.player.section import load_player
from tests.corruptions import corrupt
from tests.listeners import Listener
from tests.texts import texts

ROBUST = CaptureSettings(robust=True)
MISSING = ClipSettings(missing=True)


@pytest.fixture(scope="module")
def walk(fixtures_folder):
    """The 48 frames of the walking figure, its faces and its cage."""
    folder = fixtures_folder / "walker"
    paths = [folder / "frames" / f"walker_{k}.obj" for k in range(1, 49)]
    lines = [path.read_text().splitlines() for path in paths]
    frames = [[line.split()[1:4] for line in text if line[:2] == "v "] for text in lines]
    faces = [line.split()[1:4] for line in lines[0] if line[:2] == "f "]
    corners = [[int(word.split("/")[0]) - 1 for word in face] for face in faces]
    return np.array(frames, float), np.array(corners), folder / "cage.obj"


@pytest.fixture(scope="module")
def walker(walk):
    """Every fourth of these frames."""
    frames, faces, cage = walk
    return frames[::4], faces, cage


@pytest.fixture
def make(walker, tmp_path, monkeypatch, weights_cache):
    """Settings for spoilt frames of the walker."""
    monkeypatch.chdir(tmp_path)
    _, faces, cage = walker

    def settings(frames, name="clip", **options):
        np.savez(f"{name}.npz", verts=frames, faces=faces)
        return ExtractSettings(
            frames=(f"{name}.npz",),
            cage=cage,
            output=Path(f"{name}.h5"),
            overwrite=True,
            cache=weights_cache,
            **options,
        )

    return settings


def cages_of(settings, progress=None):
    with h5py.File(extract(settings, progress).path) as file:
        return file["verts"][:], file["weights"][:]


def error_to(frames, cages, weights):
    size = np.linalg.norm(np.ptp(frames[0], axis=0))
    return 100 * np.sqrt(np.mean(((weights @ cages - frames) ** 2).sum(axis=2))) / size


def test_outliers_do_not_move_the_cages(walker, make):
    frames = walker[0]
    spoilt = corrupt("outliers", frames)
    clean = error_to(frames, *cages_of(make(frames, "clean")))
    plain = error_to(frames, *cages_of(make(spoilt, "plain")))
    robust = error_to(frames, *cages_of(make(spoilt, "robust", capture=ROBUST)))
    assert plain > 2 * clean
    assert robust < 1.05 * clean


def test_clean_frames_lose_nothing(walker, make):
    plain = cages_of(make(walker[0], "plain"))[0]
    robust = cages_of(make(walker[0], "robust", capture=ROBUST))[0]
    np.testing.assert_array_equal(robust, plain)


def test_rejected_vertices_are_counted_everywhere(walker, make):
    spoilt = corrupt("outliers", walker[0])
    result = extract(make(spoilt, capture=ROBUST))
    is_out = (spoilt != walker[0]).any(axis=2)
    np.testing.assert_allclose(result.kept.rejected, is_out.sum(axis=1), atol=2)
    report = build_report(result)
    assert report.kept.rms_percent < 0.1 * report.summary.rms_percent
    assert abs(report.summary.volume_change_percent_max) < 5
    rows = list(csv.DictReader(io.StringIO(format_csv([report]))))
    assert [int(row["rejected"]) for row in rows] == result.kept.rejected.tolist()
    record = json.loads(format_json([report]))
    assert record["kept"]["most_rejected"] == int(result.kept.rejected.max())
    assert [one["rejected"] for one in record["frames"]] == result.kept.rejected.tolist()
    text = format_text(report)
    assert f"most in {report.kept.most_rejected_frame}" in text
    assert "over what was not rejected" in text
    page = render_result_page(result, report, load_player(result))
    assert "Rejected" in page
    assert "over what was not rejected" in page
    assert record["settings"]["robust"] is True


def test_the_error_by_area_is_over_all_data_as_the_error_is(walker, make):
    spoilt = corrupt("missing", corrupt("outliers", walker[0]))
    result = extract(make(spoilt, clip=MISSING, capture=ROBUST))
    with h5py.File(result.path) as file:
        rebuilt = file["weights"][:] @ file["verts"][:]
    squares, areas = ((rebuilt - spoilt) ** 2).sum(axis=2), lumped_areas(result.rest)
    whole = np.where(np.isnan(squares), 0, areas).sum(axis=1)
    by_frame = 100 * np.sqrt(np.nansum(areas * squares, axis=1) / whole) / result.rest.diagonal
    report = build_report(result)
    assert report.summary.area_rms_percent == pytest.approx(np.sqrt(np.mean(by_frame**2)), rel=1e-9)
    assert report.kept.area_rms_percent < 0.1 * report.summary.area_rms_percent
    record = json.loads(format_json([report]))
    assert record["kept"]["area_rms_percent"] == report.kept.area_rms_percent
    rows = list(csv.DictReader(io.StringIO(format_csv([report]))))
    for held in (record["frames"], rows):
        found = np.array([float(one["area_rms_percent"]) for one in held])
        np.testing.assert_allclose(found, by_frame, rtol=1e-9, atol=1e-12)
        kept = np.array([float(one["area_rms_kept_percent"]) for one in held])
        assert np.sqrt(np.mean(kept**2)) == pytest.approx(report.kept.area_rms_percent, rel=1e-9)
    by_area = f"{report.kept.area_rms_percent:.4f}"
    assert f"by area {by_area} %, max" in format_text(report)
    page = render_result_page(result, report, load_player(result))
    assert by_area in page[page.index("Error by area") :][:300]


def test_results_that_do_not_tell_the_error_by_area_are_read(walker, make):
    path = extract(make(corrupt("outliers", walker[0]), capture=ROBUST)).path
    with h5py.File(path, "r+") as file:
        file["metrics/area_rms"][0] = -1
    with pytest.raises(FormatError, match="`metrics/area_rms` that is impossible"):
        read_result(path)
    with h5py.File(path, "r+") as file:
        del file["metrics/area_rms"], file["metrics/area_rms_kept"]
    report = build_report(read_result(path))
    record = json.loads(format_json([report]))
    assert record["summary"]["area_rms"] is record["kept"]["area_rms_percent"] is None
    assert {one["area_rms_kept_percent"] for one in record["frames"]} == {None}
    assert "by area" not in format_text(report)


def test_without_the_options_nothing_of_it_is_stored(walker, make):
    result = extract(make(walker[0]))
    assert result.kept is None
    with h5py.File(result.path) as file:
        assert "metrics/rejected" not in file
    assert not {"robust", "missing"} & set(result.settings)
    assert "rejected" not in format_text(build_report(result))


def test_missing_pieces_are_left_out(walker, make):
    spoilt = corrupt("missing", walker[0])
    result = extract(make(spoilt, clip=MISSING))
    is_missing = np.isnan(spoilt[..., 0])
    np.testing.assert_array_equal(result.kept.missing, is_missing.sum(axis=1))
    assert not result.kept.rejected.any()
    np.testing.assert_array_equal(result.metrics.rms, result.kept.rms_kept)
    with h5py.File(result.path) as file:
        rebuilt = file["weights"][:] @ file["verts"][:]
    errors = np.linalg.norm(rebuilt - spoilt, axis=2)
    np.testing.assert_allclose(
        result.metrics.rms, np.sqrt(np.nanmean(errors**2, axis=1)), rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(result.metrics.max_deviation, np.nanmax(errors, axis=1), atol=1e-12)
    assert np.isnan(result.metrics.volume[1:]).all()
    assert np.isfinite(result.metrics.volume[0])
    page = render_result_page(result, build_report(result), load_player(result))
    assert "Missing 18" in page


@pytest.mark.parametrize(
    ("frames", "smooth", "bridged"),
    [(1, None, 0), (11, None, 0), (11, 0.1, 10), (4, 0.1, 3), (4, "auto", 3), (3, 0.1, None)],
)
def test_a_piece_whose_place_is_a_guess_is_noted(
    walker, make, monkeypatch, frames, smooth, bridged
):
    """Without smoothing, that is any; with it, one that is hidden for longer than motion tells."""
    monkeypatch.setattr(
        "cageik_cli.run.time_pass.count_bridged_frames", lambda *_: 10 if frames > 9 else 3
    )
    spoilt = walker[0][:12].copy()
    spoilt[1 : 1 + frames, :314] = np.nan
    result = extract(make(spoilt, clip=MISSING, capture=CaptureSettings(smooth=smooth)))
    found = [note for note in texts(result.notes) if "occluded" in note]
    if bridged is None:
        assert not found
        return
    lasting = f"for more than {bridged} frames" if bridged else "for a frame or more"
    (note,) = found
    assert note.startswith(f"314 vertices are occluded {lasting} in a row, up to {frames}: ")


def test_a_piece_of_a_quick_clip_is_placed_by_the_surface_around_it(walk, make):
    """Hidden for five frames of every sixth of a walk, where time flings it."""
    frames = walk[0][::6]
    frames = np.concatenate([frames, frames, frames])
    height = frames[0][:, 1]
    hidden = height < np.quantile(height, 0.2)  # the feet
    spoilt = frames.copy()
    for first in range(2, len(frames) - 5, 6):
        spoilt[first : first + 5, hidden] = np.nan
    is_hidden = np.isnan(spoilt[..., 0])

    def measure(bridged=None):
        with pytest.MonkeyPatch.context() as patch:
            if bridged is not None:
                name = "cageik_cli.run.time_pass.count_bridged_frames"
                patch.setattr(name, lambda *_: bridged)
            settings = make(spoilt, clip=MISSING, capture=CaptureSettings(smooth="auto"))
            cages, weights = cages_of(settings)
        return np.sqrt(((weights @ cages - frames) ** 2).sum(axis=2)[is_hidden].mean())

    by_time, by_surface, chosen = measure(10), measure(0), measure()
    assert chosen == pytest.approx(min(by_time, by_surface), rel=1e-9)
    assert by_surface < 0.8 * by_time


def test_what_is_placed_is_all_that_is_hidden_in_a_frame(walker, make, monkeypatch):
    """Beside a piece that is hidden for long, one for two frames, and one that is never data."""
    spoilt, used, found = walker[0].copy(), np.ones(1570), []
    spoilt[1:, :314] = np.nan
    spoilt[6:8, 400:500] = np.nan
    used[600:610] = 0
    np.save("used.npy", used)
    monkeypatch.setattr(
        "cageik_cli.run.time_pass.RigidFiller.fill",
        lambda self, positions, is_hidden: found.append(is_hidden) or positions,
    )
    extract(make(spoilt, clip=MISSING, vertex_weights=Path("used.npy")))
    np.testing.assert_array_equal(found, np.isnan(spoilt[1:, :, 0]) | (used == 0))


def test_a_piece_that_is_hidden_in_all_frames_is_placed_and_stays_when_smoothed(
    walk, make, monkeypatch
):
    """The upper fifth of the vertices; without placing, the cage is anywhere around it."""
    frames = walk[0][::2]
    height = frames[0][:, 1]
    hidden = height > np.quantile(height, 0.79)
    spoilt = frames.copy()
    spoilt[1:, hidden] = np.nan

    def measure(**capture):
        """Return the rms and the largest error where it is hidden, in percent of the size."""
        settings = make(spoilt, clip=MISSING, capture=CaptureSettings(**capture))
        cages, weights = cages_of(settings)
        errors = np.linalg.norm((weights @ cages - frames)[1:, hidden], axis=2)
        size = np.linalg.norm(np.ptp(frames[0], axis=0))
        return 100 * np.array([np.sqrt((errors**2).mean()), errors.max()]) / size

    placed = measure()
    for smooth in ("auto", 0.1):
        assert (measure(smooth=smooth) <= 1.05 * placed).all()
    assert not list(Path().glob("*.partial"))
    monkeypatch.setattr(OcclusionTracker, "has_long", False)
    assert placed[0] < min(1.5, 0.5 * measure()[0])


def test_missing_vertices_do_not_change_the_rest_of_the_cage(walker, make):
    frames = walker[0]
    spoilt = corrupt("missing", frames)
    clean, weights = cages_of(make(frames, "clean"))
    found, _ = cages_of(make(spoilt, clip=MISSING))
    known = ~np.isnan(spoilt[..., 0])
    error = np.linalg.norm(weights @ found - frames, axis=2)[known]
    plain = np.linalg.norm(weights @ clean - frames, axis=2)[known]
    assert np.sqrt(np.mean(error**2)) < 1.05 * np.sqrt(np.mean(plain**2))


def write_objs(folder, frames, faces):
    folder.mkdir()
    for k, frame in enumerate(frames):
        lines = ["v {} {} {}".format(*vertex) for vertex in frame]
        lines += ["f {} {} {}".format(*(face + 1)) for face in faces]
        (folder / f"frame_{k}.obj").write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("form", ["npz", "obj"])
def test_missing_vertices_are_refused_without_the_option(walker, make, form):
    spoilt = corrupt("missing", walker[0])[:3]
    settings = make(spoilt)
    if form == "obj":
        write_objs(Path("objs"), spoilt, walker[1])
        settings = replace(settings, frames=("objs",))
    with pytest.raises(
        FormatError, match=r"(?s)314 of 1 570 vertices are not finite.*`missing=True`"
    ):
        extract(settings)
    result = extract(replace(settings, clip=MISSING))
    assert result.kept.missing.tolist() == [0, 314, 314]


def test_a_first_frame_with_missing_vertices_needs_another_rest_pose(walker, make):
    spoilt = walker[0].copy()
    spoilt[0, 4:9] = np.nan
    with pytest.raises(FormatError, match=r"5 of 1 570 vertices are not finite.*`missing=True`"):
        extract(make(spoilt))
    with pytest.raises(
        FormatError, match=r"5 of 1 570 vertices of the rest pose are missing.*`rest"
    ):
        extract(make(spoilt, clip=MISSING))
    other = make(spoilt, clip=MISSING, rest=Path("rest/frame_0.obj"))
    write_objs(Path("rest"), walker[0][:1], walker[1])
    result = extract(other)
    assert result.kept.missing.tolist() == [5] + 11 * [0]


def test_infinite_vertices_are_never_missing(walker, make):
    spoilt = walker[0].copy()
    spoilt[3, 7, 1] = np.inf
    with pytest.raises(FormatError, match="not finite") as caught:
        extract(make(spoilt, clip=MISSING))
    assert "`missing=True`" not in str(caught.value)


def test_frames_of_too_few_data_are_named(walker, make):
    spoilt = walker[0].copy()
    spoilt[5], spoilt[7, 30:] = np.nan, np.nan
    with pytest.raises(FormatError, match=r"clip.npz\[6\]: 0 of 1570 vertices are data"):
        extract(make(spoilt, clip=MISSING))
    result = extract(make(spoilt, clip=MISSING, on_bad_frame="skip"))
    assert list(result.skipped) == [5, 7]
    assert "30 of 1570 vertices are data" in result.skipped[7]
    assert result.skipped[7].endswith("of the cage)")  # no advice where it was followed
    assert np.isnan(result.metrics.rms[[5, 7]]).all()
    assert np.isfinite(np.delete(result.metrics.rms, [5, 7])).all()


def test_weights_of_zero_in_a_frame_are_missing_vertices(walker, make):
    spoilt = corrupt("missing", walker[0])
    shares = np.isfinite(spoilt[..., 0]).astype(float)
    np.save("weights.npy", shares)
    by_weights = make(walker[0], "weighted", vertex_weights=Path("weights.npy"))
    first, _ = cages_of(by_weights)
    second, _ = cages_of(make(spoilt, clip=MISSING))
    np.testing.assert_allclose(first, second, rtol=0, atol=1e-9)
    result = read_result(by_weights.output)
    np.testing.assert_array_equal(result.kept.missing, (shares == 0).sum(axis=1))
    assert "weights.npy" in result.sources["vertex_weights"]["name"]


def test_gaps_longer_than_the_overlap_are_filled_from_both_sides(walker, make, monkeypatch):
    frames = np.concatenate([walker[0], walker[0][::-1]] * 3)
    frames[30:52] = np.nan
    settings = make(
        frames,
        clip=MISSING,
        capture=CaptureSettings(fill_gaps=True),
        rest=Path("rest/frame_0.obj"),
    )
    write_objs(Path("rest"), walker[0][:1], walker[1])
    whole, _ = cages_of(settings)
    monkeypatch.setattr("cageik_cli.captured.smooth.MIN_WINDOW", 32)
    monkeypatch.setattr("cageik_cli.captured.smooth.MAX_WINDOW", 32)
    parts, _ = cages_of(settings)
    np.testing.assert_allclose(parts, whole, rtol=0, atol=1e-2)


def test_a_small_weight_that_is_given_is_not_rejected(walker, make):
    shares = np.ones(walker[0].shape[:2])
    shares[3] = 0.4
    shares[5, :200] = 0.2
    np.save("weights.npy", shares)
    settings = make(walker[0], vertex_weights=Path("weights.npy"), capture=ROBUST)
    rejected = extract(settings).kept.rejected
    plain = extract(make(walker[0], "plain", capture=ROBUST)).kept.rejected
    np.testing.assert_allclose(rejected, plain, atol=2)


def test_equal_weights_of_frames_change_nothing(walker, make):
    np.save("weights.npy", np.full(walker[0].shape[:2], 3, np.float32))
    weighted, _ = cages_of(make(walker[0], "weighted", vertex_weights=Path("weights.npy")))
    plain, _ = cages_of(make(walker[0], "plain"))
    np.testing.assert_allclose(weighted, plain, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("weights", "says"),
    [
        (np.ones((11, 1570)), r"shape \(11, 1570\), expected \(12, 1570\)"),
        (np.full((12, 1570), -1.0), "weight of vertex 0 in row 0 is -1.0"),
        (np.zeros((12, 1570)), "all vertex weights are zero"),
        (np.full((12, 1570), "a"), "expected numbers"),
    ],
)
def test_unusable_weights_of_frames_are_refused(walker, make, weights, says):
    np.save("weights.npy", weights)
    with pytest.raises(InputError, match=rf"weights.npy: .*{says}"):
        extract(make(walker[0], vertex_weights=Path("weights.npy")))


def test_threads_and_interruptions_do_not_change_the_bytes(walker, make, monkeypatch):
    monkeypatch.setattr(executor, "MAX_BLOCK_FRAMES", 2)
    spoilt = corrupt("missing", corrupt("outliers", walker[0]))
    settings = make(spoilt, capture=ROBUST, clip=MISSING)
    whole = extract(settings).path.read_bytes()
    assert extract(replace(settings, jobs=3)).path.read_bytes() == whole
    other = replace(settings, output=Path("other.h5"), overwrite=False)
    with pytest.raises(KeyboardInterrupt):
        extract(other, Listener(stop_at=(4, 12)))
    resumed = extract(replace(other, resume=True))
    assert resumed.path.read_bytes() == whole
    with pytest.raises(CheckpointError, match="other settings"):
        extract(replace(other, resume=True, capture=CaptureSettings()))


SMOOTH = CaptureSettings(robust=True, smooth="auto", fill_gaps=True)


def test_all_at_once_is_solved_with_smoothing(walk, make):
    frames = walk[0]
    spoilt = corrupt("lost", corrupt("missing", corrupt("outliers", frames)))
    clean = error_to(frames, *cages_of(make(frames, "clean")))
    result = extract(make(spoilt, capture=SMOOTH, clip=MISSING))
    with h5py.File(result.path) as file:
        found = file["verts"][:]
        weights = file["weights"][:]
    known = np.setdiff1d(np.arange(48), list(result.skipped))
    assert (
        list(result.filled)
        == list(result.skipped)
        == np.flatnonzero(np.isnan(spoilt).all(axis=(1, 2))).tolist()
    )
    assert np.isfinite(found).all()
    plain = make(spoilt, "still", capture=ROBUST, clip=MISSING, on_bad_frame="skip")
    still = cages_of(plain)[0][known]
    error = error_to(frames, found, weights)
    assert error < 0.7 * error_to(frames[known], still, weights)
    assert error < 1.5 * clean
    rebuilt = weights @ found[known]
    errors = np.linalg.norm(rebuilt - spoilt[known], axis=2)
    rms = np.sqrt(np.nanmean(errors**2, axis=1))
    np.testing.assert_allclose(result.metrics.rms[known], rms, rtol=1e-9, atol=1e-12)


def test_filled_gaps_are_read_as_they_were_filled(walker, make):
    spoilt = walker[0].copy()
    spoilt[5] = np.nan
    settings = make(spoilt, clip=MISSING, capture=CaptureSettings(fill_gaps=True))
    result = extract(settings)
    assert result.filled == (5,)
    report = build_report(result)
    assert report.filled == ("clip.npz[6]",)
    assert "1 frame from those around: clip.npz[6]" in format_text(report)
    assert "Filled cages of 1 frame come" in render_result_page(result, report, load_player(result))
    plain = make(spoilt, "plain", clip=MISSING, on_bad_frame="skip")
    linear = np.concatenate(list(read_cages(extract(plain), 16)))
    filled = np.concatenate(list(read_cages(result, 16)))
    np.testing.assert_array_equal(np.delete(filled, 5, 0), np.delete(linear, 5, 0))
    assert np.abs(filled[5] - linear[5]).max() > 1e-3
    with h5py.File(result.path) as file:
        np.testing.assert_array_equal(filled[5], file["verts"][5])
        assert np.isfinite(file["rotations"][5]).all()


def test_smoothing_keeps_the_bytes_for_threads_and_interruptions(walker, make, monkeypatch):
    monkeypatch.setattr(executor, "MAX_BLOCK_FRAMES", 2)
    spoilt = corrupt("lost", corrupt("missing", corrupt("outliers", walker[0])))
    settings = make(spoilt, capture=SMOOTH, clip=MISSING)
    whole = extract(settings).path.read_bytes()
    assert extract(replace(settings, jobs=3)).path.read_bytes() == whole
    other = replace(settings, output=Path("other.h5"), overwrite=False)
    with pytest.raises(KeyboardInterrupt):
        extract(other, Listener(stop_at=(4, 12)))
    assert extract(replace(other, resume=True)).path.read_bytes() == whole
    assert not list(Path().glob("*.partial"))


@pytest.mark.parametrize("period", [0.1, 1.0])
def test_windows_of_long_clips_change_little(walker, make, monkeypatch, period):
    monkeypatch.setattr("cageik_cli.captured.smooth.MIN_HIT_RATIO", 1e9)
    frames = np.concatenate([walker[0], walker[0][::-1]] * 5)
    noisy = frames + 0.003 * np.random.default_rng(2).standard_normal(frames.shape)
    settings = make(noisy, capture=CaptureSettings(smooth=period), rest=Path("rest/frame_0.obj"))
    write_objs(Path("rest"), walker[0][:1], walker[1])
    whole, _ = cages_of(settings)
    monkeypatch.setattr("cageik_cli.captured.smooth.MIN_WINDOW", 48)
    monkeypatch.setattr("cageik_cli.captured.smooth.MAX_WINDOW", 48)
    parts, _ = cages_of(settings)
    plain, _ = cages_of(replace(settings, capture=CaptureSettings()))
    assert 0 < np.abs(parts - whole).max() < 0.01 * np.abs(whole - plain).max()


def test_windows_with_too_few_frames_to_validate_are_kept(walker, make, monkeypatch):
    """Of 96 frames, 3 have data, each in a window of its own."""
    frames = np.full((96, *walker[0].shape[1:]), np.nan)
    frames[[5, 50, 90]] = walker[0][[1, 4, 7]]
    options = {"clip": MISSING, "rest": Path("rest/frame_0.obj"), "on_bad_frame": "skip"}
    write_objs(Path("rest"), walker[0][:1], walker[1])
    monkeypatch.setattr("cageik_cli.captured.smooth.MIN_WINDOW", 32)
    monkeypatch.setattr("cageik_cli.captured.smooth.MAX_WINDOW", 32)
    plain, _ = cages_of(make(frames, "plain", **options))
    found, _ = cages_of(make(frames, capture=CaptureSettings(smooth="auto"), **options))
    np.testing.assert_allclose(found, plain, rtol=0, atol=1e-9)


def test_noise_of_every_second_frame_is_smoothed(walk, make):
    frames = np.concatenate([walk[0], walk[0][::-1]])
    noise = np.random.default_rng(4).standard_normal((len(frames), 1, 3))
    spoilt = frames + 0.01 * np.linalg.norm(np.ptp(frames[0], axis=0)) * noise
    spoilt[1::2] = np.nan
    options = {"clip": MISSING, "rest": Path("rest/frame_0.obj"), "on_bad_frame": "skip"}
    write_objs(Path("rest"), frames[:1], walk[1])
    errors = []
    for capture in (CaptureSettings(), CaptureSettings(smooth="auto")):
        cages, weights = cages_of(make(spoilt, capture=capture, **options))
        errors.append(error_to(frames[::2], cages[::2], weights))
    assert errors[1] < 0.85 * errors[0]


@pytest.mark.parametrize(("period", "is_blamed"), [(1.0, True), (0.01, False)])
def test_smoothing_is_to_blame_for_what_it_takes_away(walk, make, period, is_blamed):
    """A walk of two steps per second, as every second frame has it."""
    frames = np.concatenate([walk[0][::2], walk[0][::-2]])
    frames[20] += 0.1 * np.sin(20 * walk[0][0])  # what no cage follows, smoothed or not
    result = extract(make(frames, capture=CaptureSettings(smooth=period)))
    causes = {region.cause for region in result.regions}
    assert (Cause.SMOOTHING in causes) is is_blamed
    assert ("smoothing takes" in format_text(build_report(result))) is is_blamed
    shares = [region.evidence.unsmoothed_share for region in result.regions]
    assert (min(shares) < 0.8) is is_blamed


@pytest.mark.parametrize("ratio", [1.0, 1.01, 1e300])
def test_periods_that_cannot_be_smoothed_are_refused(walker, make, ratio):
    """The longest period of a clip with 24 frames per second, and longer ones."""
    period = ratio * MAX_SMOOTHING_PERIOD / 24
    settings = make(walker[0], capture=CaptureSettings(smooth=period))
    if ratio > 1:
        with pytest.raises(InputError, match=rf"\({MAX_SMOOTHING_PERIOD} frames at 24 per second"):
            extract(settings)
    else:
        assert np.isfinite(cages_of(settings)[0]).all()


@pytest.mark.parametrize("count", [1, 2])
def test_clips_too_short_to_smooth_are_kept(walker, make, count):
    frames = walker[0][:count]
    plain, _ = cages_of(make(frames, "plain"))
    found, _ = cages_of(make(frames, capture=CaptureSettings(smooth="auto")))
    np.testing.assert_array_equal(found, plain)


def test_weights_fitted_to_a_clean_clip_serve_one_with_missing_vertices(walker, make):
    clean = replace(make(walker[0], "clean", fit=FitSettings()), rest=Path("rest/frame_0.obj"))
    write_objs(Path("rest"), walker[0][:1], walker[1])
    with pytest.raises(SettingError, match="`fit=` needs frames without missing vertices"):
        replace(clean, clip=MISSING)
    bind_files(BindRunSettings(clean.cage, clean.rest, Path("fit.h5"), clips=clean.frames))
    spoilt = make(corrupt("missing", walker[0]), capture=SMOOTH, clip=MISSING)
    result = extract(replace(spoilt, cage=None, binding=Path("fit.h5"), rest=clean.rest))
    assert result.fit is not None
    assert build_report(result).unfitted is None
    assert build_report(result).kept.most_missing == 314


def test_a_missing_number_is_filled_in_its_time(walk, make):
    frames, faces, _ = walk
    folder = Path("objs")
    write_objs(folder, frames[:12], faces)
    (folder / "frame_5.obj").unlink()
    settings = replace(
        make(frames), frames=("objs",), clip=ClipSettings(gaps="keep"), capture=SMOOTH
    )
    result = extract(settings)
    assert result.filled == (5,)
    with h5py.File(result.path) as file:
        rebuilt = file["weights"][:] @ file["verts"][:]
    plain = cages_of(make(frames[:12], "plain"))
    size = np.linalg.norm(np.ptp(frames[0], axis=0))
    assert np.abs(rebuilt[5] - plain[1] @ plain[0][5]).max() < 0.01 * size


def test_a_result_with_filled_frames_is_kept_when_resumed(walker, make):
    spoilt = walker[0].copy()
    spoilt[5] = np.nan
    settings = make(spoilt, clip=MISSING, capture=CaptureSettings(fill_gaps=True))
    whole = extract(settings).path.read_bytes()
    again = extract(replace(settings, resume=True, overwrite=False))
    assert again.path.read_bytes() == whole


def test_a_run_killed_after_its_result_leaves_nothing_at_the_next(walker, make, monkeypatch):
    """Killed between writing the result and deleting the frames placed and smoothed for it."""
    spoilt = walker[0].copy()
    spoilt[1:, :314] = np.nan
    settings = make(spoilt, clip=MISSING, capture=CaptureSettings(smooth=0.2))
    with monkeypatch.context() as patched:
        patched.setattr(Checkpoint, "discard", Checkpoint.close)
        result = extract(settings)
    left = [find_path(settings.output) for find_path in (placed_path, smoothed_path)]
    assert all(path.exists() for path in left)
    assert extract(replace(settings, resume=True, overwrite=False)).path == result.path
    assert not list(Path().glob("*.partial"))
