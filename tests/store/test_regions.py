"""The worst regions in a result: read as they were written, or refused."""

import json
from dataclasses import asdict

import h5py
import pytest

from cageik_cli.method.solve.regions import MAX_REGIONS, Cause, Evidence, Region
from cageik_cli.store.result import Result
from cageik_cli.store.result_fields import ClipSizes, list_fields
from cageik_cli.util.errors import FormatError

FIELD = list_fields(Result)["regions"]
SIZES = ClipSizes(frames=7, vertices=20, cage_faces=12, skipped={})
EVIDENCE = Evidence(1.5, 2.5, 0.25, 30.0, 8.0, True, False)


def region(**changes):
    values = {
        "centre": (0.1, -2.0, 1e-17),
        "size": 1 / 3,
        "vertices": 3,
        "frame": 6,
        "max_deviation": 0.1,
        "worst_vertex": 19,
        "cage_faces": (11, 0, 4),
        "cause": Cause.SHARED_LOOP,
        "evidence": EVIDENCE,
    }
    return Region(**values | changes)


@pytest.fixture
def file(tmp_path):
    with h5py.File(tmp_path / "result.h5", "w") as opened:
        yield opened


def test_what_is_written_is_read(file):
    FIELD.write(file, "regions", (region(), region(size=0.0, cause=Cause.UNKNOWN)))
    first, second = FIELD.read(file, SIZES)
    assert first == region()
    assert first.cause is Cause.SHARED_LOOP
    assert second == region(size=0.0, cause=Cause.UNKNOWN)


def test_regions_of_earlier_versions_were_not_smoothed(file):
    evidence = {k: v for k, v in asdict(EVIDENCE).items() if k != "unsmoothed_share"}
    damage(file, evidence=evidence)
    assert FIELD.read(file, SIZES) == (region(),)


def test_none_are_not_the_same_as_not_known(file):
    assert FIELD.read(file, SIZES) is None
    FIELD.write(file, "regions", ())
    assert FIELD.read(file, SIZES) == ()


def damage(file, **changes):
    """Replace fields of the one region in a file; None leaves a field out."""
    FIELD.write(file, "regions", (region(),))
    held = json.loads(file.attrs["regions"])
    held[0] = {k: v for k, v in (held[0] | changes).items() if v is not None}
    file.attrs["regions"] = json.dumps(held)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"frame": 7}, "frames .*7"),
        ({"frame": -1}, "frames .*-1"),
        ({"worst_vertex": 20}, "vertices .*20"),
        ({"cage_faces": [12]}, "cage faces .*12"),
        ({"cage_faces": []}, "near 0 cage faces"),
        ({"cage_faces": [1] * 6}, "near 6 cage faces"),
        ({"vertices": 0}, "of 0 vertices"),
        ({"vertices": 21}, "of 21 vertices"),
        ({"size": -1.0}, "-1.0"),
        ({"max_deviation": 1e61}, "1e\\+61"),
        ({"centre": [0, 0, 1e61]}, "too far away"),
        ({"centre": [0, 0]}, "describe"),
        ({"centre": "abc"}, "describe"),
        ({"cause": "magic"}, "magic"),
        ({"cause": None}, "describe"),
        ({"evidence": {}}, "in_shared_place"),
        ({"evidence": asdict(EVIDENCE) | {"more": 1}}, "evidence"),
        ({"evidence": asdict(EVIDENCE) | {"largest_weight": "nan"}}, "largest_weight"),
        ({"evidence": asdict(EVIDENCE) | {"edge_length": "inf"}}, "edge_length"),
        ({"evidence": 5}, "describe"),
    ],
)
def test_damaged_regions_are_refused(file, changes, says):
    damage(file, **changes)
    with pytest.raises(FormatError, match=rf"`regions` .*{says}.*; extract it again"):
        FIELD.read(file, SIZES)


@pytest.mark.parametrize("text", ["{}", "[5]", "[null]", "nothing", "[{}]"])
def test_what_does_not_hold_regions_is_refused(file, text):
    file.attrs["regions"] = text
    with pytest.raises(FormatError, match="`regions`"):
        FIELD.read(file, SIZES)


def test_too_many_regions_are_refused(file):
    FIELD.write(file, "regions", [region()] * (MAX_REGIONS + 1))
    with pytest.raises(FormatError, match=f"{MAX_REGIONS + 1} regions"):
        FIELD.read(file, SIZES)
