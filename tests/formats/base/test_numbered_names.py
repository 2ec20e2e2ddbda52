"""Which number of names runs, and which names are the series."""

import glob
import random
from pathlib import Path

import pytest

from cageik_cli.formats.base import numbered_names
from cageik_cli.formats.base.numbered_names import group_series, split_series


def name(*stems, suffix=".obj"):
    return [Path("clip") / f"{stem}{suffix}" for stem in stems]


def count(pattern, numbers):
    return [pattern.format(k) for k in numbers]


WALK = count("walk_{:04}", range(1, 7))

ONE_SERIES = {
    "padded": (WALK, range(1, 7)),
    "a version": (count("walk_v2_{}_low", range(8, 12)), range(8, 12)),
    "beside a time": (
        [f"cap_{k + 1:05}_t{k / 30:.3f}" for k in range(40)],
        range(1, 41),
    ),
    "behind a time": ([f"t{0.95 + k / 20:.2f}_{k:03}" for k in range(5)], range(5)),
    "beside a time of few digits": ([f"f{k}_{k / 24:.1f}s" for k in range(24)], range(24)),
    "beside a time, two of them": (["cap_00001_t0.000", "cap_00002_t0.033"], [1, 2]),
    "beside a time, with a gap": (
        [f"cap_{k:05}_t{k / 30:.3f}" for k in (1, 2, 3, 5, 6)],
        [1, 2, 3, 5, 6],
    ),
    "beside numbers at random": (
        [f"f{k:03}_{37 * k % 101}" for k in range(1, 12)],
        range(1, 12),
    ),
    "beside a clock": ([f"f{k:03}_12-30-{55 + k}" for k in range(5)], range(5)),
    "beside a clock over a minute": (
        ["f003_12-30-58", "f004_12-30-59", "f005_12-31-00", "f006_12-31-01"],
        range(3, 7),
    ),
    "twice": ([f"f{k}_{1000 + k}" for k in range(3)], range(3)),
    "over a minute": (
        [f"cap_2024-01-05_12-{k}" for k in ("30-57", "30-58", "30-59", "31-00", "31-01")],
        range(1, 6),
    ),
    "over an hour, every 20 s": (
        [f"cap_{k}" for k in ("23-59-00", "23-59-20", "23-59-40")],
        None,
    ),
    "over midnight": (
        ["cap_20231231_235958", "cap_20231231_235959", "cap_20240101_000000"],
        range(1, 4),
    ),
    "without a mark, over a minute": (
        ["cap_123058", "cap_123059", "cap_123100", "cap_123101"],
        range(1, 5),
    ),
    "parts of a second": (
        [f"cap_12-30-{k}" for k in ("59-800", "59-900")] + ["cap_12-31-00-000"],
        range(1, 4),
    ),
    "tenths of a second": (
        [f"cap_12-30-59.{k}" for k in (0, 5)] + [f"cap_12-31-00.{k}" for k in (0, 5)],
        range(1, 5),
    ),
    "hundredths, with a comma": (
        ["cap_20240105_123059,98", "cap_20240105_123059,99", "cap_20240105_123100,00"],
        range(1, 4),
    ),
    "a day and a time, without marks": (
        ["cap_240105_123059", "cap_240105_123100", "cap_240105_123101"],
        range(1, 4),
    ),
    "days over a month": (
        ["scan-2024-02-28", "scan-2024-02-29", "scan-2024-03-01"],
        range(1, 4),
    ),
    "days over a year, without marks": (
        ["scan_20231231", "scan_20240101", "scan_20240102"],
        range(1, 4),
    ),
    "weeks": ([f"2024.{k}" for k in ("01.22", "01.29", "02.05", "02.12")], range(1, 5)),
    "some days": (["s 2024-01-30", "s 2024-02-01", "s 2024-02-04"], [1, 3, 6]),
    "a dated gap": (
        ["s_2024.01.05 12.59.58", "s_2024.01.05 12.59.59", "s_2024.01.05 13.00.02"],
        [1, 2, 5],
    ),
}


@pytest.mark.parametrize(("stems", "numbers"), ONE_SERIES.values(), ids=ONE_SERIES)
def test_one_number_runs(stems, numbers):
    paths = name(*stems)
    shuffled = random.Random(3).sample(paths, len(paths))
    (series,) = split_series(shuffled)
    assert list(series.paths) == paths
    if numbers is not None:
        assert series.numbers == tuple(numbers)
        for k, number in enumerate(numbers):
            assert series.make_path(k, number) == paths[k]


def test_a_frame_that_is_missing_has_the_time_that_it_would_have():
    paths = name("s_2024-01-05_12-59-58", "s_2024-01-05_12-59-59", "s_2024-01-05_13-00-02")
    (series,) = split_series(paths)
    assert series.make_path(1, 3) == Path("clip/s_2024-01-05_13-00-00.obj")
    (series,) = split_series(name("c_12-30-59-900", "c_12-31-00-000", "c_12-31-00-100"))
    assert series.make_path(0, 4) == Path("clip/c_12-31-00-200.obj")


FRACTIONS = {
    "times": ["sim_0.05", "sim_0.1", "sim_0.15", "sim_0.2", "sim_0.25", "sim_0.3"],
    "over a second": ["sim_0.85", "sim_0.9", "sim_0.95", "sim_1.0", "sim_1.05", "sim_1.1"],
    "rounded": [f"sim_{k / 30:.3f}" for k in range(70)],
    "uneven": ["t0.05", "t0.1", "t0.17"],
    "before a word": ["0.5s_low", "0.75s_low", "1.0s_low"],
    "with a comma": ["sim_0,05", "sim_0,1", "sim_0,15", "sim_0,2"],
    "with a comma, over a second": ["sim_0,85", "sim_0,9", "sim_0,95", "sim_1,0", "sim_1,05"],
    "rounded, within a second": [f"sim_{k / 30:.3f}" for k in range(1, 29)],
    "rounded, before a word": [f"sim_{k / 24:.2f}s" for k in range(1, 24)],
    "rounded, beside a number": [f"v2_{k / 60:.4f}_low" for k in range(9)],
    "halves of four digits": [f"w_{k:04}.{p}" for k in (1, 2, 3) for p in ("00", "50")],
}


@pytest.mark.parametrize("stems", FRACTIONS.values(), ids=FRACTIONS)
def test_fractions_run_by_their_value(stems):
    paths = name(*stems)
    (series,) = split_series(random.Random(5).sample(paths, len(paths)))
    assert list(series.paths) == paths
    assert series.numbers == ()


@pytest.mark.parametrize(
    "stems",
    [
        count("walk.2.{:04}", range(1, 4)),
        count("walk.2.{}", range(1, 13)),
        count("walk.2.{}", [*range(1, 5), *range(6, 13)]),
        count("walk.{}.0", range(1001, 1004)),
        count("t_0.{}", range(1, 10)),
        ["f1", "f02", "f003"],
    ],
)
def test_a_number_behind_a_point_is_no_fraction_where_it_counts(stems):
    (series,) = split_series(name(*stems))
    assert [path.stem for path in series.paths] == stems
    assert len(series.numbers) == len(stems)


SEVERAL = {
    "takes": (
        [*count("take1_{:02}", range(1, 5)), *count("take2_{:02}", range(1, 4))],
        ["take1_*", "take2_*"],
    ),
    "shots that go on": (
        [*count("s010_{}", range(1001, 1006)), *count("s020_{}", range(1006, 1011))],
        ["s010_*", "s020_*"],
    ),
    "takes in minutes and seconds": (
        [f"walk_{take:02}_{k:02}" for take in (1, 2) for k in range(1, 6)],
        ["walk_01_*", "walk_02_*"],
    ),
    "versions of each frame": (
        [f"walk_{k:03}_v{v}" for k in range(1, 6) for v in (1, 2)],
        ["walk_*_v1", "walk_*_v2"],
    ),
    "more takes than frames": (
        [f"walk{take}_{k}" for take in range(1, 8) for k in range(3)],
        [f"walk{take}_*" for take in range(1, 8)],
    ),
    "takes of two frames": (
        [f"take{take}_{k}" for take in range(1, 8) for k in range(2)],
        [f"take{take}_*" for take in range(1, 8)],
    ),
    "several cameras": (
        [f"f{k}_cam{cam}" for k in range(4) for cam in range(1, 6)],
        [f"f*_cam{cam}" for cam in range(1, 6)],
    ),
    "a few of each frame": (
        [f"f{k:03}_{side}" for k in range(9) for side in (1, 2)],
        ["f*_1", "f*_2"],
    ),
    "frames below points": (
        [f"walk.{take}.{k:04}" for take in (1, 2) for k in range(1, 6)],
        ["walk.1.*", "walk.2.*"],
    ),
    "crossed": (["walk_01_02", "walk_02_01"], ["walk_01_*", "walk_02_*"]),
}


@pytest.mark.parametrize(("stems", "labels"), SEVERAL.values(), ids=SEVERAL)
def test_no_number_runs_through_several_takes(stems, labels):
    found = split_series(name(*stems))
    assert sorted(series.name_around("*") for series in found) == labels
    assert sum(len(series.paths) for series in found) == len(stems)


BESIDE = {
    "a copy of a browser": ["walk_0003 (1)"],
    "copies": ["walk_0003 (1)", "walk_0003 (2)", "walk_0004 (1)"],
    "a copy in German": ["walk_0003 - Kopie", "walk_0003 - Kopie (2)"],
    "a copy with a date": ["walk_0001 (conflicted copy 2024-01-05)"],
    "a copy that says so first": ["Copy of walk_0002", "Copy (2) of walk_0002"],
    "some at rest": ["walk_0001_rest", "walk_0002_rest"],
    "a backup": ["walk_0001.bak", "walk_0002.bak", "walk_0003.bak"],
    "models of less detail of some": ["walk_0001_lod1", "walk_0003_lod1", "walk_0005_lod1"],
    "others": ["rest", "cage_80", "walk"],
}


def test_thousands_of_names_that_are_no_series_are_looked_at_once():
    """Each pair of them would take minutes."""
    generator = random.Random(1)
    names = {f"{generator.getrandbits(96):x}" for _ in range(5000)}
    calls = 0

    def count_call(*_):
        nonlocal calls
        calls += 1
        return False

    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(numbered_names, "_is_of", count_call)
        assert len(group_series(name(*names))) > 4900
    assert calls < 5000


@pytest.mark.parametrize("stems", BESIDE.values(), ids=BESIDE)
def test_what_is_beside_a_series_is_none(stems):
    found = [one for one in group_series(name(*stems, *WALK)) if len(one.paths) > 1]
    assert [[path.stem for path in one.paths] for one in found] == [WALK]


def test_models_of_less_detail_of_all_frames_are_a_series():
    found = group_series(name(*WALK, *(f"{stem}_lod1" for stem in WALK)))
    assert sorted(one.name_around("*") for one in found) == ["walk_*", "walk_*_lod1"]


@pytest.mark.parametrize(
    ("stems", "sizes"),
    [
        ([*WALK, "walk_-1"], [7]),
        ([*WALK, "walk_1.5", "walk_2.5"], [8]),
        ([*WALK, *count("walk_2.{:04}", range(1, 4))], [6, 3]),
        ([*WALK, "walk_1.5_low"], [6, 1]),
        (["walk_-3", "walk_-2", "walk_-1", "walk_0"], [4]),
        (["a1", "a2", "a-1", "a-2"], [2, 2]),
        (["f_1", "f_2", "f_1.05", "f_1.1"], [4]),
        (["f_0.25", "f_0.5", "f_0.75", "f_1"], [4]),
        ([f"f_{k / 10:g}" for k in range(1, 11)], [10]),
        (["f_0,25", "f_0,5", "f_0,75", "f_1", "f_1,25", "f_1,5", "f_1,75"], [7]),
        (["f_0.25", "f_0.5", "f_0.75", "f_2"], [3, 1]),
    ],
)
def test_frames_with_a_sign_or_a_fraction_are_of_the_series(stems, sizes):
    found = group_series(name(*stems))
    assert sorted((len(one.paths) for one in found), reverse=True) == sizes


@pytest.mark.parametrize(
    "stems",
    [
        [*WALK, *(f"{stem}_lod1" for stem in WALK)],
        [*count("a{}", range(8, 12)), *count("a{}[x]", range(8, 12)), "a"],
        [*count("take1_{}", range(98, 102)), *count("take2_{}", range(1, 3)), "take1_"],
        [f"cap_2024-01-05_12-{k}" for k in ("30-58", "30-59", "31-00")] + ["cap_2024-01-05_rest"],
        [f"cap_{k + 1:05}_t{k / 30:.3f}" for k in range(5)] + ["cap_00001_t0.000_low"],
        [f"{name}_{k / 4:g}" for name in "ab" for k in range(1, 13)],
        ["a_-2", "a_-1", "a_0", "a_1", "b_0", "b_1"],
    ],
)
def test_globs_name_a_series_alone(tmp_path, stems):
    paths = [tmp_path / f"{stem}.obj" for stem in stems]
    for path in paths:
        path.touch()
    for series in group_series(paths):
        patterns = series.list_globs(paths)
        found = [match for each in patterns for match in glob.glob(str(tmp_path / each))]
        assert sorted(set(found)) == sorted(map(str, series.paths))


def test_names_are_compared_once_for_all_globs(monkeypatch):
    """For each of 20 000 frames they took a minute and a half."""
    found, compare = [], numbered_names.NumberedFiles._find_varying

    def count_comparison(series):
        found.append(compare(series))
        return found[-1]

    monkeypatch.setattr(numbered_names.NumberedFiles, "_find_varying", count_comparison)
    (series,) = split_series(name(*WALK))
    assert series.list_globs(name(*WALK)) == ["walk_*.obj"]
    assert found == [[True]]


def test_fractions_are_even_to_their_rounding():
    even, uneven = (split_series(name(*FRACTIONS[kind]))[0] for kind in ("rounded", "uneven"))
    assert even.has_even_fractions
    assert not uneven.has_even_fractions
